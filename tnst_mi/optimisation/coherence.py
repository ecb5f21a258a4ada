"""Coherence in time of what is seen: the change of the density shall move with the smoke.

Aligned gradients (paper Alg. 1) make potentials alike, but potentials that are carried along do not quite move the
smoke alike, and where the smoke is sharp that shows. So a frame's change c_t = d*_t − d_t is compared with the average
of the changes around it, transported to it, and the difference is lessened by a step of its own:

    min ½ ‖c_t − c̄_t‖²,    c̄_t = Σ_i T_i^t(c_i) over the frame and its two neighbours, divided by their number.

This is not in the paper.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.grid import opaque
from tnst_mi.fields.pyramid import root_mean_square
from tnst_mi.optimisation.parameterisation import Parameterisation

#: Frames whose changes are averaged: the next ones tell what there is to be told, farther ones arrive blurred.
WINDOW = 3

#: Width of the blur of the gradient in cells of the octave: differences are fine, and the blur must leave them.
SIGMA = 0.7

_FLOOR = 1e-12


def coherence_steps(
    parameters: Parameterisation,
    density: mi.TensorXf,
    mask: mi.TensorXf,
    target: mi.TensorXf,
    eta: float,
    rows: int,
    levels: int,
) -> dict[str, mi.TensorXf]:
    """A step of each field that brings the density's change nearer to a target.

    It is as long as a step of the stylization, times the size of the difference relative to that of the changes.

    Args:
        parameters: fields on the octave's grid.
        density: (D, H, W), unstylized.
        mask: (D, H, W) in [0, 1].
        target: c̄_t, (D, H, W).
        eta: step size.
        rows: H of the full grid.
        levels: bands of the pyramid that normalises the gradient.
    """
    parameters.attach()
    stylized = parameters.density(density)
    change = dr.detach(stylized) - density
    difference = change - target
    dr.set_grad(stylized, difference)
    dr.enqueue(dr.ADMode.Backward, stylized)
    dr.traverse(dr.ADMode.Backward)
    size = dr.maximum(root_mean_square(change), root_mean_square(target))
    ratio = root_mean_square(difference) / dr.maximum(size, opaque(_FLOOR))
    parameters.find_steps(mask, eta, rows, levels, SIGMA)
    return {name: mi.TensorXf(step.array * ratio, step.shape) for name, step in parameters.steps.items()}
