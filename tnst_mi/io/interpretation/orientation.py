"""Conversion between the axes of programs: up axis and mirroring.

Ours is y up with arrays (z, y, x). Blender is z up: x = X, y = Z, z = −Y, a rotation, so handedness is preserved.
Arrays of a z-up program are (Z, Y, X) with components (X, Y, Z).
"""

from __future__ import annotations

import numpy as np


def from_z_up(array: np.ndarray) -> np.ndarray:
    """Turn a grid (Z, Y, X) or (Z, Y, X, 3) of a z-up program into (z, y, x) with y up; z runs along −Y."""
    turned = np.moveaxis(array, 0, 1)[::-1]
    if array.ndim == 4:
        turned = np.stack([turned[..., 0], turned[..., 2], -turned[..., 1]], axis=-1)
    return np.ascontiguousarray(turned)


def to_z_up(array: np.ndarray) -> np.ndarray:
    """Undo `from_z_up`."""
    turned = np.moveaxis(array[::-1], 0, 1)
    if array.ndim == 4:
        turned = np.stack([turned[..., 0], -turned[..., 2], turned[..., 1]], axis=-1)
    return np.ascontiguousarray(turned)


def mirrored(array: np.ndarray, axes: str) -> np.ndarray:
    """Mirror a grid (D, H, W) or (D, H, W, 3) along any of the axes "x", "y" and "z", vector components included."""
    for component, letter in enumerate("xyz"):
        if letter in axes:
            array = np.flip(array, 2 - component)
            if array.ndim == 4:
                array = array * np.where(np.arange(3) == component, -1, 1).astype(array.dtype)
    return np.ascontiguousarray(array)
