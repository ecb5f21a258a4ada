"""Style transfer over six pictures of three kinds: does each result take on its own? (paper, figure of styles)"""

from __future__ import annotations

import numpy as np

from figures.figure import Claim, Figure, Made, Panel
from figures.seen import JUDGED, images_of, losses_of, smoke_box
from figures.setting import Setting
from tnst_mi.losses.style import Style

_KINDS = {
    "fire": "photograph",
    "erupting_volcano": "photograph",
    "starry_night": "painting",
    "spirals": "drawing",
    "net": "pattern",
    "cells": "pattern",
}
#: Pictures of unknown terms, which a figure must not show.
_TERMS_UNKNOWN = {"erupting_volcano"}
_KEYS = {"small": {"octaves": 2, "iterations": 20, "views": 3}, "paper": {"octaves": 2, "iterations": 20, "views": 9}}


def make(setting: Setting) -> Made:
    """Stylize one frame with each picture, and compare every result with every picture by their Gram matrices."""
    frame = setting.close_up(setting.smoke("smokejet", 61)[0])
    paths = {name: path for name in _KINDS if (path := setting.style(name)) is not None}
    runs = {
        name: setting.stylized(f"styles-{name}", frame, style=[path], **_KEYS[setting.size])
        for name, path in paths.items()
    }
    any_run = next(iter(runs.values()))
    terms = {name: Style(run.recipe.style[0], run.recipe.style_layers) for name, run in runs.items()}
    seen = {"input": images_of(any_run, frame.density, JUDGED)}
    seen |= {name: images_of(run, run.density, JUDGED) for name, run in runs.items()}
    distances = {
        result: {name: float(losses_of(setting, term, images)[term.name].mean()) for name, term in terms.items()}
        for result, images in seen.items()
    }

    own = [name for name in runs if min(runs, key=lambda result: distances[result][name]) == name]
    others = [distances[result][name] for name in runs for result in runs if result != name]
    claims = [
        Claim(
            f"Of the {len(runs)} results, the one nearest to a style by Gram distance is that style's own for "
            f"{len(own)} of {len(runs)}: {np.mean([distances[name][name] for name in runs]):.2f} on average, "
            f"against {np.mean(others):.2f} of the other results",
            len(own) == len(runs),
        ),
        Claim(
            "Every result is nearer to its style than the input is, by "
            + ", ".join(f"{1 - distances[name][name] / distances['input'][name]:.0%} ({name})" for name in runs),
            all(distances[name][name] < distances["input"][name] for name in runs),
        ),
    ]
    box = smoke_box([images[0] for images in seen.values()])
    size = seen["input"][0].shape
    pictures = [
        Panel(np.ones(size), f"{name.replace('_', ' ')} ({_KINDS[name]}),\nterms unknown: not shown")
        if name in _TERMS_UNKNOWN
        else Panel(term.picture.fitted(*size).grey, f"{name.replace('_', ' ')} ({_KINDS[name]})")
        for name, term in terms.items()
    ]
    results = [Panel(seen[name][0][box], f"distance {distances[name][name]:.2f}") for name in runs]
    missing = [name for name in _KINDS if name not in paths]
    return Made(
        [[*pictures, Panel(seen["input"][0][box], "input")], results],
        claims,
        {"gram_distance_of_result_to_style": distances},
        [f"Not found here, and left out: {', '.join(missing)}."] if missing else [],
    )


FIGURE = Figure(
    "Style transfer from pictures of three kinds",
    "Photographs, paintings and patterns each lend the smoke their own structures, without retraining anything.",
    make,
    "Pictures other than the paper's, but for Starry Night and those of fire and a volcano; the smoke fills the grid "
    "only as a close-up. Distances are relative, ‖G − Gₛ‖²/‖Gₛ‖² summed over three layers, as means over three views.",
)
