"""Defaults that depend on what a recipe gives: presets, and what one key implies of another."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

#: By name, the keys that a preset sets. Goals, and what the paper's own examples vary (γ, η, octaves, window, range of
#: the views), keep our defaults, which are those of the paper wherever it names one.
PRESETS: Mapping[str, Mapping[str, Any]] = {
    # The formulas of the paper; docs/paper.md says what each of these keys decides, and why our default differs.
    "paper": {
        # Eq. 1, 2 and 7.
        "style_loss": "paper",
        "style_statistics": "image",
        "loss_scaling": "none",
        "sigma": "loss",
        "damping": 0.0,
        # Eq. 3, 4 and 8: one step of transport, of a velocity that may converge.
        "lam": 1.0,
        "parameterisation": "transport",
        "steps": 1,
        "transport": "step",
        # Eq. 9, 10 and Algorithm 1.
        "window_weights": "uniform",
        "window_average": "plain",
        "step_order": "align_first",
        "coherence": 0.0,
        "mask_strength": 1.0,
        # Eq. 11, of the density as it was simulated.
        "density_scale": 1.0,
        "integrator": "emission_absorption",
        "quadrature": "paper",
        "fit": False,
        # Section 4: Laplacian pyramid, octaves, images of the grid's fineness, iterations, views.
        "motif_size": "cells",
        "pyramid_levels": 3,
        "scale_factor": 1.8,
        "iterations": 20,
        "views": 9,
    },
}


def implied(given: Collection[str], preset: str | None, lam: float, steps: int | str, of_flow: bool) -> dict[str, Any]:
    """The defaults of the keys that are not given, where they differ from those of a recipe that gives nothing.

    Where smoke may converge, one step comes nearer to a goal than the flow, which keeps the smoke otherwise
    (docs/transport.md). Only a step has sub-steps, and only the flow stages and a conservative form.

    Args:
        given: the keys that the recipe gives.
        preset: of the recipe.
        lam: its λ, the largest of any frame.
        steps: its sub-steps.
        of_flow: whether it has stages or a conservative form.

    Example:
        >>> implied({"lam"}, None, lam=0.5, steps=1, of_flow=False)
        {'transport': 'step'}
    """
    keys = {"transport": "step"} if steps != 1 or (lam > 0 and not of_flow) else {}
    return {name: value for name, value in (keys | dict(PRESETS.get(preset or "", {}))).items() if name not in given}
