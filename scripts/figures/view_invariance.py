"""Why a camera needs only two angles: pan, roll and zoom change nothing (paper, section 4.1)"""

from __future__ import annotations

import numpy as np

from figures.figure import Claim, Figure, Made, Panel
from figures.seen import FRONT, JUDGED, images_of, losses_of
from figures.setting import Run, Setting
from tnst_mi import render
from tnst_mi.frame import Frame
from tnst_mi.losses.style import Style

#: By how many cells the smoke is moved, up and to the right: a whole number of the network's strides.
_PAN = 8
_GAMMA = 0.1
_KEYS = {"small": {"octaves": 1, "iterations": 20, "views": 2}, "paper": {"octaves": 1, "iterations": 25, "views": 9}}


def make(setting: Setting) -> Made:
    """Move, turn and refine one frame, and see whether images and stylization move, turn and stay with it."""
    smoke = setting.smoke("smokejet", 61)[0].density
    frame = Frame(np.pad(smoke, ((0, 0), (_PAN, _PAN), (_PAN, _PAN))), name="at_rest")
    moved = Frame(_panned(frame.density), name="moved")
    image = np.asarray(render(frame.density, FRONT, _GAMMA))
    errors = {"pan": _error(np.asarray(render(moved.density, FRONT, _GAMMA)), _panned(image))}
    # The plane of the image is that of x and y, and rows of images go down.
    turned = np.ascontiguousarray(np.rot90(frame.density, axes=(1, 2)))
    errors["roll"] = _error(np.asarray(render(turned, FRONT, _GAMMA)), np.rot90(image, -1))
    # Cells of half the size: every one is split into eight of the same density.
    fine = np.kron(frame.density, np.ones((2, 2, 2), np.float32))
    for quadrature in ("paper", "exact"):
        near, far = (
            np.asarray(render(density, FRONT, _GAMMA, quadrature, h))
            for density, h in ((fine, 0.5), (frame.density, 1.0))
        )
        errors[f"zoom, {quadrature}"] = _error(near, np.kron(far, np.ones((2, 2))))

    keys = {"style": ["spirals"], "gamma": _GAMMA, **_KEYS[setting.size]}
    runs = {
        "at rest": setting.stylized("invariance-rest", frame, **keys),
        "moved": setting.stylized("invariance-moved", moved, **keys),
        "other views": setting.stylized("invariance-seed", frame, **keys, seed=1),
    }
    style = Style(runs["moved"].recipe.style[0], runs["moved"].recipe.style_layers)
    before = losses_of(setting, style, images_of(runs["moved"], frame.density, JUDGED))[style.name].mean()
    losses = {
        name: float(losses_of(setting, style, images_of(run, run.density, JUDGED))[style.name].mean() / before)
        for name, run in runs.items()
    }
    changes = {name: _change(run) for name, run in runs.items()}
    alike = {
        "moved": _correlation(_panned(changes["at rest"]), changes["moved"]),
        "other views": _correlation(changes["at rest"], changes["other views"]),
    }
    panels = [Panel(image * runs["moved"].exposure, "input")]
    panels += [Panel(images_of(run, run.density)[0], f"stylized, {name}") for name, run in runs.items()]
    return Made(
        [panels],
        [
            Claim(
                f"Images move, turn and grow with the smoke: they differ by {errors['pan']:.0e} of their brightest "
                f"pixel (moved by {_PAN} cells up and right), {errors['roll']:.0e} (turned by 90° about the line of "
                f"sight) and {errors['zoom, exact']:.0e} (each cell split into eight; with the paper's sum, which "
                f"depends on the step, by {errors['zoom, paper']:.3f})",
                max(error for name, error in errors.items() if name != "zoom, paper") < 1e-5,
            ),
            Claim(
                f"Of the style distance, {losses['moved']:.1%} is left for the moved smoke and {losses['at rest']:.1%} "
                "for that at rest",
                abs(losses["moved"] - losses["at rest"]) < 0.03,
            ),
            Claim(
                f"The stylization moves with the smoke: the changes seen correlate by {alike['moved']:.2f}, "
                f"and by {alike['other views']:.2f} between two runs that differ in their random views",
                alike["moved"] > alike["other views"] - 0.1,
            ),
        ],
        {"largest_image_error": errors, "distance_left": losses, "correlation_of_changes": alike},
    )


def _panned(field: np.ndarray) -> np.ndarray:
    """Moved up and to the right: a density (D, H, W), whose y points up, or an image (H, W), whose rows go down."""
    up = _PAN if field.ndim == 3 else -_PAN
    return np.ascontiguousarray(np.roll(field, (up, _PAN), axis=(-2, -1)))


def _error(image: np.ndarray, expected: np.ndarray) -> float:
    return float(np.abs(image - expected).max() / expected.max())


def _change(run: Run) -> np.ndarray:
    return images_of(run, run.density)[0] - images_of(run, run.frames[0].density)[0]


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


FIGURE = Figure(
    "Pan, roll and zoom",
    "The camera looks at the centre from two angles; pan, roll and zoom of an orthographic camera would show the "
    "network nothing else.",
    make,
    "The network is invariant to shifts only up to its strides and the borders of the image, and not to rotation; so "
    "stylizations move with the smoke nearly, not exactly.",
)
