"""The transpose of interpolation at the samples of rays, in gather form: each voxel collects from its samples.

A scatter needs eight additions to memory per sample, which have to be exact for a repeatable sum. Here every voxel
reads the samples around it, also about eight, and adds them up in a fixed order. Here, too, for parallel rays; for
those that converge in an eye see `converging`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.grid import Cells
from tnst_mi.fields.kernels import Divisor, on_device, opaque, opaque_int, require_indexable
from tnst_mi.fields.stencil import larger, smaller
from tnst_mi.rendering.cameras.orthographic import ParallelRays
from tnst_mi.rendering.cameras.perspective import ConvergingRays
from tnst_mi.rendering.march.lattice import Lattice
from tnst_mi.rendering.march.medium import GridMedium

RUN = 2
"""Voxels per thread, consecutive along z: they share most of the samples they read."""


#: What the rays of whole viewpoints have in common.
RaysTogether = ParallelRays | ConvergingRays


class BackProjection(ABC):
    """Values at the samples of some views, and their back-projection to the cells.

    Args:
        medium: the grid and its place in the world.
        lattice: the samples of the rays.
        rays: what the rays of each view have in common.

    Attributes:
        before: by view, the number of planes of samples in front of the one at or behind the grid's centre.
    """

    def __init__(self, medium: GridMedium, lattice: Lattice, rays: RaysTogether) -> None:
        self.shape, self.rays, self.views = medium.grid_shape, rays, len(rays.directions)
        # Planes of the lattice: enough to cover the grid on both sides of its centre.
        extents = np.abs(rays.directions @ np.linalg.inv(medium.transform.matrix)).sum(axis=1)
        self.before = np.ceil(extents / (2 * lattice.spacing)).astype(int) + 1
        planes = 2 * self.before + 1
        pixels = rays.width * rays.height
        require_indexable(pixels * int(planes.sum()), "the samples of the rays: an array")
        self.pixels = opaque_int(pixels)
        #: By view: the last plane of its lattice, and where its values begin.
        self.last_plane = on_device(mi.Float, planes - 1)
        self.start = on_device(mi.Int32, pixels * (np.cumsum(planes) - planes))
        #: Samples that no ray visits stay 0.
        self.values = dr.zeros(mi.Float, pixels * int(planes.sum()))
        view, pixel = Divisor(pixels).split_first(pixels * self.views)
        self.planes_before = dr.gather(mi.Float, on_device(mi.Float, self.before), view)
        #: By ray: where the value of its first sample is stored.
        self.first = mi.Int32(lattice.first + self.planes_before) * self.pixels
        self.first += dr.gather(mi.Int32, self.start, view) + mi.Int32(pixel)

    def store(self, k: mi.UInt32, value: mi.Float, active: mi.Bool | bool = True) -> None:
        """Set the value at sample k of every ray of the lattice."""
        dr.scatter(self.values, value, mi.UInt32(dr.fma(mi.Int32(k), self.pixels, self.first)), active)

    def add_to(self, total: mi.Float) -> None:
        """Add the back-projected value of every voxel to `total`, one number per voxel, in place."""
        d, h, w = self.shape
        runs = Cells.of((-(-d // RUN), h, w))
        voxel = mi.Vector3f(mi.Float(runs.x), mi.Float(runs.y), mi.Float(runs.z * RUN))
        if self.views == 1:
            sums = self._of_view(mi.UInt32(0), voxel)
        else:
            views = mi.UInt32(opaque_int(self.views))
            zeros = [dr.zeros(mi.Float, dr.width(voxel)) for _ in range(RUN)]

            def add_view(view: mi.UInt32, sums: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
                return view + 1, [a + b for a, b in zip(sums, self._of_view(view, voxel), strict=True)]

            state = (dr.zeros(mi.UInt32, dr.width(voxel)), zeros)
            sums = dr.while_loop(state, lambda view, _: view < views, add_view, label="views")[1]

        for i, value in enumerate(sums):
            z = runs.z * RUN + i
            index = mi.UInt32(dr.fma(dr.fma(z, opaque_int(h), runs.y), opaque_int(w), runs.x))
            # No voxel is written by two threads.
            mode = dr.ReduceMode.NoConflicts
            dr.scatter_reduce(dr.ReduceOp.Add, total, value, index, z < opaque_int(d), mode)
        dr.eval(total)

    @abstractmethod
    def _of_view(self, view: mi.UInt32, voxel: mi.Vector3f) -> list[mi.Float]:
        """The back-projected values of a run of voxels, of one view."""


class ParallelBackProjection(BackProjection):
    r"""The back-projection of parallel rays.

    The samples of parallel rays through a pixel grid form an affine lattice: sample j of the ray of column p and row q
    lies at x = o + p a + q b + j c (in cells). Interpolation gives voxel v the weight Π_i max(0, 1 − |x_i − v_i|), with
    x clamped to the grid. It vanishes unless x is within one cell of v on every axis, that is, unless (p, q, j) is
    within Σ_i |M⁻¹|_{·i} of M⁻¹ (v − o), with M = [a b c]: a box of lattice points over which each voxel loops, view
    after view.

    Args:
        medium: the grid and its place in the world.
        lattice: the samples of the rays.
        rays: what the rays of each view have in common.
    """

    rays: ParallelRays

    def __init__(self, medium: GridMedium, lattice: Lattice, rays: ParallelRays) -> None:
        super().__init__(medium, lattice, rays)
        pixels = rays.width * rays.height
        start = lattice.stencil(-lattice.first - self.planes_before).position
        increment = lattice.increment + mi.Vector3f(dr.zeros(mi.Float, pixels * self.views))
        dr.eval(start, increment, self.first)
        corners = dr.arange(mi.UInt32, self.views) * mi.UInt32(self.pixels)
        corner, right, below = (
            dr.gather(mi.Vector3f, start, corners + mi.UInt32(opaque_int(i)))
            for i in (0, rays.width - 1, pixels - rays.width)
        )
        #: By view, along p, q and j: the step from one lattice point to the next.
        self.steps = [
            (right - corner) / opaque(rays.width - 1),
            (below - corner) / opaque(rays.height - 1),
            dr.gather(mi.Vector3f, increment, corners),
        ]
        #: The stride of their values in storage.
        self.strides = [opaque_int(1), opaque_int(rays.width), self.pixels]
        self.origin = corner
        self.to_lattice = dr.rcp(mi.Matrix3f(*([step[i] for step in self.steps] for i in range(3))))
        dr.eval(self.origin, self.steps, self.to_lattice)

    def _of_view(self, view: mi.UInt32, voxel: mi.Vector3f) -> list[mi.Float]:
        """The back-projected values of a run of voxels, of one view."""
        d, h, w = self.shape
        last = mi.Vector3f(*(opaque(n - 1) for n in (w, h, d)))
        origin, to_lattice, *steps = self.origin, self.to_lattice, *self.steps
        last_plane, start = self.last_plane, self.start
        if self.views > 1:
            origin, *steps = (dr.gather(mi.Vector3f, vector, view) for vector in (origin, *steps))
            to_lattice = dr.gather(mi.Matrix3f, to_lattice, view)
            last_plane, start = dr.gather(mi.Float, last_plane, view), dr.gather(mi.Int32, start, view)

        # Lattice points within reach of any voxel of a run.
        middle = voxel - origin + mi.Vector3f(0, 0, (RUN - 1) / 2)
        low, high = [], []
        for axis, end in enumerate((opaque(self.rays.width - 1), opaque(self.rays.height - 1), last_plane)):
            row = mi.Vector3f(*(to_lattice[axis, i] for i in range(3)))
            centre = dr.dot(row, middle)
            reach = dr.sum(dr.abs(row)) + dr.abs(row.z) * ((RUN - 1) / 2)
            low.append(mi.Int32(dr.ceil(larger(centre - reach, 0))))
            high.append(mi.Int32(dr.floor(smaller(centre + reach, end))))

        def visit(position: mi.Vector3f, index: mi.Int32, sums: list[mi.Float]) -> list[mi.Float]:
            distance = mi.Vector3f(*(smaller(larger(position[i], 0), last[i]) for i in range(3))) - voxel
            x, y = (larger(1 - dr.abs(distance[i]), 0) for i in range(2))
            value = x * y * dr.gather(mi.Float, self.values, mi.UInt32(index))
            return [dr.fma(larger(1 - dr.abs(distance.z - i), 0), value, total) for i, total in enumerate(sums)]

        position, index = origin, start
        for axis in range(3):
            position = dr.fma(steps[axis], mi.Float(low[axis]), position)
            index += low[axis] * self.strides[axis]
        sums = [dr.zeros(mi.Float, dr.width(voxel)) for _ in range(RUN)]
        return self._visit_box((1, 0, 2), steps, low, high, visit, position, index, sums)

    # A method: a recursive closure would stay alive, with all its arrays, until Python's cyclic garbage collection.
    def _visit_box(
        self,
        axes: tuple[int, ...],
        steps: list[mi.Vector3f],
        low: list[mi.Int32],
        high: list[mi.Int32],
        visit: Callable[[mi.Vector3f, mi.Int32, list[mi.Float]], list[mi.Float]],
        position: mi.Vector3f,
        index: mi.Int32,
        sums: list[mi.Float],
    ) -> list[mi.Float]:
        """Sums after `visit` at all lattice points of a box that starts at `position`: one nested loop per axis."""
        if not axes:
            return visit(position, index, sums)
        axis, inner = axes[0], axes[1:]

        def body(i: mi.Int32, position: mi.Vector3f, index: mi.Int32, sums: list[mi.Float]) -> tuple:
            sums = self._visit_box(inner, steps, low, high, visit, position, index, sums)
            return i + 1, position + steps[axis], index + self.strides[axis], sums

        state = (low[axis], position, index, sums)
        return dr.while_loop(state, lambda i, *_: i <= high[axis], body, label="back-projection")[3]
