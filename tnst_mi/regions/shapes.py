"""Masks in closed form: spheres, boxes and ramps over the height, in the scene's units of length."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.bounds import smoke_box
from tnst_mi.fields.grid import Shape
from tnst_mi.geometry.placement import Placement


def cell_positions(shape: Shape, placement: Placement | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates (X, Y, Z) in the scene of the cell centres of a grid (D, H, W), each broadcast along other axes.

    A grid without a placement lies in a scene of its own: its unit is a cell, y is up, and the centre of its lowest
    cell is the origin.
    """
    z, y, x = np.ogrid[tuple(slice(0.0, n) for n in shape)]
    if placement is None:
        return x, y, z
    (X, Y, Z), size = placement.corner, placement.voxel_size
    if placement.up == "y":
        return X + size * x, Y + size * y, Z + size * z
    # Our z runs along −Y of a scene whose Z is up.
    return X + size * x, Y + size * (shape[0] - 1 - z), Z + size * y


def shape_mask(form: str, part: Mapping[str, Any], shape: Shape, placement: Placement | None) -> np.ndarray:
    """The mask (D, H, W) of a shape: 1 inside, falling linearly to 0 within `edge` of its surface, 0 outside.

    Args:
        form: "sphere", "box" or "height".
        part: the shape's numbers, without keyframes: centre and radius, or low and high, and edge; or height, between
            whose two numbers the mask rises from 0 to 1.
        shape: (D, H, W).
        placement: of the grid.

    Raises:
        InputError: a box has its low above its high, or between keyframes both ends of a ramp are the same.
    """
    positions = cell_positions(shape, placement)
    if form == "height":
        up = positions[2 if placement is not None and placement.up == "z" else 1]
        return _filled(ramp("height", up, *part["height"]), shape)
    if form == "sphere":
        square = sum((position - centre) ** 2 for position, centre in zip(positions, part["centre"], strict=True))
        depth = part["radius"] - np.sqrt(square)
    else:
        _require_ordered(part["low"], part["high"])
        sides = [
            np.minimum(position - low, high - position)
            for position, low, high in zip(positions, part["low"], part["high"], strict=True)
        ]
        depth = np.minimum(np.minimum(sides[0], sides[1]), sides[2])
    edge = part.get("edge", 0.0)
    return _filled(np.clip(depth / edge, 0, 1) if edge > 0 else depth >= 0, shape)


def smoke_extent(density: np.ndarray, placement: Placement | None) -> np.ndarray | None:
    """The lowest and the highest coordinates (X, Y, Z) of cell centres with smoke, (2, 3); None if there is no smoke.

    Args:
        density: (D, H, W).
        placement: of its grid, see `cell_positions`.
    """
    box = smoke_box(density, margin=0)
    if box is None:
        return None
    positions = [np.broadcast_to(values, density.shape)[box] for values in cell_positions(density.shape, placement)]
    return np.array([[values.min() for values in positions], [values.max() for values in positions]])


def ramp(key: str, values: np.ndarray, first: float, last: float) -> np.ndarray:
    """Values mapped linearly, from 0 at `first` to 1 at `last`, which may be the smaller one, and clipped to [0, 1].

    Args:
        key: what the recipe calls the two numbers.
        values: of any shape.
        first: what becomes 0.
        last: what becomes 1.

    Raises:
        InputError: both are the same, as they can be between keyframes.
    """
    if first == last:
        raise InputError(f"{key}: is [{first:g}, {last:g}] between its keyframes, expected two different numbers")
    return np.clip((values - first) / (last - first), 0, 1)


def _require_ordered(low: tuple[float, ...], high: tuple[float, ...]) -> None:
    for axis, least, most in zip("xyz", low, high, strict=True):
        if least > most:
            raise InputError(f"low = {list(low)} is above high = {list(high)} along {axis}, expected the lower first")


def _filled(values: np.ndarray, shape: Shape) -> np.ndarray:
    return np.ascontiguousarray(np.broadcast_to(values, shape), np.float32)
