"""Affine maps between coordinates: from voxels to the scene, and from cells of one grid to voxels of another."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

#: Voxels along the axes count as cubes if their edges differ by less than this share of an edge.
CUBE_TOLERANCE = 5e-3

#: Voxels count as along the axes if they are turned by less than this angle, in radians: rounding in single precision.
ANGLE_TOLERANCE = 1e-4

#: Positions count as equal if they differ by less than this share of a voxel.
PLACE_TOLERANCE = 1e-2

#: Edges of voxels count as equal if they differ by less than this share: what a size in single precision is off.
EDGE_TOLERANCE = 1e-4

# The least volume of a voxel, relative to that of a box with its edges.
_FLATTEST = 1e-6

# Lengths within which products and ratios of any two maps are finite and not 0.
_SHORTEST, _LONGEST = 1e-30, 1e30


@dataclass(frozen=True, eq=False)
class Affine:
    """The map x ↦ matrix · x + offset.

    Attributes:
        matrix: (3, 3) float64, invertible.
        offset: (3) float64.
    """

    matrix: np.ndarray
    offset: np.ndarray

    @classmethod
    def scaling(cls, edge: float, offset: np.ndarray | tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Affine:
        """The map of cubes along the axes with an edge, the first of which is centred at `offset`."""
        return cls(edge * np.eye(3), np.array(offset, np.float64))

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Where points (…, 3) go."""
        return points @ self.matrix.T + self.offset

    def after(self, first: Affine) -> Affine:
        """The map that applies `first`, then this one."""
        return Affine(self.matrix @ first.matrix, self(first.offset))

    def inverse(self) -> Affine:
        """The map back."""
        matrix = self.matrix.T if self.whole else np.linalg.inv(self.matrix)
        return Affine(matrix, -matrix @ self.offset)

    def moved(self, vector: tuple[float, float, float] | np.ndarray) -> Affine:
        """This map, then a translation."""
        return Affine(self.matrix, self.offset + np.asarray(vector, np.float64))

    @property
    def edges(self) -> np.ndarray:
        """The length of what each axis' unit vector becomes, (3)."""
        lengths = np.linalg.norm(self.matrix, axis=0)
        # Exact where there is nothing to round: along the axes.
        along = np.count_nonzero(self.matrix, axis=0) == 1
        return np.where(along, np.abs(self.matrix).sum(axis=0), lengths)

    @property
    def edge(self) -> float:
        """The edge of a cube with the volume of what a unit cube becomes."""
        edges = self.edges
        if (edges == edges[0]).all() and (np.count_nonzero(self.matrix, axis=0) == 1).all():
            return float(edges[0])
        return float(np.cbrt(abs(np.linalg.det(self.matrix))))

    @property
    def places_voxels(self) -> bool:
        """Whether it is a map that voxels can have: finite, and invertible up to rounding."""
        numbers = np.append(self.matrix, self.offset)
        if not (np.isfinite(numbers).all() and np.abs(numbers).max() <= _LONGEST):
            return False
        edges = np.linalg.norm(self.matrix, axis=0)
        return bool(edges.min() >= _SHORTEST and abs(np.linalg.det(self.matrix / edges)) >= _FLATTEST)

    def axes(self) -> np.ndarray | None:
        """Which signed axis each axis becomes, as a matrix (3, 3) of −1, 0 and 1; None unless cubes become cubes
        along the axes, up to CUBE_TOLERANCE and ANGLE_TOLERANCE."""
        edges = self.edges
        directions = self.matrix / edges
        axes = np.rint(directions)
        if np.ptp(edges) > CUBE_TOLERANCE * self.edge or np.abs(directions - axes).max() > ANGLE_TOLERANCE:
            return None
        return axes if (np.abs(axes).sum(axis=0) == 1).all() and (np.abs(axes).sum(axis=1) == 1).all() else None

    @property
    def whole(self) -> bool:
        """Whether whole coordinates become whole ones, axes along axes: an exact permutation of voxels."""
        axes = np.rint(self.matrix)
        permutes = (np.abs(axes).sum(axis=0) == 1).all() and (np.abs(axes).sum(axis=1) == 1).all()
        return bool(permutes and (self.matrix == axes).all() and (self.offset == np.rint(self.offset)).all())


def between(cells: Affine, voxels: Affine) -> Affine:
    """The map from the cells of one grid to the voxels of another, each given by its map to the scene.

    It is `whole` if both are made of cubes of one size that coincide, up to the tolerances of this module.
    """
    exact = voxels.inverse().after(cells)
    if math.isclose(cells.edge, voxels.edge, rel_tol=EDGE_TOLERANCE):
        own, others = cells.axes(), voxels.axes()
        if own is not None and others is not None:
            # Cubes of almost one size are matched by number, or they would drift apart far from the origin.
            offset = np.rint(exact.offset)
            if np.abs(exact.offset - offset).max() <= PLACE_TOLERANCE:
                return Affine(np.rint(others.T @ own), offset)
    return exact


def lattice_offset(first: Affine, other: Affine) -> np.ndarray | None:
    """What takes the voxels of one grid to those of another on its lattice, in whole voxels (3); None if it is on none.

    Args:
        first: from the voxels of the one grid to the scene.
        other: from those of the other.

    Example:
        >>> lattice_offset(Affine.scaling(0.5, (1.0, 0.0, 0.0)), Affine.scaling(0.5)).tolist()
        [2, 0, 0]
        >>> lattice_offset(Affine.scaling(0.5), Affine.scaling(0.25)) is None
        True
    """
    exact = other.inverse().after(first)
    offset = np.rint(exact.offset)
    same = np.abs(exact.matrix - np.eye(3)).max() <= EDGE_TOLERANCE
    return offset.astype(np.int64) if same and np.abs(exact.offset - offset).max() <= PLACE_TOLERANCE else None
