"""All pictures of a comparison on one sheet: a row for each style, a column for each input and variant."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tnst_mi.io.atomic import written_whole

#: Width of a picture on the sheet in inches, and pixels per inch.
_WIDTH, _DPI = 1.5, 100


@dataclass(frozen=True, eq=False)
class Panel:
    """A grey picture (H, W) in [0, 1] with the words below it."""

    picture: np.ndarray
    caption: str


def write_sheet(path: Path, rows: Sequence[Sequence[Panel]], title: str) -> None:
    """Write a PNG of rows of equally many pictures."""
    height = _WIDTH * max(panel.picture.shape[0] / panel.picture.shape[1] for row in rows for panel in row) + 0.55
    columns = len(rows[0])
    figure = Figure(figsize=(columns * (_WIDTH + 0.1), len(rows) * height + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(rows), columns, squeeze=False)
    for row, of_row in zip(rows, grid, strict=True):
        for panel, axes in zip(row, of_row, strict=True):
            axes.imshow(np.clip(panel.picture, 0, 1), cmap="gray", vmin=0, vmax=1, interpolation="nearest")
            axes.set(xticks=[], yticks=[])
            axes.set_xlabel(panel.caption, fontsize=7)
    figure.suptitle(textwrap.fill(title, 22 * columns), fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as temporary:
        figure.savefig(str(temporary), dpi=_DPI, format="png")
