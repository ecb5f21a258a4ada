"""The continuous image in float64 numpy: the integral of the interpolated density, exact up to rounding.

Along a straight ray the trilinear interpolation of a grid is a cubic polynomial between two crossings of the planes
through the cell centres. The two-point Gauss rule integrates cubics exactly, so the optical depth of a ray is exact up
to rounding, whatever its direction.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tnst_mi.compare.rays import Interpolation, rays, visible_from


def closed_form(columns: np.ndarray, gamma: float) -> np.ndarray:
    """The continuous emission–absorption image (1 − exp(−γ ∫ d))/γ from the result of `column_density`."""
    return -np.expm1(-gamma * columns) / gamma


def column_density(density: np.ndarray, view: Sequence[float]) -> np.ndarray:
    """∫ d along the ray through each pixel centre, in density × cells: (H, W) float64, row 0 at the top.

    Args:
        density: (D, H, W), interpolated trilinearly, clamped to its edge values inside its box, 0 outside.
        view: orthographic or in perspective; see `rendering.cameras.views`.
    """
    result = []
    for origins, directions in rays(density.shape, view):
        edges = np.maximum(_crossings(density.shape, origins, directions), visible_from(view))
        middle, half = (edges[:, 1:] + edges[:, :-1]) / 2, (edges[:, 1:] - edges[:, :-1]) / 2
        ray, segment = np.nonzero(half > 0)
        middle, half = middle[ray, segment], half[ray, segment]
        total = np.zeros(len(ray))
        for side in (-1, 1):
            distance = middle + side * half / np.sqrt(3)
            points = origins[ray] + distance[:, None] * directions[ray]
            total += half * Interpolation(density.shape, points).of(density)
        result.append(np.bincount(ray, total, len(origins)) * np.linalg.norm(directions, axis=1))
    return np.concatenate(result).reshape(density.shape[1:])


def _crossings(shape: tuple[int, int, int], origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Where rays cross the box, and in it the planes through cell centres: sorted multiples (rays, n) of directions."""
    begin, end = np.full(len(origins), -np.inf), np.full(len(origins), np.inf)
    planes = []
    for axis, size in enumerate(shape[::-1]):
        position = origins[:, axis]
        along = directions[:, axis]
        parallel = along == 0
        end[parallel & ((position < -0.5) | (position > size - 0.5))] = -np.inf
        # A ray parallel to the planes of an axis crosses none of them.
        step = np.where(parallel, np.inf, along)
        walls = np.sort((np.array([[-0.5], [size - 0.5]]) - position) / step, axis=0)
        begin = np.where(parallel, begin, np.maximum(begin, walls[0]))
        end = np.where(parallel, end, np.minimum(end, walls[1]))
        planes.append((np.arange(size) - position[:, None]) / step[:, None])
    # For a ray that misses the box the interval shrinks to a point.
    end = np.maximum(begin, end)
    inner = np.clip(np.concatenate(planes, axis=1), begin[:, None], end[:, None])
    return np.sort(np.concatenate([begin[:, None], inner, end[:, None]], axis=1), axis=1)
