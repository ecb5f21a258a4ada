"""The soft-edged mask that keeps the stylization inside the smoke."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.arrays import any_array_kind
from tnst_mi.fields.kernels import opaque
from tnst_mi.fields.pyramid import gaussian

#: Width of the soft edge, in full-resolution cells.
EDGE_SIGMA = 1.2


@any_array_kind("density", differentiable=False)
def soft_mask(density: mi.TensorXf, obstacle: np.ndarray | None = None, strength: float = 1.0) -> mi.TensorXf:
    """The blurred density, clipped to [0, 1] (paper section 4.2) and raised to a power: (D, H, W) float32.

    Args:
        density: (D, H, W) density of the unstylized frame at full resolution, ≥ 0, numpy or Dr.Jit; taken as 0 outside
            the grid, except along an axis of one cell, along which nothing varies.
        obstacle: (D, H, W) bool; the mask is 0 inside.
        strength: the power, ≥ 0; 0 makes the mask 1 everywhere except in the obstacle.
    """
    axes = [axis for axis in range(3) if density.shape[axis] > 1]
    mask = dr.clip(gaussian(density, EDGE_SIGMA, "zero", axes).array, 0, 1)
    if strength != 1:
        # The power of 0 is 0, but for 0⁰ = 1, as the limit of weak masks.
        mask = dr.select(mask > 0, dr.power(mask, opaque(strength)), mi.Float(strength == 0))
    if obstacle is not None:
        mask = dr.select(mi.Bool(obstacle.ravel()), 0, mask)
    return mi.TensorXf(mask, tuple(density.shape))
