"""Where v* moves the smoke of a frame, prepared for pictures from any side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tnst_mi.studio.opened import GridPair, pooled
from tnst_mi.studio.wheel import coloured

#: Share of the smoke that moves less far than what has the full colour.
_USUAL = 0.98

#: In a cut, the components (x, y, z) of vectors to the right and upwards, with their signs.
_IN_CUT = {"x": ((2, -1), (1, 1)), "y": ((0, 1), (2, -1)), "z": ((0, 1), (1, 1))}


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
) -> np.ndarray:
    """v* in a cut through the full grid in colours, (rows, columns, 3).

    Args:
        moving: the smoke and its movement.
        cut: from the grid to the picture.
        axis: across which it cuts.
        density: of the same cut, (rows, columns).
    """
    plane = cut(moving.full) / np.where(density > 0, density, 1.0)[..., None]
    right, up = (sign * plane[..., component] for component, sign in _IN_CUT[axis])
    return coloured(right, up, np.clip(density, 0.0, 1.0), moving.usual)
