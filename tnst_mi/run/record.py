"""What run.json says of a frame, and of a sequence as a whole: how steady it is, and what that cost."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from tnst_mi.frame import Frame
from tnst_mi.optimisation.result import Stylized
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.flicker import FlickerMeter, relative_change


def frame_record(frame: Frame, step_scale: float, stylized: Stylized) -> dict[str, Any]:
    """What a run has made of a frame.

    Args:
        frame: as it came in.
        step_scale: its factor of η.
        stylized: what the optimisation gave.
    """
    return {
        "name": frame.name,
        "number": frame.number,
        "complete": not stylized.interrupted,
        "note": stylized.note,
        "mass_before": frame.mass,
        "mass_after": float(stylized.density.sum(dtype=np.float64)),
        "largest_displacement": float(np.sqrt(np.einsum("...c,...c", stylized.velocity, stylized.velocity).max())),
        "step_scale": step_scale,
        "loss_before": stylized.loss_before,
        "loss_after": stylized.loss_after,
        "terms_before": stylized.terms_before,
        "terms_after": stylized.terms_after,
        "losses": _losses_by_octave(stylized.history),
        "timings": stylized.timings,
    }


def sequence_record(
    recipe: Recipe, frames: Iterable[Frame], densities: Iterable[np.ndarray], records: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """Flicker by pair, always with the loss reduction and the size of the change.

    Args:
        recipe: the recipe of the run.
        frames: the frames as they came in.
        densities: their stylized densities, (D, H, W).
        records: their records, with the loss before and after.

    Returns:
        window; flicker (mean over the pairs) and flicker_pairs; relative_changes ‖d* − d‖/‖d‖ by frame, and their mean;
        loss_before and loss_after, means over the frames, and of the unscaled terms likewise; loss_reduction,
        1 − after/before where that has a meaning.
    """
    meter, changes = FlickerMeter(), []
    for frame, density in zip(frames, densities, strict=True):
        meter.add(frame.name, frame.density, density, frame.velocity)
        changes.append(relative_change(frame.density, density))
    before, after = (_mean([record[key] for record in records]) for key in ("loss_before", "loss_after"))
    return {
        "window": recipe.window,
        "flicker": meter.mean,
        "flicker_pairs": meter.pairs,
        "relative_changes": changes,
        "relative_change": _mean(changes),
        "loss_before": before,
        "loss_after": after,
        **{key: _mean_terms([record[key] for record in records]) for key in ("terms_before", "terms_after")},
        # Style distances are positive; activations to be raised are losses below 0, of which no share can be told.
        "loss_reduction": None if before is None or after is None or before <= 0 else 1 - after / before,
    }


def _mean_terms(terms: Sequence[dict[str, float]]) -> dict[str, float | None]:
    names = dict.fromkeys(name for of_frame in terms for name in of_frame)
    return {name: _mean([of_frame.get(name) for of_frame in terms]) for name in names}


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _losses_by_octave(history: list[dict[str, Any]]) -> list[list[float]]:
    octaves: dict[int, list[float]] = {}
    for entry in history:
        octaves.setdefault(entry["octave"], []).append(entry["loss"])
    return [octaves[octave] for octave in sorted(octaves)]
