"""The sample positions of a march along its rays."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.kernels import opaque
from tnst_mi.fields.stencil import ClampedStencil
from tnst_mi.rendering.march.medium import GridMedium

#: Planes of samples nearer to the eye than this, in parts of their distance, count as being at the eye.
AT_EYE = 1e-3


class Lattice:
    """The sample positions of a set of rays: multiples of `step` from the point nearest the grid's centre.

    Sample k of n lies at (k − (n − 1)/2) step from that point, where n has the parity of D: a ray along z through a
    grid of cubic cells, with the cell size as step, samples exactly the cell centres. Only samples inside the grid's
    box are visited, and of these only those in front of the ray's origin and inside the shape around the medium.

    Where rays share the `axis` of a camera, samples lie in planes across it instead, `step` apart, one of which, or the
    middle between two, passes through the grid's centre. They are farther apart along rays oblique to the axis, and
    those of an orthographic camera are the same as without an axis.

    Args:
        medium: the grid and its place in the world.
        ray: the rays; their directions are unit vectors.
        step: distance between samples in world units.
        crossing: distances at which the rays enter and leave that shape; None if it is the grid's box.
        axis: for each ray, the direction in which its camera looks, a unit vector; None for rays without a camera.

    Attributes:
        entry, exit: distances along the rays, ≥ 0, between which there are samples; empty where entry > exit.
        count: number of samples of each ray.
        spacing: distance between samples, or between their planes, in world units.
        step: distance between samples on the device: one number, or one for each ray if there is an axis.
        first: for each ray, the value of k − (n − 1)/2 (rounded down) at its first sample.
    """

    def __init__(
        self,
        medium: GridMedium,
        ray: mi.Ray3f,
        step: float,
        crossing: tuple[mi.Float, mi.Float] | None = None,
        axis: mi.Vector3f | None = None,
    ) -> None:
        d, h, w = medium.grid_shape
        size = mi.Vector3f(*(opaque(n) for n in (w, h, d)))
        matrix = mi.Matrix3f([[opaque(value) for value in row] for row in medium.transform.matrix.tolist()])
        centre = mi.Point3f(*(opaque(value) for value in medium.transform.centre.tolist()))
        self.step = opaque(step)
        phase = opaque(0.0 if d % 2 else 0.5)

        nearest = dr.dot(centre - ray.o, ray.d)
        if axis is not None:
            cosine = dr.dot(axis, ray.d)
            self.step = self.step / cosine
            nearest = dr.dot(centre - ray.o, axis) / cosine
        # Both in cells, with the centre of cell 0 as origin.
        origin = (matrix @ mi.Vector3f(ray.o + nearest * ray.d - centre)) * size + (size - 1) * 0.5
        direction = (matrix @ mi.Vector3f(ray.d)) * size

        to_low, to_high = (-0.5 - origin) / direction, (size - 0.5 - origin) / direction
        # A ray parallel to a face gives 0/0 on it and ±∞ elsewhere; dr.minimum would propagate the NaN.
        parallel = direction == 0
        within = (origin >= -0.5) & (origin <= size - 0.5)
        low = dr.select(parallel, dr.select(within, -dr.inf, dr.inf), dr.minimum(to_low, to_high))
        high = dr.select(parallel, dr.select(within, dr.inf, -dr.inf), dr.maximum(to_low, to_high))
        # In planes across an axis, one at the eye itself has no samples: they would be the same for all rays.
        begin = dr.maximum(dr.max(low), -nearest if axis is None else opaque(AT_EYE) * self.step - nearest)
        end = dr.min(high)
        if crossing is not None:
            begin = dr.maximum(begin, crossing[0] - nearest)
            end = dr.minimum(end, crossing[1] - nearest)
        self.entry, self.exit = begin + nearest, end + nearest

        first = dr.ceil(begin / self.step - phase)
        last = dr.floor(end / self.step - phase)
        self.count = mi.UInt32(mi.Int32(dr.select(last >= first, last - first + 1, 0)))
        self.increment = direction * self.step
        self.first = dr.select(last >= first, first, 0)
        self.origin = origin + (self.first + phase) * self.increment
        self.shape, self.spacing, self._diagonal = (d, h, w), step, medium.transform.diagonal

    @property
    def longest(self) -> int:
        """Upper bound on the number of samples of a ray."""
        return math.ceil(self._diagonal() / self.spacing) + 2

    def leave_out(self, hidden: mi.Bool) -> None:
        """Remove all samples of the `hidden` rays."""
        self.count = dr.select(hidden, 0, self.count)

    def stencil(self, k: mi.UInt32 | mi.Float) -> ClampedStencil:
        """The eight cells around sample k, counted from the first of each ray."""
        return ClampedStencil(self.shape, dr.fma(self.increment, mi.Float(k), self.origin))
