"""An obstacle in the flow: does stylization push smoke into it? (paper's supplement)"""

from __future__ import annotations

import numpy as np

from figures.figure import Claim, Figure, Made, Panel
from figures.measures import mass_change
from figures.seen import images_of, smoke_box
from figures.setting import Setting

_FRAME = {"small": 56, "paper": 60}
_KEYS = {
    "small": {"style": ["spirals"], "octaves": 2, "iterations": 15, "views": 3},
    "paper": {"style": ["spirals"], "octaves": 3, "iterations": 20, "views": 9},
}
_LAMS = (1.0, 0.0)


def make(setting: Setting) -> Made:
    """Stylize smoke that flows around a solid, and add up what is inside the solid before and after."""
    frame = setting.smoke("obstacle", _FRAME[setting.size])[0]
    solid = frame.obstacle
    runs = {lam: setting.stylized(f"obstacle-{lam:g}", frame, lam=lam, **_KEYS[setting.size]) for lam in _LAMS}
    around = _grown(solid) & ~solid
    inside_before = float(frame.density[solid].sum(dtype=np.float64))
    inside = {lam: float(run.density[solid].sum(dtype=np.float64)) for lam, run in runs.items()}
    change = {
        lam: float(np.abs(run.density - frame.density)[around].sum() / frame.density[around].sum())
        for lam, run in runs.items()
    }
    middle = int(np.flatnonzero(solid.any(axis=(1, 2))).mean())
    densities = {"input": frame.density} | {f"λ = {lam:g}": run.density for lam, run in runs.items()}
    images = {name: images_of(runs[1.0], density)[0] for name, density in densities.items()}
    box = smoke_box([*images.values(), solid.any(axis=0)[::-1].astype(np.float32)])
    whole = [Panel(_tinted(image, solid.any(axis=0))[box], name) for name, image in images.items()]
    cuts = [
        Panel(_tinted(density[middle, ::-1], solid[middle])[box], f"slice; {density[solid].sum():.3g} in the solid")
        for density in densities.values()
    ]
    return Made(
        [whole, cuts],
        [
            Claim(
                f"In the solid ({int(solid.sum())} cells) is no more smoke than the input had: {inside_before:.3g} "
                "before, " + " and ".join(f"{inside[lam]:.3g} (λ = {lam:g})" for lam in _LAMS) + " after",
                all(value <= inside_before * (1 + 1e-6) for value in inside.values()),
            ),
            Claim(
                "The smoke that touches the solid is changed, by "
                + " and ".join(f"{change[lam]:.0%}" for lam in _LAMS),
                min(change.values()) > 0.05,
            ),
        ],
        {
            "mass_in_solid_before": inside_before,
            "mass_in_solid": inside,
            "change_next_to_solid": change,
            "mass_change": {lam: mass_change(frame.density, run.density) for lam, run in runs.items()},
        },
    )


def _grown(cells: np.ndarray) -> np.ndarray:
    """Cells and their six neighbours each; the outermost ones of the grid are taken to be apart."""
    return np.logical_or.reduce([np.roll(cells, step, axis) for axis in range(3) for step in (-1, 0, 1)])


def _tinted(image: np.ndarray, solid: np.ndarray) -> np.ndarray:
    """A picture (H, W), its rows from the top, and behind it in blue what is solid (H, W), its rows from below."""
    blue = np.array([0.1, 0.25, 0.6]) * solid[::-1, :, None]
    image = np.clip(image, 0, 1)[..., None]
    return image + (1 - image) * blue


FIGURE = Figure(
    "Smoke around an obstacle",
    "Stylization works where smoke meets obstacles, too; a little of it may end up inside them.",
    make,
    "Ours keeps smoke out: the mask is 0 in the solid, and v* is set to 0 there. Without the latter, velocities of the "
    "outermost cells of the solid carried in 0.4% of the smoke of this frame (28.8 for λ = 1, 25.6 for λ = 0).",
)
