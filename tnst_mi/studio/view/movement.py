"""Where v* moves the smoke of a frame, prepared for pictures from any side."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tnst_mi.studio.view.opened import GridPair, pooled
from tnst_mi.studio.view.sight import Sight
from tnst_mi.studio.view.wheel import coloured, coloured_by_depth

#: Share of the smoke that moves less far than what has the full colour.
_USUAL = 0.98

#: In a cut, the components (x, y, z) of vectors to the right, upwards and towards the eye, with their signs.
_IN_CUT = {
    "x": ((2, -1), (1, 1), (0, 1)),
    "y": ((0, 1), (2, -1), (1, 1)),
    "z": ((0, 1), (1, 1), (2, 1)),
}

#: Arrows in a picture, at most, and the least of the smoke along a ray that has one, as a share of the most.
MOST_ARROWS, _LEAST_SMOKE = 600, 0.03


@dataclass(frozen=True, eq=False)
class MovingSmoke:
    """The smoke of a frame times its movement.

    Attributes:
        full, coarse: density times v*, (D, H, W, 3) float32, on both grids of a frame.
        farthest: the largest component or length of v* where there is smoke, in cells.
        usual: how far most of the smoke moves at most, in cells.
    """

    full: np.ndarray
    coarse: np.ndarray
    farthest: float
    usual: float

    @classmethod
    def of(cls, frame: GridPair, velocity: np.ndarray) -> MovingSmoke:
        """That of a frame and its v* (D, H, W, 3), in cells."""
        density = frame.full.density
        full = density[..., None] * velocity
        coarse = full
        if frame.coarse is not frame.full:
            factor = round(frame.coarse.h)
            coarse = np.stack([pooled(full[..., axis], factor) for axis in range(3)], axis=-1)
        lengths = np.linalg.norm(velocity, axis=-1)[density > 0]
        if not lengths.size:
            return cls(full, coarse, 0.0, 0.0)
        order = np.argsort(lengths)
        held = np.cumsum(density[density > 0][order], dtype=np.float64)
        usual = float(lengths[order][np.searchsorted(held, _USUAL * held[-1])])
        return cls(full, coarse, float(lengths.max()), usual)


def cut_movement(
    moving: MovingSmoke,
    cut: Callable[[np.ndarray], np.ndarray],
    axis: str,
    density: np.ndarray,
    mode: str,
) -> np.ndarray:
    """v* in a cut through the full grid in colours, (rows, columns, 3).

    Args:
        moving: the smoke and its movement.
        cut: from the grid to the picture.
        axis: across which it cuts.
        density: of the same cut, (rows, columns).
        mode: "movement" in the picture, or "depth".
    """
    plane = cut(moving.full) / np.where(density > 0, density, 1.0)[..., None]
    right, up, towards = (sign * plane[..., component] for component, sign in _IN_CUT[axis])
    brightness = np.clip(density, 0.0, 1.0)
    if mode == "depth":
        return coloured_by_depth(towards, brightness, moving.usual)
    return coloured(right, up, brightness, moving.usual)


@dataclass(frozen=True, eq=False)
class Arrows:
    """v* in a picture as arrows on a square lattice, each the mean over the smoke along one ray.

    In perspective, lengths are those at the distance of the grid's centre.

    Attributes:
        places: (N, 2) where arrows begin, in pixels from the left and from the top.
        steps: (N, 2) how far the smoke moves to the right and upwards, in pixels.
        spacing: of the lattice, in pixels.
        cell: size of a full-resolution cell, in pixels.
        usual: how far most of the smoke moves at most, in cells.
    """

    places: np.ndarray
    steps: np.ndarray
    spacing: float
    cell: float
    usual: float

    def described(self) -> dict[str, Any]:
        """What the page draws, as values for JSON."""
        rounded = np.round(np.hstack([self.places, self.steps]), 2)
        return {"arrows": rounded.tolist(), "spacing": self.spacing, "cell": self.cell, "usual": self.usual}


def lattice_of(sight: Sight) -> Sight:
    """The same sight in as few pixels as there may be arrows, each as wide as it is high."""
    rows = max(1, min(sight.rows, math.floor(math.sqrt(MOST_ARROWS * sight.rows / sight.columns))))
    columns = max(1, min(round(rows * sight.columns / sight.rows), MOST_ARROWS // rows))
    return replace(sight, rows=rows, columns=columns)


def arrows_on(
    lattice: Sight, sight: Sight, smoke: np.ndarray, right: np.ndarray, up: np.ndarray, usual: float
) -> Arrows:
    """Arrows in a picture, where there is smoke.

    Args:
        lattice: that of the picture.
        sight: the picture.
        smoke: how much of it there is along the ray of each point of the lattice, (rows, columns).
        right, up: the movement along these, in cells.
        usual: as in `Arrows`.
    """
    spacing, cell = sight.rows / lattice.rows, sight.rows / sight.height
    y, x = np.nonzero(smoke > _LEAST_SMOKE * smoke.max())
    # The lattice is a bit narrower or wider than the picture, and has the same middle.
    places = np.stack([sight.columns / 2 + (x + 0.5 - lattice.columns / 2) * spacing, (y + 0.5) * spacing], axis=1)
    steps = cell * np.stack([right[y, x], up[y, x]], axis=1)
    inside = (places[:, 0] > 0) & (places[:, 0] < sight.columns)
    return Arrows(places[inside], steps[inside], spacing, cell, usual)
