"""Resampling fields between octaves at the same physical positions.

Every octave is a grid of cubic cells that shares the centre of the full grid, so cell i of n cells of size h lies at
(i − (n − 1)/2) h on its axis. Resampling is separable: one small interpolation matrix per axis, which torch multiplies
with the field on the device of the active variant. It runs once per octave and is not differentiated. Fields may be
numpy arrays or Dr.Jit tensors; the result is of the same kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.arrays import any_array_kind
from tnst_mi.fields.grid import Shape
from tnst_mi.fields.kernels import opaque
from tnst_mi.machine.lazy import LazyModule

if TYPE_CHECKING:
    import torch
else:
    torch = LazyModule("torch")


def _source_coordinates(n_from: int, h_from: float, n_to: int, h_to: float) -> np.ndarray:
    """Positions of the target cells in cell coordinates of the source axis."""
    position = (np.arange(n_to) - (n_to - 1) / 2) * h_to
    return position / h_from + (n_from - 1) / 2


def cubic_matrix(n_from: int, h_from: float, n_to: int, h_to: float) -> np.ndarray:
    """Catmull–Rom interpolation along one axis, shape (n_to, n_from); positions outside repeat the end cell."""
    x = np.clip(_source_coordinates(n_from, h_from, n_to, h_to), 0, n_from - 1)
    base = np.floor(x).astype(int)
    t = x - base
    weights = np.stack(
        [
            ((-0.5 * t + 1.0) * t - 0.5) * t,
            (1.5 * t - 2.5) * t * t + 1.0,
            ((-1.5 * t + 2.0) * t + 0.5) * t,
            (0.5 * t - 0.5) * t * t,
        ],
        axis=1,
    )
    matrix = np.zeros((n_to, n_from))
    for tap in range(4):
        np.add.at(matrix, (np.arange(n_to), np.clip(base + tap - 1, 0, n_from - 1)), weights[:, tap])
    return matrix


def linear_matrix(n_from: int, h_from: float, n_to: int, h_to: float, repeat: bool = False) -> np.ndarray:
    """Linear interpolation along one axis, shape (n_to, n_from).

    Outside the source cells' centres the field is 0, or repeats the end cell.
    """
    x = _source_coordinates(n_from, h_from, n_to, h_to)
    if repeat:
        x = np.clip(x, 0, n_from - 1)
    return np.maximum(0.0, 1.0 - np.abs(x[:, None] - np.arange(n_from)[None, :]))


def prefilter_matrix(n: int, h_from: float, h_to: float) -> np.ndarray:
    """Gaussian that removes what a coarser grid cannot represent, shape (n, n); the field is 0 outside.

    Its variance is the variance of a target cell minus the variance of a source cell, (h_to² − h_from²)/12, so that
    together with the source cells it matches an average over the target cell. A finer target needs no filter: the
    result is the identity.
    """
    variance = (h_to**2 - h_from**2) / 12 / h_from**2
    if variance <= 0:
        return np.eye(n)
    offset = np.arange(n)[:, None] - np.arange(n)[None, :]
    # Normalised over the infinite line, so that values beyond the border count as zeros.
    reach = np.arange(-n, n + 1)
    return np.exp(-(offset**2) / (2 * variance)) / np.exp(-(reach**2) / (2 * variance)).sum()


def _apply(field: mi.TensorXf, matrices: list[np.ndarray]) -> mi.TensorXf:
    values = dr.detach(field).torch()
    for axis, matrix in enumerate(matrices):
        weights = torch.as_tensor(matrix, dtype=torch.float32).to(values.device)
        moved = values.movedim(axis, 0)
        values = (weights @ moved.flatten(1)).unflatten(1, moved.shape[1:]).movedim(0, axis)
    return mi.TensorXf(values.contiguous())


def _unchanged(field: mi.TensorXf, h_from: float, shape: Shape, h_to: float) -> bool:
    return tuple(field.shape[:3]) == tuple(shape) and h_from == h_to


@any_array_kind("field", differentiable=False)
def resample_mask(field: mi.TensorXf, h_from: float, shape: Shape, h_to: float) -> mi.TensorXf:
    """Resample a mask (D, H, W) to another octave: Gaussian prefilter, then linear interpolation, clamped to ≥ 0.

    The field is 0 outside its grid, except along an axis of one cell, along which nothing varies. Cell sizes are in
    full-resolution cells.
    """
    if _unchanged(field, h_from, shape, h_to):
        return field
    matrices = [
        np.eye(1) if n == m == 1 else linear_matrix(n, h_from, m, h_to) @ prefilter_matrix(n, h_from, h_to)
        for n, m in zip(field.shape, shape, strict=True)
    ]
    return dr.maximum(_apply(field, matrices), 0)


@any_array_kind("field", differentiable=False)
def resample_density(field: mi.TensorXf, h_from: float, shape: Shape, h_to: float) -> mi.TensorXf:
    """Resample a density (D, H, W) to another octave, like a mask.

    Smoke of one cell along an axis is one cell thick, so its density must decrease as cells grow: images then keep
    their brightness.
    """
    flat = sum(n == m == 1 for n, m in zip(field.shape, shape, strict=True))
    resampled = resample_mask(field, h_from, shape, h_to)
    return resampled * opaque((h_from / h_to) ** flat) if flat else resampled


@any_array_kind("field", differentiable=False)
def resample_potential(field: mi.TensorXf, h_from: float, shape: Shape, h_to: float) -> mi.TensorXf:
    """Resample a potential (D, H, W) or (D, H, W, 3) to another octave with cubic interpolation.

    Values outside the grid repeat the border. Potentials are stored in full-resolution cells² at every octave, so no
    scaling is needed. Cell sizes are in full-resolution cells.
    """
    if _unchanged(field, h_from, shape, h_to):
        return field
    pairs = list(zip(field.shape[:3], shape, strict=True))
    return _apply(field, [cubic_matrix(n, h_from, m, h_to) for n, m in pairs])


@any_array_kind("field", differentiable=False)
def resample_velocity(field: mi.TensorXf, h_from: float, shape: Shape, h_to: float) -> mi.TensorXf:
    """Resample a velocity (D, H, W, 3) to another octave: Gaussian prefilter, then linear, per component.

    Values outside the grid repeat the border. Velocities are in full-resolution cells per frame at every octave, so no
    scaling is needed. Cell sizes are in full-resolution cells.
    """
    if _unchanged(field, h_from, shape, h_to):
        return field
    return _apply(field, _means(field.shape[:3], h_from, shape, h_to))


@any_array_kind("field", differentiable=False)
def resample_region(field: mi.TensorXf, h_from: float, shape: Shape, h_to: float) -> mi.TensorXf:
    """Resample the mask (D, H, W) of a region to another octave: Gaussian prefilter, then linear interpolation.

    A region does not end where the grid does: values outside repeat the border. Cell sizes are in full-resolution
    cells.
    """
    if _unchanged(field, h_from, shape, h_to):
        return field
    return _apply(field, _means(field.shape, h_from, shape, h_to))


def _means(shape_from: Sequence[int], h_from: float, shape: Shape, h_to: float) -> list[np.ndarray]:
    """For each axis the means over the cells of an octave of what lies inside the grid, shape (n_to, n_from)."""
    matrices = []
    for n, m in zip(shape_from, shape, strict=True):
        # Cells of a coarse octave may lie outside the full grid: the octave has the cell size of the vertical axis.
        matrix = linear_matrix(n, h_from, m, h_to, repeat=True) @ prefilter_matrix(n, h_from, h_to)
        # Normalised to compensate for the zeros outside: near the border, an average over the cells inside.
        matrices.append(matrix / matrix.sum(axis=1, keepdims=True))
    return matrices
