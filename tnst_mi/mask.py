"""The soft-edged mask that keeps the stylization inside the smoke."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from tnst_mi.pyramid import gaussian

#: Width of the soft edge, in full-resolution cells.
SIGMA = 1.2


def soft_mask(density: np.ndarray, obstacle: np.ndarray | None = None) -> np.ndarray:
    """The blurred density, clipped to [0, 1] (paper section 4.2): (D, H, W) float32 at full resolution.

    Args:
        density: (D, H, W) density of the unstylized frame, ≥ 0; it counts as 0 outside the grid.
        obstacle: (D, H, W) bool; the mask is 0 inside.
    """
    blurred = gaussian(mi.TensorXf(np.ascontiguousarray(density, np.float32)), SIGMA, boundary="zero").numpy()
    mask = np.clip(blurred, 0, 1)
    if obstacle is not None:
        mask[obstacle] = 0
    return mask
