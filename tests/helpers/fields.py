"""Fields and differentiation helpers shared by the tests."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def smooth_noise(rng: np.random.Generator, *shape: int, passes: int = 2) -> np.ndarray:
    """Noise blurred with [1, 2, 1]/4 along the first three axes (periodically), float32."""
    field = rng.standard_normal(shape)
    for axis in range(3):
        for _ in range(passes):
            field = (np.roll(field, 1, axis) + 2 * field + np.roll(field, -1, axis)) / 4
    return field.astype(np.float32)


def blob(shape: tuple[int, int, int], centre: tuple[float, float, float], radius: float) -> np.ndarray:
    """A Gaussian blob; `centre` is (x, y, z) in cells, float32."""
    z, y, x = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
    square = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2
    return np.exp(-square / (2 * radius**2)).astype(np.float32)


def directional_error(
    function: Callable[[np.ndarray], float],
    gradient: np.ndarray,
    point: np.ndarray,
    directions: list[np.ndarray],
    step: float,
) -> float:
    """RMS difference between central differences and the gradient, relative to the RMS of the differences."""
    measured, predicted = [], []
    for direction in directions:
        upper = function((point + step * direction).astype(np.float32))
        lower = function((point - step * direction).astype(np.float32))
        measured.append((upper - lower) / (2 * step))
        predicted.append(float((gradient.astype(np.float64) * direction).sum()))
    measured, predicted = np.array(measured), np.array(predicted)
    return float(np.sqrt(np.mean((measured - predicted) ** 2) / np.mean(measured**2)))
