"""Rays through pixel centres and trilinear interpolation in float64 numpy, written from the conventions alone.

What the references of the comparison share. None of it is code of the renderer, so that a mistake there is not repeated
here. Positions are (x, y, z) in cells from the centre of cell 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

#: Rays followed at once; bounds the memory.
_RAYS = 2048


def rays(shape: tuple[int, int, int], view: Sequence[float]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The rays through the pixel centres of a view of a grid (D, H, W), row by row from the top, some at a time.

    Yields:
        Where rays meet the plane through the grid's centre that faces the camera, (rays, 3), and their directions
        (rays, 3), as long as they have to be to get one cell farther from that plane: of unit length in orthographic
        views. From a view at a distance, the eye is at minus that many directions.
    """
    _, rows, columns = shape
    right, up, towards = _camera_axes(*view[:2])
    y, x = np.meshgrid((rows - 1) / 2 - np.arange(rows), np.arange(columns) - (columns - 1) / 2, indexing="ij")
    centre = (np.array(shape[::-1]) - 1) / 2
    across = x.reshape(-1, 1) * right + y.reshape(-1, 1) * up
    directions = np.broadcast_to(-towards, across.shape) if len(view) == 2 else across / view[2] - towards
    for first in range(0, len(across), _RAYS):
        part = slice(first, first + _RAYS)
        yield centre + across[part], directions[part]


def visible_from(view: Sequence[float]) -> float:
    """How many directions of `rays` from the plane through the centre a ray begins: −distance; −∞ if orthographic."""
    return -np.inf if len(view) == 2 else -view[2]


def _camera_axes(azimuth: float, elevation: float) -> np.ndarray:
    """Rows right, up and towards the camera: x, y and z at (0, 0); +azimuth leans towards +x, +elevation up."""
    # Rounded, since the cosine of 90° would otherwise be 6e-17: no ray would be parallel to a face.
    (sin_a, sin_e), (cos_a, cos_e) = (np.round(f(np.radians([azimuth, elevation])), 15) for f in (np.sin, np.cos))
    right = [cos_a, 0, -sin_a]
    up = [-sin_a * sin_e, cos_e, -cos_a * sin_e]
    towards = [sin_a * cos_e, sin_e, cos_a * cos_e]
    return np.array([right, up, towards])


class Interpolation:
    """Trilinear interpolation of grids (D, H, W) at points (n, 3), clamped to the outermost cell centres."""

    def __init__(self, shape: tuple[int, int, int], points: np.ndarray) -> None:
        last = np.array(shape[::-1]) - 1
        # One axis at a time: columns of `points` are far apart in memory.
        positions = [np.clip(points[:, axis], 0, last[axis]) for axis in range(3)]
        low = [np.minimum(p.astype(np.int64), max(n - 1, 0)) for p, n in zip(positions, last, strict=True)]
        #: By axis: the weight of the upper neighbour.
        self.fractions = [p - i for p, i in zip(positions, low, strict=True)]
        strides = (1, shape[2], shape[1] * shape[2])
        index = sum(i * stride for i, stride in zip(low, strides, strict=True))
        # An axis of a single cell has no upper neighbour.
        steps = [stride if n > 0 else 0 for stride, n in zip(strides, last, strict=True)]
        #: By corner (x, y, z), each 0 or 1: the index of its cell.
        self.cells = {corner: index + np.dot(corner, steps) for corner in np.ndindex(2, 2, 2)}

    def of(self, grid: np.ndarray) -> np.ndarray:
        """The grid's values at the points, (n,)."""
        flat = grid.ravel()
        values = {corner: flat[cells] for corner, cells in self.cells.items()}
        for fraction in self.fractions:  # x, then y, then z
            values = {
                rest: values[0, *rest] * (1 - fraction) + values[1, *rest] * fraction
                for rest in {key[1:] for key in values}
            }
        return values[()]

    def add_transposed(self, values: np.ndarray, total: np.ndarray) -> None:
        """Add values (n,) at the points to the cells of `total` (D, H, W), in place, with the weights of `of`."""
        flat = total.reshape(-1)
        for corner, cells in self.cells.items():
            weights = (f if upper else 1 - f for upper, f in zip(corner, self.fractions, strict=True))
            np.add.at(flat, cells, np.prod([values, *weights], axis=0))
