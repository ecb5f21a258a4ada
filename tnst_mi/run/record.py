"""The records in run.json of a frame, and of a sequence as a whole: how steady it is, and at what cost."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tnst_mi.fields.folding import folded_share
from tnst_mi.frame import Frame
from tnst_mi.optimisation.plan import FramePlan
from tnst_mi.optimisation.result import Stylized
from tnst_mi.recipe.paths import shipped_name
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.region_keys import GOALS
from tnst_mi.recipe.targets import Target
from tnst_mi.regions.measured_masks import MeasuredMask
from tnst_mi.run.flicker import FlickerMeter, relative_change


def frame_record(frame: Frame, plan: FramePlan, stylized: Stylized) -> dict[str, Any]:
    """The record of a stylized frame.

    Args:
        frame: the input frame.
        plan: its plan.
        stylized: the result of the optimisation.
    """
    return {
        "name": frame.name,
        "number": frame.number,
        "complete": not stylized.interrupted,
        "note": stylized.note,
        "mass_before": frame.mass,
        "mass_after": float(stylized.density.sum(dtype=np.float64)),
        "largest_displacement": float(np.sqrt(np.einsum("...c,...c", stylized.velocity, stylized.velocity).max())),
        "folded": _folded(plan.recipe, stylized),
        "exposure": plan.exposure,
        "gamma": plan.recipe.extinction,
        "step_scale": plan.step_scale,
        "loss_before": stylized.loss_before,
        "loss_after": stylized.loss_after,
        "terms_before": stylized.terms_before,
        "terms_after": stylized.terms_after,
        "losses": _losses_by_octave(stylized.history),
        "timings": stylized.timings,
    }


def run_identity(recipe: Recipe, run: Mapping[str, Any]) -> str:
    """What identifies a run: the SHA-256 of everything that the bits of its working state depend on.

    Args:
        recipe: the recipe of the run.
        run: the contents of run.json.
    """
    decisive = [replace(recipe, fps=None).to_toml(), run["weights"]["sha256"], run["inputs"], run["files"]]
    if run.get("targets"):
        decisive.append([target["mask_sha256"] for target in run["targets"]])
    if run.get("from") is not None:
        decisive.append(run["from"]["states"])
    return hashlib.sha256(json.dumps(decisive).encode("utf-8")).hexdigest()


def target_record(target: Target, mask: MeasuredMask) -> dict[str, Any]:
    """The record of a target: its goal, mask and weight as the recipe has them, and what it reaches.

    Args:
        target: the target.
        mask: its mask in all frames.
    """
    recipe = target.recipe
    goals = {goal: [shipped_name(name) for name in getattr(recipe, goal)] for goal in GOALS if getattr(recipe, goal)}
    weight = dict(target.weights) if isinstance(target.weights, tuple) else target.weights
    return {
        "goals": goals,
        "mask": list(target.mask),
        "weight": weight,
        "smoke_shares": mask.smoke_shares,
        "mask_sha256": mask.sha256,
    }


def _folded(recipe: Recipe, stylized: Stylized) -> float | None:
    """`folded_share` of the transport, or of each of its sub-steps; None where their number is not fixed."""
    if recipe.parameterisation != "transport" or not isinstance(recipe.steps, int):
        return None
    stages = recipe.stages if isinstance(recipe.stages, int) else None
    return folded_share(stylized.density, stylized.velocity / np.float32(recipe.steps), recipe.transport, stages)


def sequence_record(
    recipe: Recipe, frames: Iterable[Frame], densities: Iterable[np.ndarray], records: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """Flicker per pair, always together with the loss reduction and the size of the change.

    Args:
        recipe: the recipe of the run.
        frames: the input frames.
        densities: their stylized densities, (D, H, W).
        records: their records, with the loss before and after.

    Returns:
        window; flicker (mean over the pairs) and flicker_pairs; relative_changes ‖d* − d‖/‖d‖ per frame, and their
        mean; mass_changes Σ d*/Σ d − 1 per frame, None without smoke, and mass_drift, the largest less the smallest of
        them; loss_before and loss_after, means over the frames, and likewise those of the unscaled terms;
        loss_reduction, 1 − after/before where that is meaningful.
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
        "mass_changes": (masses := [mass_change(record) for record in records]),
        "mass_drift": _range(masses),
        "loss_before": before,
        "loss_after": after,
        **{key: _mean_terms([record[key] for record in records]) for key in ("terms_before", "terms_after")},
        # Only a positive loss (style distances) can fall by a share; activations to be raised are negative losses.
        "loss_reduction": None if before is None or after is None or before <= 0 else 1 - after / before,
    }


def mass_change(record: dict[str, Any]) -> float | None:
    """Σ d*/Σ d − 1 of the record of a frame; None if it has no smoke."""
    return record["mass_after"] / record["mass_before"] - 1 if record["mass_before"] > 0 else None


def _range(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return max(known) - min(known) if known else None


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
    # Of a damaged log, octaves may be missing.
    return [octaves.get(octave, []) for octave in range(max(octaves, default=-1) + 1)]
