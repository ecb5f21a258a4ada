"""Reference images in float64 numpy, written from the conventions alone, without any code of the renderer.

Along a straight ray the trilinear interpolation of a grid is a cubic polynomial between two crossings of the planes
through the cell centres. The two-point Gauss rule integrates cubics exactly, so the optical depth of a ray is exact up
to rounding, whatever its direction.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from tnst_mi.rendering.cameras.views import camera_frame

#: Rays integrated at once; bounds the memory.
_RAYS = 2048


def closed_form(columns: np.ndarray, gamma: float) -> np.ndarray:
    """The continuous emission–absorption image (1 − exp(−γ ∫ d))/γ from the result of `column_density`."""
    return -np.expm1(-gamma * columns) / gamma


def column_density(density: np.ndarray, view: tuple[float, float]) -> np.ndarray:
    """∫ d along the ray through each pixel centre, in density × cells: (H, W) float64, row 0 at the top.

    Args:
        density: (D, H, W), interpolated trilinearly, clamped to its edge values inside its box, 0 outside.
        view: (azimuth, elevation) in degrees.
    """
    result = []
    for origins, direction in _rays(density.shape, view):
        edges = _crossings(density.shape, origins, direction)
        middle, half = (edges[:, 1:] + edges[:, :-1]) / 2, (edges[:, 1:] - edges[:, :-1]) / 2
        ray, segment = np.nonzero(half > 0)
        middle, half = middle[ray, segment], half[ray, segment]
        total = np.zeros(len(ray))
        for side in (-1, 1):
            distance = middle + side * half / np.sqrt(3)
            total += half * _trilinear(density, origins[ray] + distance[:, None] * direction)
        result.append(np.bincount(ray, total, len(origins)))
    return np.concatenate(result).reshape(density.shape[1:])


def inclusive_sums(density: np.ndarray, view: tuple[float, float], gammas: Sequence[float]) -> np.ndarray:
    """The images Σ d_k exp(−γ Σ_{i≤k} d_i) of the quadrature "paper", for a step of one cell: (gammas, H, W) float64.

    Sample k of n lies k − (n − 1)/2 cells from the point nearest the grid's centre; k increases away from the camera.
    """
    size = density.shape
    n = 2 * int(np.ceil(np.linalg.norm(size) / 2)) + size[0] % 2
    last = np.array(size[::-1]) - 1
    result = []
    for origins, direction in _rays(size, view):
        depth, image = np.zeros(len(origins)), np.zeros((len(gammas), len(origins)))
        for k in range(n):
            points = origins + (k - (n - 1) / 2) * direction
            (inside,) = np.nonzero(((points >= -0.5) & (points <= last + 0.5)).all(-1))
            values = _trilinear(density, points[inside])
            depth[inside] += values
            image[:, inside] += values * np.exp(-np.multiply.outer(gammas, depth[inside]))
        result.append(image)
    return np.concatenate(result, axis=1).reshape(len(gammas), *size[1:])


def _rays(shape: tuple[int, int, int], view: tuple[float, float]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Points (rays, 3) nearest the grid's centre and the viewing direction, in cells from the centre of cell 0."""
    _, rows, columns = shape
    right, up, towards = camera_frame(*view)
    y, x = np.meshgrid((rows - 1) / 2 - np.arange(rows), np.arange(columns) - (columns - 1) / 2, indexing="ij")
    centre = (np.array(shape[::-1]) - 1) / 2
    origins = centre + x.reshape(-1, 1) * right + y.reshape(-1, 1) * up
    for first in range(0, len(origins), _RAYS):
        yield origins[first : first + _RAYS], -towards


def _crossings(shape: tuple[int, int, int], origins: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Sorted distances (rays, n) at which rays cross the box and the planes through the cell centres inside it."""
    begin, end = np.full(len(origins), -np.inf), np.full(len(origins), np.inf)
    planes = []
    for axis, size in enumerate(shape[::-1]):
        position = origins[:, axis]
        if direction[axis] == 0:
            end[(position < -0.5) | (position > size - 0.5)] = -np.inf
            continue
        walls = np.sort((np.array([[-0.5], [size - 0.5]]) - position) / direction[axis], axis=0)
        begin, end = np.maximum(begin, walls[0]), np.minimum(end, walls[1])
        planes.append((np.arange(size) - position[:, None]) / direction[axis])
    # For a ray that misses the box the interval shrinks to a point.
    end = np.maximum(begin, end)
    inner = np.clip(np.concatenate(planes, axis=1), begin[:, None], end[:, None])
    return np.sort(np.concatenate([begin[:, None], inner, end[:, None]], axis=1), axis=1)


def _trilinear(grid: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Values at points (n, 3) given as (x, y, z) in cells from the centre of cell 0, clamped to the grid."""
    last = np.array(grid.shape[::-1]) - 1
    # One axis at a time: columns of `points` are far apart in memory.
    positions = [np.clip(points[:, axis], 0, last[axis]) for axis in range(3)]
    low = [np.minimum(p.astype(np.int64), max(n - 1, 0)) for p, n in zip(positions, last, strict=True)]
    fractions = [p - i for p, i in zip(positions, low, strict=True)]
    strides = (1, grid.shape[2], grid.shape[1] * grid.shape[2])
    index, flat = sum(i * stride for i, stride in zip(low, strides, strict=True)), grid.ravel()
    # An axis of a single cell has no upper neighbour.
    steps = [stride if n > 0 else 0 for stride, n in zip(strides, last, strict=True)]
    values = {corner: flat[index + np.dot(corner, steps)] for corner in np.ndindex(2, 2, 2)}
    for fraction in fractions:  # x, then y, then z
        values = {
            rest: values[0, *rest] * (1 - fraction) + values[1, *rest] * fraction
            for rest in {key[1:] for key in values}
        }
    return values[()]
