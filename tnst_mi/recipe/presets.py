"""Presets: named sets of defaults. Keys that a recipe gives stay as it gives them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

#: By name, the keys that a preset sets. Goals, and what the paper's own examples vary (λ, γ, η, octaves, window, range
#: of the views), keep our defaults, which are those of the paper wherever it names one.
PRESETS: Mapping[str, Mapping[str, Any]] = {
    # The formulas of the paper; docs/paper.md says what each of these keys decides, and why our default differs.
    "paper": {
        # Eq. 1, 2 and 7.
        "style_loss": "paper",
        "loss_scaling": "none",
        "sigma": "loss",
        "damping": 0.0,
        # Eq. 3, 4 and 8: one step of transport.
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
        # Section 4: Laplacian pyramid, octaves, iterations, views.
        "pyramid_levels": 3,
        "scale_factor": 1.8,
        "iterations": 20,
        "views": 9,
    },
}
