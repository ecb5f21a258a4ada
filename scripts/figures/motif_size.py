"""The size of motifs: one recipe on grids of several finenesses, and motifs of several sizes on one grid."""

from __future__ import annotations

import itertools

import numpy as np
from PIL import Image

from figures.figure import Claim, Figure, Made, Panel
from figures.measures import correlation_length
from figures.setting import Run, Setting
from tnst_mi import render
from tnst_mi.atlas.smoke_patch import ball
from tnst_mi.fields.resampling import resample_density
from tnst_mi.frame import Frame

_KEYS = {
    "small": {"octaves": 3, "iterations": 15, "views": 3, "transport": "flow", "lam": 0.0},
    "paper": {"octaves": 3, "iterations": 20, "views": 9, "transport": "flow", "lam": 0.0},
}

#: Rows of the grids that are compared, and the rows to which pictures are brought for that.
_ROWS, _COMPARED = {"small": (64, 96), "paper": (64, 128, 200)}, 64
_SIZE = 0.375

#: On one grid, motifs of which each is twice as large as the one before.
_SIZES, _BALL, _CHANNEL = (0.2, 0.4, 0.8), (48, 120, 80), "inception_4b/pool_proj:16"

#: Least correlation of the same recipe's changes, and how far a doubling may be from one.
_ALIKE, _DOUBLED = 0.6, (1.5, 2.5)


def make(setting: Setting) -> Made:
    """Stylize one frame at several finenesses with and without a motif size, and a ball with motifs of three sizes."""
    frame = setting.smoke("smokejet", 61)[0]
    found: dict[str, dict[int, tuple[np.ndarray, np.ndarray]]] = {"cells": {}, str(_SIZE): {}}
    for size, rows in itertools.product(found, _ROWS[setting.size]):
        keys = _KEYS[setting.size] | {"style": ["flames"], "motif_size": size if size == "cells" else float(size)}
        run = setting.stylized(f"motif-{size}-{rows}", _with_rows(frame, rows), **keys)
        found[size][rows] = _pictures(run)
    likeness = {
        size: {f"{a} and {b}": _correlation(pictures[a], pictures[b]) for a, b in itertools.combinations(pictures, 2)}
        for size, pictures in found.items()
    }
    (today, fixed), names = (min(likeness[size].values()) for size in found), ", ".join(map(str, _ROWS[setting.size]))
    balls = {size: _of_ball(setting, size) for size in _SIZES}
    lengths = {size: correlation_length(after - before) / _BALL[1] for size, (before, after) in balls.items()}
    ratios = [lengths[b] / lengths[a] for a, b in itertools.pairwise(_SIZES)]
    jets = [
        [Panel(after, f"motif_size {size}, {rows} rows") for rows, (_, after) in found[size].items()] for size in found
    ]
    sizes = [
        Panel(after, f"motif_size {size}\n{lengths[size]:.3f} of the height") for size, (_, after) in balls.items()
    ]
    return Made(
        [*jets, sizes],
        [
            Claim(
                f"With motif_size {_SIZE}, changes of grids of {names} rows correlate by {fixed:.2f} or more "
                f"(pictures of {_COMPARED} rows), where those of cells correlate by {today:.2f}",
                fixed >= _ALIKE and fixed > today,
            ),
            Claim(
                "Motifs twice as large have "
                + " and ".join(f"{ratio:.2f}" for ratio in ratios)
                + " times the correlation length",
                all(_DOUBLED[0] <= ratio <= _DOUBLED[1] for ratio in ratios),
            ),
        ],
        {"correlation": likeness, "correlation length by motif size": {str(k): v for k, v in lengths.items()}},
    )


def _with_rows(frame: Frame, rows: int) -> Frame:
    """The frame on cells of another size, without its velocity."""
    h = frame.density.shape[1] / rows
    depth, height, width = (round(n / h) for n in frame.density.shape)
    return Frame(resample_density(frame.density, 1.0, (depth, height, width), h), name=frame.name, number=frame.number)


def _pictures(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """The front view before and after: as thick and as bright on every grid."""
    rows = run.density.shape[1]
    views = [
        np.asarray(render(d, gamma=0.1 * 96 / rows, quadrature="exact")) for d in (run.frames[0].density, run.density)
    ]
    return views[0] / views[0].max(), views[1] / views[0].max()


def _correlation(one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]) -> float:
    """Of the changes, brought to a common size by means over areas."""
    columns = round(_COMPARED * one[0].shape[1] / one[0].shape[0])
    changes = [
        np.asarray(Image.fromarray(np.float32(after - before)).resize((columns, _COMPARED), Image.Resampling.BOX))
        for before, after in (one, other)
    ]
    return float(np.corrcoef(changes[0].ravel(), changes[1].ravel())[0, 1])


def _of_ball(setting: Setting, size: float) -> tuple[np.ndarray, np.ndarray]:
    keys = _KEYS[setting.size] | {"octaves": 1, "iterations": 20, "semantic": [_CHANNEL], "motif_size": size}
    run = setting.stylized(f"motif-ball-{size}", Frame(ball(_BALL, 0), name="ball"), **keys)
    return _pictures(run)


FIGURE = Figure(
    "The size of motifs",
    "The network sees images of as many pixels as the grid has cells, so that motifs have the size of its receptive "
    "fields in cells, whatever the grid.",
    make,
    "Not a figure of the paper: `motif_size` fixes the rows of the images instead (docs/motifs.md). The correlation "
    "length is the distance at which the autocorrelation of the change, as seen from the front, falls to 0.",
)
