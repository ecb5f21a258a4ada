"""γ from the look that the smoke will have in the end: fixed values and `gamma = "auto"`, judged in three looks"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from figures.figure import Claim, Figure, Made, Panel
from figures.seen import FRONT, losses_of
from figures.setting import Run, Setting
from tnst_mi import Frame, Recipe
from tnst_mi.choices import LOOKS
from tnst_mi.losses.style import Style
from tnst_mi.rendering.looks import gamma
from tnst_mi.rendering.pictures import PathTracedPainter

_RECIPE = {
    "small": {"octaves": 2, "iterations": 20, "views": 3},
    "paper": {"octaves": 3, "iterations": 20, "views": 9},
}
#: Simulation, frame, style.
_SCENES = (("smokejet", 61, "flames"), ("suzanne", 10, "spirals"))
_FIXED = (0.02, 0.1, 1.0)
#: Size (width, height) and paths per pixel.
_LOOK = {"small": ((144, 216), 128), "paper": ((400, 600), 256)}
#: The views of the final pictures that are judged.
_VIEWS = (FRONT, (-8.0, 0.0))


def make(setting: Setting) -> Made:
    """Stylize two frames with fixed γ and with those of the looks, and light each result in each look."""
    rows: list[list[Panel]] = []
    numbers: dict[str, dict[str, dict[str, float]]] = {}
    for scene, number, style in _SCENES:
        frame = setting.smoke(scene, number)[0]
        frame = setting.close_up(frame, finer=1.3) if scene == "smokejet" else frame
        recipe = Recipe.from_dict({**_RECIPE[setting.size], "style": [style]})
        fixed = {f"γ {g:g}": setting.stylized(f"look-{scene}-{g:g}", frame, recipe, gamma=g) for g in _FIXED}
        of_looks = {
            look: setting.stylized(f"look-{scene}-{look}", frame, recipe, gamma="auto", look=look) for look in LOOKS
        }
        everything = [frame, *(_frame(run) for run in (*fixed.values(), *of_looks.values()))]
        distances = numbers[scene] = {}
        for look in LOOKS:
            results = {"input": frame} | {name: _frame(run) for name, run in fixed.items()}
            results[f"auto: γ {gamma(look, frame.density.shape):.2g}"] = _frame(of_looks[look])
            seen = _seen(setting, everything, look, list(results.values()))
            judge = Style(of_looks[look].recipe.style[0], of_looks[look].recipe.style_layers)
            distances[look] = {
                "auto" if name.startswith("auto") else name: float(
                    losses_of(setting, judge, images.mean(-1))[judge.name].mean()
                )
                for name, images in zip(results, seen, strict=True)
            }
            if scene == _SCENES[0][0]:
                labels = [
                    f"{look}: {name}\nstyle distance {value:.2f}"
                    for name, value in zip(results, distances[look].values(), strict=True)
                ]
                rows.append([Panel(images[0], label) for images, label in zip(seen, labels, strict=True)])
    return Made(rows, [_claim(numbers)], {"style_distance_in_the_final_look": numbers})


def _claim(numbers: dict[str, dict[str, dict[str, float]]]) -> Claim:
    """Of what is gained by the best fixed value of each look, how much each way gains, mean over scenes and looks."""
    gains: dict[str, list[float]] = {}
    for looks in numbers.values():
        for found in looks.values():
            most = found["input"] - min(found.values())
            for name, value in found.items():
                gains.setdefault(name, []).append((found["input"] - value) / most)
    means = {name: float(np.mean(values)) for name, values in gains.items() if name != "input"}
    told = ", ".join(f"{name} {value:.0%} (at least {min(gains[name]):.0%})" for name, value in means.items())
    best = max(means, key=lambda name: means[name])
    return Claim(f"Of the largest gain in a look, over two scenes and three looks: {told}", best == "auto")


def _frame(run: Run) -> Frame:
    return replace(run.frames[0], density=np.asarray(run.density), velocity=None)


def _seen(setting: Setting, everything: list[Frame], look: str, frames: list[Frame]) -> list[np.ndarray]:
    """What a camera sees of frames in a look: (V, H, W, 3) of each, all with one exposure."""
    size, samples = _LOOK[setting.size]
    painter = PathTracedPainter(everything, list(_VIEWS), look, "volpath", size, samples, 0, False)
    return [np.stack([np.asarray(painter.shown(painter.paint(frame, view, 0))) for view in _VIEWS]) for frame in frames]


FIGURE = Figure(
    "γ from the final look",
    "A small γ lets the network see through the smoke and stylizes its inside, for thin looks; a large one stylizes "
    "what is seen of thick smoke, its surface.",
    make,
    "Not a figure of the paper: which γ looks best in the end (docs/looks.md). The style distance is that of the lit, "
    "path-traced pictures, which no stylization has seen.",
)
