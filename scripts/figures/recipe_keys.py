"""What each key of a recipe changes: one frame, one style, and one key at a time"""

from __future__ import annotations

from typing import Any

import numpy as np

from figures.figure import Claim, Figure, Made, Panel
from figures.measures import correlation_length, mass_change
from figures.seen import before_and_after, smoke_box
from figures.setting import Run, Setting
from tnst_mi import Recipe, render

_RECIPE = {
    "small": {"style": ["flames"], "octaves": 2, "iterations": 20, "views": 3},
    "paper": {"style": ["flames"], "octaves": 3, "iterations": 20, "views": 9},
}

#: What is wanted, and the keys that give it. Rows of the picture.
WANTED: list[dict[str, dict[str, Any]]] = [
    {
        "as it is": {},
        "weaker": {"strength": 0.4},
        "gentler": {"reach": "5%"},
        "stronger": {"eta": 0.004, "iterations": 40},
        "keep the outline": {"keep_silhouette": "1%"},
        "dense parts only": {"mask_strength": 4.0},
    },
    {
        "bigger motifs": {"motif_size": 0.5},
        "smaller motifs": {"motif_size": 0.17},
        "finer strokes": {"style_layers": {"conv2/3x3": 1.0}},
        "larger shapes": {"style_layers": {"inception_4b/output": 1.0}},
        "through thin smoke": {"gamma": 0.02},
        "on thick smoke": {"gamma": 1.0},
    },
]

#: Share of the change that a weaker result may have at most, and ratio of lengths from smaller to bigger motifs.
_WEAKER, _BIGGER = 0.9, 1.3


def make(setting: Setting) -> Made:
    """Stylize one frame by each."""
    frame = setting.close_up(setting.smoke("smokejet", 61)[0], finer=1.3)
    recipe = Recipe.from_dict(_RECIPE[setting.size])
    runs = {
        name: setting.stylized(f"keys-{name.replace(' ', '-')}", frame, recipe, **keys)
        for row in WANTED
        for name, keys in row.items()
    }
    plain = runs["as it is"]
    seen = {name: _seen(run, plain) for name, run in runs.items()}
    before = before_and_after(plain)[0]
    box = smoke_box([before, *seen.values()])
    change = {name: float(np.linalg.norm(run.density - frame.density)) for name, run in runs.items()}
    relative = {name: norm / change["as it is"] for name, norm in change.items()}
    front = {name: render(run.density, gamma=0.1) - render(frame.density, gamma=0.1) for name, run in runs.items()}
    lengths = {name: correlation_length(np.asarray(image)) for name, image in front.items()}
    masses = {name: mass_change(frame.density, run.density) for name, run in runs.items()}
    rows: list[list[Panel]] = [
        [Panel(seen[name][box], f"{name}\n{_spelled(keys)}") for name, keys in row.items()] for row in WANTED
    ]
    rows[0].insert(0, Panel(before[box], "input"))
    rows[1].insert(0, Panel(_seen_before(runs["on thick smoke"])[box], "input, thick"))
    gentle = ("weaker", "gentler", "keep the outline")
    return Made(
        [list(row) for row in rows],
        [
            Claim(
                "‖d* − d‖, relative to that of the plain recipe: "
                + ", ".join(f"{name} {relative[name]:.2f}" for name in (*gentle, "stronger")),
                all(relative[name] < _WEAKER for name in gentle) and relative["stronger"] > 1,
            ),
            Claim(
                "The autocorrelation of the change falls to 0 within "
                + ", ".join(f"{lengths[name]:.1f} ({name})" for name in ("smaller motifs", "as it is", "bigger motifs"))
                + " cells",
                lengths["bigger motifs"] > _BIGGER * lengths["smaller motifs"],
            ),
            Claim(
                f"All of them keep the mass to {max(map(abs, masses.values())):.1%}",
                max(map(abs, masses.values())) < 0.05,
            ),
        ],
        {"relative_change": relative, "correlation_length": lengths, "mass_change": masses},
    )


def _seen(run: Run, plain: Run) -> np.ndarray:
    """The front view (H, W) as the recipe sees smoke, but always in images of the grid's fineness."""
    other = run if run.recipe.gamma != plain.recipe.gamma else plain
    return np.asarray(render(run.density, gamma=other.recipe.gamma)) * other.exposure


def _seen_before(run: Run) -> np.ndarray:
    return np.asarray(render(run.frames[0].density, gamma=run.recipe.gamma)) * run.exposure


def _spelled(keys: dict[str, Any]) -> str:
    return "\n".join(
        f"{name} {next(iter(value)) if isinstance(value, dict) else value}" for name, value in keys.items()
    )


FIGURE = Figure(
    "What each key of a recipe changes",
    "Weights, extinction, learning rate and layers decide the look.",
    make,
    "Not a figure of the paper: one key at a time, from the same recipe (docs/recipes.md).",
)
