"""Temporal coherence of the visible result: the change of the density is made to move with the smoke.

Aligned gradients (paper Alg. 1) make the potentials of neighbouring frames similar, but transported potentials do not
displace the smoke in quite the same way, and where the smoke has sharp detail this shows. So a frame's change
c_t = d*_t − d_t is compared with the average of the neighbouring changes, transported to it, and a separate step
reduces the difference:

    min ½ ‖c_t − c̄_t‖²,    c̄_t = Σ_i T_i^t(c_i) over the frame and its two neighbours, divided by their number.

This is not in the paper.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.kernels import opaque
from tnst_mi.fields.pyramid import root_mean_square
from tnst_mi.optimisation.items.state import Current, Items
from tnst_mi.optimisation.parameterisation import Fields
from tnst_mi.optimisation.plan import Plan
from tnst_mi.optimisation.temporal.window import window_of, window_weights

#: Number of frames whose changes are averaged: the nearest only, since changes from farther frames arrive blurred.
WINDOW = 3

#: Width of the gradient's blur in cells of the octave: small, since the differences are fine detail to be preserved.
SIGMA = 0.7

_FLOOR = 1e-12


def coherence_step(plan: Plan, now: Current, items: Items) -> Fields:
    """A step of each field that brings the change of a frame nearer to the average of the changes around it."""
    weights, frame = window_weights(WINDOW), now.frame
    total = items.windowed_sums(frame, "step", now.done + 1, ["change"], weights)["change"]
    # Frames that stay unchanged have no change to follow.
    window = [i for i in window_of(frame.index, len(plan.frames), WINDOW) if not plan.frames[i].still]
    present = sum(weights[abs(i - frame.index)] for i in window)
    target, eta = total * opaque(1 / present), frame.recipe.coherence * frame.eta
    return step_towards(target, now, eta, plan.rows, items.octave.cell_size)


def step_towards(target: mi.TensorXf, now: Current, eta: float, rows: int, h: float) -> Fields:
    """A step of each field that brings the density's change nearer to a target.

    It is as long as a step of the stylization, times the size of the difference relative to that of the changes.

    Args:
        target: c̄_t, (D, H, W).
        now: the frame as it stands.
        eta: step size.
        rows: H of the full grid.
        h: size of a cell in full-resolution cells.
    """
    parameterisation, density = now.frame.parameterisation, now.inputs.density
    stylized, pull_back = parameterisation.density_with_pullback(now.fields, density, h)
    change = stylized - density
    difference = change - target
    gradient = pull_back(difference)
    size = dr.maximum(root_mean_square(change), root_mean_square(target))
    ratio = root_mean_square(difference) / dr.maximum(size, opaque(_FLOOR))
    levels = now.frame.recipe.pyramid_levels
    steps = parameterisation.step(gradient, now.inputs.mask, eta, rows, h, levels, SIGMA)
    return Fields({name: mi.TensorXf(step.array * ratio, step.shape) for name, step in steps.items()})
