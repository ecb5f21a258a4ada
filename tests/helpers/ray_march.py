"""Oracle: emission–absorption images by a float64 march over numpy arrays, written from the conventions alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def camera_axes(view: tuple[float, float]) -> np.ndarray:
    """Rows right, up and towards the camera: x, y and z at (0, 0); +azimuth leans towards +x, +elevation up."""
    azimuth, elevation = np.radians(view)
    right = [np.cos(azimuth), 0, -np.sin(azimuth)]
    up = [-np.sin(azimuth) * np.sin(elevation), np.cos(elevation), -np.cos(azimuth) * np.sin(elevation)]
    towards = [np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)]
    return np.array([right, up, towards])


def pixel_centres(shape: tuple[int, int, int], view: tuple[float, float], h: float) -> np.ndarray:
    """World positions (H·W, 3) of the pixel centres in the plane through the origin, row 0 at the top."""
    _, rows, columns = shape
    right, up, _ = camera_axes(view)
    y, x = np.meshgrid((rows - 1) / 2 - np.arange(rows), np.arange(columns) - (columns - 1) / 2, indexing="ij")
    return h * (x.ravel()[:, None] * right + y.ravel()[:, None] * up)


def trilinear(grid: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Values at points (…, 3) given as (x, y, z) in cells from the centre of cell 0, clamped to the grid."""
    last = np.array(grid.shape[2::-1]) - 1
    points = np.clip(points, 0, last)
    low = np.floor(points).astype(int)
    t = points - low
    value = np.zeros(points.shape[:-1])
    for corner in np.ndindex(2, 2, 2):
        x, y, z = np.moveaxis(np.minimum(low + corner, last), -1, 0)
        value += np.prod(np.where(corner, t, 1 - t), -1) * grid[z, y, x]
    return value


def samples(
    grid: np.ndarray,
    edges: np.ndarray,
    centre: np.ndarray,
    origins: np.ndarray,
    directions: np.ndarray,
    step: float,
    inside: Callable[[np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """Values (rays, samples) along rays, first the nearest to their origin; 0 outside the box and behind the origin.

    Sample k lies at (k − (n − 1)/2)·step from the point nearest the grid's centre, n having the parity of D.

    Args:
        grid: (D, H, W).
        edges: (3, 3), its columns the edges of the grid's box in world space.
        centre: world position of the grid's centre.
        origins: (rays, 3).
        directions: (rays, 3), unit vectors.
        step: distance between samples.
        inside: further restricts the samples to world positions (…, 3) for which it holds.
    """
    size = np.array(grid.shape[::-1])
    n = 2 * int(np.ceil(np.linalg.norm(edges, axis=0).sum() / step)) + grid.shape[0] % 2
    nearest = ((centre - origins) * directions).sum(-1, keepdims=True)
    distance = nearest + (np.arange(n) - (n - 1) / 2) * step
    points = origins[:, None] + distance[..., None] * directions[:, None]
    local = (points - centre) @ np.linalg.inv(edges).T
    visible = (np.abs(local) <= 0.5).all(-1) & (distance >= 0)
    if inside is not None:
        visible &= inside(points)
    return trilinear(grid.astype(np.float64), local * size + (size - 1) / 2) * visible


def through_eye(
    density: np.ndarray, eye: np.ndarray, axes: np.ndarray, pixels: np.ndarray, gamma: float, quadrature: str, h: float
) -> np.ndarray:
    """The image (rays,) from an eye in world space, its axes right, up and towards the rows of `axes`.

    Pixels (rays, 2) are right and up from the axis at a depth of 1. Samples lie in planes h apart across the axis; of
    the number of planes, which has the parity of D, half are beyond the grid's centre. There is none at the eye.
    """
    size = np.array(density.shape[::-1])
    directions = pixels @ axes[:2] - axes[2]
    n = 2 * int(np.ceil(np.linalg.norm(size))) + density.shape[0] % 2
    depth = eye @ axes[2] + (np.arange(n) - (n - 1) / 2) * h
    points = eye + depth[:, None] * directions[:, None]
    exists = (np.abs(points) <= h * size / 2).all(-1) & (depth > 1e-3 * h)
    values = trilinear(density.astype(np.float64), points / h + (size - 1) / 2) * exists
    return radiance(values, gamma, h * np.linalg.norm(directions, axis=1)[:, None], quadrature, exists)


def radiance(
    values: np.ndarray, gamma: float, step: float | np.ndarray, quadrature: str, exists: np.ndarray | None = None
) -> np.ndarray:
    """Images (rays,) of density samples (rays, samples); "integrated_transmittance" needs 1 where samples `exist`."""
    depth = gamma * step * np.cumsum(values, -1)
    if quadrature == "paper":
        return (step * values * np.exp(-depth)).sum(-1)
    if quadrature == "integrated_transmittance":
        assert exists is not None
        return (step * exists * np.exp(-depth)).sum(-1)
    opacity = -np.expm1(-depth[:, -1])
    return opacity if quadrature == "transmittance" else opacity / gamma


def render(
    density: np.ndarray, view: tuple[float, float], gamma: float, quadrature: str = "paper", h: float = 1.0
) -> np.ndarray:
    """The orthographic image (H, W) of a density, as `tnst_mi.render` must show it."""
    towards = camera_axes(view)[2]
    edges = h * np.diag(density.shape[::-1]).astype(float)
    origins = pixel_centres(density.shape, view, h) + 2 * np.linalg.norm(edges) * towards
    place = (edges, np.zeros(3), origins, np.broadcast_to(-towards, origins.shape), h)
    values, exists = samples(density, *place), samples(np.ones_like(density), *place)
    return radiance(values, gamma, h, quadrature, exists).reshape(density.shape[1:])
