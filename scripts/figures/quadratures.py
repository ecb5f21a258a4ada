"""The product of density and transmittance, with and without its discretisation (paper, section of the renderer)"""

from __future__ import annotations

import numpy as np
import torch

from figures.figure import Claim, Figure, Made, Panel, Plot
from figures.measures import depth_of_change
from figures.seen import before_and_after, smoke_box
from figures.setting import Setting
from tnst_mi import render

_GAMMA = 1.0
_KEYS = {"small": {"octaves": 2, "iterations": 15, "views": 2}, "paper": {"octaves": 3, "iterations": 20, "views": 9}}


def make(setting: Setting) -> Made:
    """Compare both along a line of sight, and what they make of one frame."""
    frame = setting.close_up(setting.smoke("smokejet", 61)[0])
    row, column = np.unravel_index(frame.density.sum(axis=0).argmax(), frame.density.shape[1:])
    # The camera of the view (0, 0) is at the end of the z axis.
    along = frame.density[::-1, row, column]
    slopes, depths, panels = {}, {}, []
    for quadrature in ("exact", "paper"):
        density = torch.tensor(frame.density, requires_grad=True)
        render(density, gamma=_GAMMA, quadrature=quadrature)[frame.density.shape[1] - 1 - row, column].backward()
        slope = density.grad.numpy()[::-1, row, column]
        slopes[quadrature] = slope / np.abs(slope).max()
        run = setting.stylized(
            f"quadrature-{quadrature}",
            frame,
            style=["spirals"],
            gamma=_GAMMA,
            quadrature=quadrature,
            **_KEYS[setting.size],
        )
        depths[quadrature] = depth_of_change(frame.density, run.density - frame.density)
        before, after = before_and_after(run)
        box = smoke_box([before, after])
        panels += [Panel(before[box], f"input, {quadrature}"), Panel(after[box], f"stylized, {quadrature}")]
    spread = {name: float(np.ptp(slope)) for name, slope in slopes.items()}
    cells = list(range(len(along)))
    plot = Plot(
        {"density": (cells, along), **{f"derivative, {name}": (cells, slope) for name, slope in slopes.items()}},
        "cells from the camera",
        "",
        "the densest line of sight",
    )
    return Made(
        [[*panels, plot]],
        [
            Claim(
                f"Along the densest line of sight, the derivatives of its pixel differ by {spread['exact']:.0e} of the "
                f"largest of them with the exact integral, and by {spread['paper']:.2f} with the paper's sum",
                spread["exact"] < 1e-5 and spread["paper"] > 0.5,
            ),
            Claim(
                f"The paper's sum stylizes what is in front (the change lies behind {depths['paper']:.0%} of the smoke "
                f"of its line of sight), the exact one all alike ({depths['exact']:.0%})",
                depths["paper"] < depths["exact"] - 0.1,
            ),
        ],
        {"spread_of_derivatives": spread, "depth_of_change": depths},
    )


FIGURE = Figure(
    "Product of density and transmittance, summed or integrated",
    "Smoke is rendered as the product of density and transmittance, integrated along the line of sight; the supplement "
    "compares it with transmittance integrated without the density.",
    make,
    "Another comparison than the paper's. Integrated exactly, the product is opacity alone, (1 − T)/γ, at any γ, and "
    "knows nothing of what is in front; the dependence on depth is all of the discretisation, the authors' inclusive "
    "sum. So this compares *paper* with *exact*, at γ 1. The supplement was not at hand.",
)
