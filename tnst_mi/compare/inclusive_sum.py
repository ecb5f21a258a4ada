"""The sum of the quadrature "paper" and its derivative in float64 numpy, on the sample positions of the conventions.

The samples of a ray lie one cell apart, d_1 nearest the camera; sample k of n lies k − (n + 1)/2 cells from the point
nearest the grid's centre, n having the parity of D. With the optical depth τ_k = γ Σ_{i≤k} d_i, sample k included,

    I = Σ_k d_k exp(−τ_k)          ∂I/∂d_k = exp(−τ_k) − γ Σ_{j≥k} d_j exp(−τ_j)

In perspective, samples lie in planes one cell apart across the direction of the view, one of which, or the middle
between two, passes through the grid's centre. With the distance h of samples along a ray, d_k stands for h d_k, and
∂I/∂d_k is h times as large.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tnst_mi.compare.rays import Interpolation, rays, visible_from

#: Error of a float32 position relative to the grid's diagonal: 2^-24 of each number on the way to it, of which the
#: largest are the distance of the camera, twice the diagonal, and the rows of all images, stacked.
_POSITION = 2.0**-20

#: A plane of samples nearer to the eye than this, in cells, has none.
_AT_EYE = 1e-3

#: Error of a float32 sum of a few hundred products with exponentials, relative to the sum, and what float32 calls 0.
_SUM, _ZERO = 2.0**-16, float(np.finfo(np.float32).tiny)


@dataclass(frozen=True, eq=False)
class InclusiveSums:
    """Images (H, W) of one view at one γ, row 0 at the top, in density × cells.

    An evaluation of the sum in float32 lies between `lower` and `upper`, but for `tolerance`.

    Attributes:
        lower, upper: the least and the largest sum with or without the samples on the near and far walls of the grid's
            box, which rounding puts in or out; equal at all other pixels, and where there is no smoke at the walls.
        tolerance: what moving the samples by the error of float32 positions, along each axis, changes at most, and the
            rounding of the sum.
    """

    lower: np.ndarray
    upper: np.ndarray
    tolerance: np.ndarray


def inclusive_sums(density: np.ndarray, view: Sequence[float], gammas: Sequence[float]) -> list[InclusiveSums]:
    """The images of a view at each γ.

    Args:
        density: (D, H, W), interpolated trilinearly, clamped to its edge values inside its box, 0 outside.
        view: orthographic or in perspective; see `rendering.cameras.views`.
        gammas: extinctions γ per unit of density and cell.
    """
    shape = density.shape
    steepness = _steepness(density)
    results = np.empty((len(gammas), 3, shape[1] * shape[2]))
    for pixels, points, steps, inside, on_wall in _samples(shape, view):
        interpolation = Interpolation(shape, points[inside])
        values, slopes = np.zeros(inside.shape), np.zeros(inside.shape)
        values[inside], slopes[inside] = interpolation.of(density), interpolation.of(steepness)
        values, slopes = values * steps, slopes * steps
        moved = _position_error(shape) * slopes
        walls = on_wall.any(0)
        without = [np.where(hidden, 0, values)[:, walls] for hidden in _near_far_and_all(on_wall)]
        for gamma, result in zip(gammas, results, strict=True):
            image, tolerance = _sum_and_tolerance(values, moved, gamma)
            others = [_sum_and_tolerance(samples, moved[:, walls], gamma) for samples in without]
            sums, tolerances = np.moveaxis(np.array([(image[walls], tolerance[walls]), *others]), 1, 0)
            result[:, pixels] = image, image, tolerance
            result[:, pixels][:, walls] = sums.min(0), sums.max(0), tolerances.max(0)
    return [InclusiveSums(*images) for images in results.reshape(len(gammas), 3, *shape[1:])]


def inclusive_gradients(
    density: np.ndarray, view: Sequence[float], gammas: Sequence[float], weights: np.ndarray
) -> list[np.ndarray]:
    """For each γ, the derivative (D, H, W) of Σ weights · I with respect to the density.

    Args:
        density, view, gammas: as for `inclusive_sums`.
        weights: (H, W), one factor per pixel; 0 where `undecided`, lest rounding decide which cells a ray reaches.
    """
    shape = density.shape
    gradients = [np.zeros(shape) for _ in gammas]
    for pixels, points, steps, inside, _ in _samples(shape, view):
        interpolation = Interpolation(shape, points[inside])
        values = np.zeros(inside.shape)
        values[inside] = interpolation.of(density)
        values *= steps
        for gamma, gradient in zip(gammas, gradients, strict=True):
            transmittance, at_and_behind = _transmittance_and_sums(values, gamma)
            derivative = (transmittance - gamma * at_and_behind) * steps
            interpolation.add_transposed((weights.ravel()[pixels] * derivative)[inside], gradient)
    return gradients


def gradient_tolerance(density: np.ndarray, gamma: float) -> float:
    """How much a gradient in float32 may differ from that of `inclusive_gradients`, RMS relative to the RMS.

    The gradient is made of interpolation weights and transmittances. With a sample, its weights move by the error of
    positions, and the optical depth by γ times the change of density, which is about the largest density per cell.
    """
    return _position_error(density.shape) * (1 + gamma * float(density.max())) + _SUM


def undecided(shape: tuple[int, int, int], view: Sequence[float]) -> np.ndarray:
    """(H, W) bool: the pixels whose ray has a sample on a wall of the grid's box, up to the error of float32."""
    return np.concatenate([on_wall.any(0) for *_, on_wall in _samples(shape, view)]).reshape(shape[1:])


def _near_far_and_all(on_wall: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the samples on walls (n, rays): those of the half nearer the camera, those of the other half, and all."""
    nearer = (np.arange(len(on_wall)) < len(on_wall) / 2)[:, None]
    return on_wall & nearer, on_wall & ~nearer, on_wall


def _transmittance_and_sums(values: np.ndarray, gamma: float) -> tuple[np.ndarray, np.ndarray]:
    """Of samples (n, rays): exp(−τ_k) and Σ_{j≥k} d_j exp(−τ_j), of which the first is the image."""
    transmittance = np.exp(-gamma * np.cumsum(values, 0))
    return transmittance, np.cumsum((values * transmittance)[::-1], 0)[::-1]


def _sum_and_tolerance(values: np.ndarray, moved: np.ndarray, gamma: float) -> tuple[np.ndarray, np.ndarray]:
    """I (rays,) of samples (n, rays), and how much it may differ in float32 if each sample may by `moved` (n, rays)."""
    transmittance, at_and_behind = _transmittance_and_sums(values, gamma)
    # Of the derivative, the magnitudes of both parts: their difference may vanish, and its change would be missed.
    sensitivity = transmittance + gamma * at_and_behind
    return at_and_behind[0], (sensitivity * moved).sum(0) + _SUM * at_and_behind[0] + _ZERO


def _samples(
    shape: tuple[int, int, int], view: Sequence[float]
) -> Iterator[tuple[slice, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """The samples of some pixels at a time.

    They are positions (n, rays, 3), the distances between those of a ray (rays,), which of them are in the box and in
    front of the eye, and which are on its wall or at the eye.
    """
    n = 2 * int(np.ceil(np.linalg.norm(shape) / 2)) + shape[0] % 2
    distances = np.arange(n) - (n - 1) / 2
    middle, half = (np.array(shape[::-1]) - 1) / 2, np.array(shape[::-1]) / 2
    error = _position_error(shape)
    first = 0
    for nearest, directions in rays(shape, view):
        points = nearest + distances[:, None, None] * directions
        beyond = np.maximum(
            (np.abs(points - middle) - half).max(-1), (visible_from(view) + _AT_EYE - distances)[:, None]
        )
        steps = np.linalg.norm(directions, axis=1)
        yield slice(first, first + len(nearest)), points, steps, beyond <= error, np.abs(beyond) <= error
        first += len(nearest)


def _position_error(shape: tuple[int, int, int]) -> float:
    """Error of float32 positions in cells."""
    return _POSITION * float(np.linalg.norm(shape))


def _steepness(density: np.ndarray) -> np.ndarray:
    """(D, H, W) the largest difference of neighbours, summed over the axes, within a cell of each cell.

    Its interpolation bounds how much that of the density changes per cell when a sample moves, also to the next cell.
    """
    total = np.zeros(density.shape)
    for axis in range(3):
        differences = np.abs(np.diff(density.astype(np.float64), axis=axis))
        total += _largest_in_window(np.pad(differences, [(1, 1) if i == axis else (0, 0) for i in range(3)]), axis, 2)
    for axis in range(3):
        total = _largest_in_window(np.pad(total, [(1, 1) if i == axis else (0, 0) for i in range(3)]), axis, 3)
    return total


def _largest_in_window(array: np.ndarray, axis: int, width: int) -> np.ndarray:
    return np.lib.stride_tricks.sliding_window_view(array, width, axis).max(-1)
