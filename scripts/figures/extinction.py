"""γ of the optimisation against the thickness of the final look (paper, figure of transmittance γ 0.01 and 1)"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from figures.figure import Claim, Figure, Made, Panel
from figures.measures import depth_of_change, visible_share
from figures.seen import FRONT, JUDGED, images_of, losses_of
from figures.setting import Setting
from tnst_mi.choices import LOOKS
from tnst_mi.losses.style import Style
from tnst_mi.rendering.pictures import PathTracedPainter

_GAMMAS = (0.01, 1.0)
_KEYS = {
    "small": {"octaves": 2, "iterations": 20, "views": 3},
    "paper": {"octaves": 3, "iterations": 20, "views": 9},
}
#: Size (width, height) and paths per pixel of the final looks.
_LOOK = {"small": ((72, 96), 48), "paper": ((400, 600), 512)}


def make(setting: Setting) -> Made:
    """Stylize one frame as thin and as thick smoke, and light both results in the looks."""
    frame = setting.close_up(setting.smoke("smokejet", 61)[0])
    runs = {
        gamma: setting.stylized(f"gamma-{gamma:g}", frame, style=["spirals"], gamma=gamma, **_KEYS[setting.size])
        for gamma in _GAMMAS
    }
    thin, thick = _GAMMAS
    seen = {gamma: visible_share(frame.density, run.density - frame.density, thick) for gamma, run in runs.items()}
    depths = {gamma: depth_of_change(frame.density, run.density - frame.density) for gamma, run in runs.items()}
    style = Style(runs[thin].recipe.style[0], runs[thin].recipe.style_layers)
    distances = {
        judged: {
            gamma: float(losses_of(setting, style, images_of(runs[judged], run.density, JUDGED))[style.name].mean())
            for gamma, run in runs.items()
        }
        for judged in _GAMMAS
    }
    size, samples = _LOOK[setting.size]
    densities = {"input": frame.density, **{f"γ {gamma:g}": run.density for gamma, run in runs.items()}}
    inside = {"input": frame.density} | {
        f"change, γ {gamma:g}": np.abs(run.density - frame.density) for gamma, run in runs.items()
    }
    rows = [[Panel(_from_the_left(field), f"{name}, side")] for name, field in inside.items()]
    for look in LOOKS:
        painter = PathTracedPainter([frame], [FRONT], look, "volpath", size, samples, 0, False)
        for row, (name, density) in zip(rows, densities.items(), strict=True):
            row.append(
                Panel(painter.shown(painter.paint(replace(frame, density=density), FRONT, 0)), f"{name}, {look}")
            )
    return Made(
        rows,
        [
            Claim(
                f"Of the change, thick smoke (γ {thick:g}) shows {seen[thin]:.0%} after stylizing with γ {thin:g}, and "
                f"{seen[thick]:.0%} after γ {thick:g}: the one is inside, the other at the surface",
                seen[thick] > 1.5 * seen[thin],
            ),
            Claim(
                f"Each is nearer to the style in smoke as it was meant for: distances {distances[thin][thin]:.2f} "
                f"against {distances[thin][thick]:.2f} seen with γ {thin:g}, {distances[thick][thick]:.2f} against "
                f"{distances[thick][thin]:.2f} seen with γ {thick:g}",
                distances[thin][thin] < distances[thin][thick] and distances[thick][thick] < distances[thick][thin],
            ),
        ],
        {
            "share_of_change_seen": {f"{gamma:g}": share for gamma, share in seen.items()},
            "depth_of_change": {f"{gamma:g}": depth for gamma, depth in depths.items()},
            "style_distance_by_gamma_seen_with_and_optimised": {
                f"{judged:g}": {f"{gamma:g}": value for gamma, value in row.items()}
                for judged, row in distances.items()
            },
        },
    )


def _from_the_left(field: np.ndarray) -> np.ndarray:
    """A field (D, H, W) summed along x, (H, D), with the camera of the view (0, 0) on the right; its largest is 1."""
    image = field.sum(axis=2).T[::-1]
    return image / image.max()


FIGURE = Figure(
    "γ of the optimisation, and thickness of the final look",
    "A small γ lets the network see through the smoke and stylizes its inside, for thin looks; a large one stylizes "
    "what is seen of thick smoke, its surface.",
    make,
    "The paper's final pictures are of an offline renderer, ours of Mitsuba's path tracer, in the looks of "
    "scenes/looks. In the left column smoke and change are summed across the line of sight, the "
    "camera being on the right.",
)
