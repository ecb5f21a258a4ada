"""The soft-edged mask that keeps the stylization inside the smoke."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from tnst_mi.fields.pyramid import gaussian

#: Width of the soft edge, in full-resolution cells.
EDGE_SIGMA = 1.2


def soft_mask(density: np.ndarray, obstacle: np.ndarray | None = None, strength: float = 1.0) -> np.ndarray:
    """The blurred density, clipped to [0, 1] (paper section 4.2) and raised to a power: (D, H, W) float32.

    Args:
        density: (D, H, W) density of the unstylized frame at full resolution, ≥ 0; taken as 0 outside the grid, except
            along an axis of one cell, along which nothing varies.
        obstacle: (D, H, W) bool; the mask is 0 inside.
        strength: the power, ≥ 0; 0 makes the mask 1 everywhere except in the obstacle.
    """
    axes = [axis for axis in range(3) if density.shape[axis] > 1]
    density = mi.TensorXf(np.ascontiguousarray(density, np.float32))
    mask = np.clip(gaussian(density, EDGE_SIGMA, "zero", axes).numpy(), 0, 1) ** np.float32(strength)
    if obstacle is not None:
        mask[obstacle] = 0
    return mask
