"""Rays of several centred orthographic views of one grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.kernels import Divisor, opaque, opaque_int
from tnst_mi.rendering.cameras.views import View, camera_frame


@dataclass(frozen=True)
class ParallelRays:
    """Marks rays as those of whole orthographic views, so that the samples of each view form a regular lattice.

    Attributes:
        width, height: number of evenly spaced pixels that a view's rays go through, row by row; at least two each.
        directions: by view, the direction of its rays in world space, a unit vector: (V, 3).
    """

    width: int
    height: int
    directions: np.ndarray


class OrthographicRays:
    """The rays of V views that are centred on the origin and whose images are stacked.

    Args:
        width, height: pixels of one view.
        spacing: distance between pixels in world units.
        distance: distance of the ray origins from the centre, in world units.
        views: V pairs (azimuth, elevation) in degrees.
    """

    def __init__(self, width: int, height: int, spacing: float, distance: float, views: Sequence[View]) -> None:
        self.width, self.height, self.spacing, self.distance = width, height, spacing, distance
        self.views = [(float(view[0]), float(view[1])) for view in views]
        #: right, up and towards-the-camera vectors of every view: 9 numbers each.
        self.frames = mi.Float(np.ravel([camera_frame(*view) for view in self.views]).astype(np.float32))

    def through(self, position: mi.Point2f, active: mi.Bool | bool = True) -> mi.Ray3f:
        """Rays through positions in [0, 1]² of the stacked images, measured from the upper left corner."""
        width, height, count = opaque(self.width), opaque(self.height), len(self.views)
        row = position.y * height * opaque(count)
        view = dr.clip(mi.UInt32(row / height), 0, mi.UInt32(opaque_int(count - 1)))
        spacing = opaque(self.spacing)
        x = (position.x * width - width * 0.5) * spacing
        y = (height * 0.5 - (row - mi.Float(view) * height)) * spacing

        right, up, towards = (
            mi.Vector3f(*(dr.gather(mi.Float, self.frames, view * 9 + 3 * v + i, active) for i in range(3)))
            for v in range(3)
        )
        ray = dr.zeros(mi.Ray3f, dr.width(row))
        ray.o = mi.Point3f(right * x + up * y + towards * opaque(self.distance))
        ray.d = -towards
        ray.maxt = dr.inf
        return ray

    def through_pixels(self, first: int, count: int) -> mi.Ray3f:
        """Rays through the pixel centres of `count` views, starting at number `first`, row by row."""
        row, column = Divisor(self.width).split_first(count * self.height * self.width)
        row += mi.UInt32(opaque_int(first * self.height))
        x = (mi.Float(column) + 0.5) / opaque(self.width)
        y = (mi.Float(row) + 0.5) / opaque(len(self.views) * self.height)
        return self.through(mi.Point2f(x, y))

    def together(self, first: int, count: int) -> ParallelRays | None:
        """What the rays of `through_pixels(first, count)` have in common; None if a view's form a single line."""
        if min(self.width, self.height) < 2:
            return None
        towards = [camera_frame(*view)[2] for view in self.views[first : first + count]]
        return ParallelRays(self.width, self.height, -np.array(towards))
