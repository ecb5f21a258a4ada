"""The back-projection of rays that converge in an eye, and the choice between the two kinds."""

from __future__ import annotations

import math
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.kernels import on_device, opaque, opaque_int
from tnst_mi.fields.stencil import larger, smaller
from tnst_mi.rendering.cameras.orthographic import ParallelRays
from tnst_mi.rendering.cameras.perspective import ConvergingRays, ImagePlane
from tnst_mi.rendering.march.back_projection import RUN, BackProjection, ParallelBackProjection, RaysTogether
from tnst_mi.rendering.march.lattice import AT_EYE, Lattice
from tnst_mi.rendering.march.medium import GridMedium, GridTransform

#: What describes the lattice of a view; see `_lattices_of`.
NUMBERS = 29


class ConvergingBackProjection(BackProjection):
    r"""The back-projection of rays from an eye, through the pixels of a plane that faces the camera.

    The samples form a projective lattice: that of column p and row q in plane j lies at x = o + j c + s_j (p a + q b)
    (in cells), where the pixels' spacing grows with the distance from the eye, s_j = s + σ j; σ = 0 for parallel rays.
    With M = [a b c], u = s_j p and w = s_j q are the first two numbers of M⁻¹ (x − o), and j is the third. A plane j
    meets the cube of voxels' reach around v where (u, w) is near that of v: moved along with j by the slopes λ, u is
    within Σ_i |M⁻¹_u − λ_u M⁻¹_j|_i, and the slope is the one for which that is least. Each voxel loops over planes,
    rows and columns, view after view.

    Args:
        medium: the grid and its place in the world.
        lattice: the samples of the rays.
        rays: what the rays of each view have in common.
    """

    rays: ConvergingRays

    def __init__(self, medium: GridMedium, lattice: Lattice, rays: ConvergingRays) -> None:
        super().__init__(medium, lattice, rays)
        phase = 0.0 if self.shape[0] % 2 else 0.5
        numbers = _lattices_of(rays.planes, medium.transform, self.shape, lattice.spacing, phase - self.before)
        #: The numbers of `_lattices_of`, one array for each of a single view, and one of all of several.
        self.numbers = [on_device(mi.Float, kind) for kind in (numbers.T if self.views == 1 else [numbers.ravel()])]
        dr.eval(self.first)

    def _of_view(self, view: mi.UInt32, voxel: mi.Vector3f) -> list[mi.Float]:
        """The back-projected values of a run of voxels, of one view."""
        d, h, w = self.shape
        last = mi.Vector3f(*(opaque(n - 1) for n in (w, h, d)))
        last_column, last_row = opaque(self.rays.width - 1), opaque(self.rays.height - 1)
        width = opaque_int(self.rays.width)
        numbers, last_plane, plane_start = self.numbers, self.last_plane, self.start
        if self.views > 1:
            first = view * NUMBERS
            numbers = [dr.gather(mi.Float, numbers[0], first + i) for i in range(NUMBERS)]
            last_plane, plane_start = dr.gather(mi.Float, last_plane, view), dr.gather(mi.Int32, plane_start, view)
        origin, a, b, c, to_u, to_w, to_j = (mi.Vector3f(*numbers[i : i + 3]) for i in range(0, 21, 3))
        slope_u, slope_w, reach_u, reach_w, reach_j, scale, growth, first_plane = numbers[21:]

        # From here on positions are relative to the voxel. Beyond the outermost cells, which repeat there, a sample's
        # weight does not fall: a slope is 0.
        origin = origin - voxel
        falls, rises = (
            [dr.select(at_wall, 0.0, 1.0) for at_wall in walls]
            for walls in ([voxel[i] == last[i] for i in range(3)], [voxel[i] == 0 for i in range(3)])
        )
        falls += [dr.select(voxel.z + k == last.z, 0.0, 1.0) for k in range(1, RUN)]

        def hat(x: mi.Float, fall: mi.Float, rise: mi.Float | float) -> mi.Float:
            return larger(smaller(1 - fall * x, 1 + rise * x), 0)

        middle = mi.Vector3f(0, 0, (RUN - 1) / 2) - origin
        u, w, plane = (dr.dot(row, middle) for row in (to_u, to_w, to_j))
        low_plane = mi.Int32(dr.ceil(larger(plane - reach_j, first_plane)))
        high_plane = mi.Int32(dr.floor(smaller(plane + reach_j, last_plane)))

        def of_plane(j: mi.Int32, sums: list[mi.Float]) -> tuple[mi.Int32, list[mi.Float]]:
            number = mi.Float(j)
            spacing = dr.fma(growth, number, scale)
            per_pixel, ahead = 1 / spacing, number - plane
            middle_u, middle_w = dr.fma(slope_u, ahead, u), dr.fma(slope_w, ahead, w)
            left, top = (
                mi.Int32(dr.ceil(larger((centre - reach) * per_pixel, 0)))
                for centre, reach in ((middle_u, reach_u), (middle_w, reach_w))
            )
            right, bottom = (
                mi.Int32(dr.floor(smaller((centre + reach) * per_pixel, end)))
                for centre, reach, end in ((middle_u, reach_u, last_column), (middle_w, reach_w, last_row))
            )
            across, down = a * spacing, b * spacing
            corner = origin + c * number + across * mi.Float(left) + down * mi.Float(top)
            first = plane_start + dr.fma(j, self.pixels, dr.fma(top, width, left))

            def of_row(q: mi.Int32, position: mi.Vector3f, index: mi.Int32, sums: list[mi.Float]) -> tuple:
                def of_column(p: mi.Int32, at: mi.Vector3f, sums: list[mi.Float]) -> tuple:
                    value = dr.gather(mi.Float, self.values, mi.UInt32(index + p))
                    value *= hat(at.x, falls[0], rises[0]) * hat(at.y, falls[1], rises[1])
                    sums = [
                        dr.fma(hat(at.z - k, falls[2 + k], rises[2] if k == 0 else 1.0), value, total)
                        for k, total in enumerate(sums)
                    ]
                    return p + 1, at + across, sums

                state = (mi.Int32(0), position, sums)
                sums = dr.while_loop(state, lambda p, *_: p <= right - left, of_column, label="columns")[2]
                return q + 1, position + down, index + width, sums

            state = (top, corner, first, sums)
            return j + 1, dr.while_loop(state, lambda q, *_: q <= bottom, of_row, label="rows")[3]

        sums = [dr.zeros(mi.Float, dr.width(voxel)) for _ in range(RUN)]
        return dr.while_loop((low_plane, sums), lambda j, _: j <= high_plane, of_plane, label="planes")[1]


def back_projection(medium: GridMedium, lattice: Lattice, rays: RaysTogether) -> BackProjection:
    """The back-projection of the samples of some rays, which have this in common."""
    if isinstance(rays, ParallelRays):
        return ParallelBackProjection(medium, lattice, rays)
    return ConvergingBackProjection(medium, lattice, rays)


def _lattices_of(
    planes: Sequence[ImagePlane],
    transform: GridTransform,
    shape: tuple[int, int, int],
    spacing: float,
    first: np.ndarray,
) -> np.ndarray:
    """The projective lattices of V image planes, in `NUMBERS` numbers each.

    They are o, a, b, c, the rows of M⁻¹, λ_u, λ_w, the reaches of u, w and j, s, σ, and the first plane.

    Args:
        planes: of the views.
        transform: world space to the grid's unit cube.
        shape: (D, H, W) of the grid.
        spacing: distance between planes of samples, in world units.
        first: places of plane 0 of each view, in planes beyond the grid's centre.
    """
    size = np.array(shape[::-1])
    to_cells = (size[:, None] * transform.matrix).T
    names = ("foot", "towards", "corner", "across", "down", "spread")
    foot, towards, corner, across, down, spread = (np.array([getattr(p, name) for p in planes]) for name in names)
    foot = foot - transform.centre
    # How far plane 0 is beyond the image plane.
    beyond = (first * spacing + (foot * towards).sum(1))[:, None]
    scale, growth = 1 + spread[:, None] * beyond, spread[:, None] * spacing
    a, b, towards = (vectors @ to_cells for vectors in (across, down, towards))
    corner = (corner + across / 2 + down / 2) @ to_cells
    origin = foot @ to_cells + (size - 1) / 2 - beyond * towards + scale * corner
    c = growth * corner - spacing * towards
    rows = np.linalg.inv(np.stack([a, b, c], axis=2))
    to_j = rows[:, 2]
    # Of a run of voxels along z, about their middle.
    reach = np.array([1.0, 1.0, 1.0 + (RUN - 1) / 2])
    slopes = np.stack([_least_reach(rows[:, i], to_j, reach) for i in range(2)], axis=1)
    reaches = np.concatenate([np.abs(rows[:, :2] - slopes[:, :, None] * to_j[:, None]), rows[:, 2:]], axis=1)
    # Planes at and behind the eye have no samples.
    at_eye = np.divide(scale, growth, out=np.full_like(scale, math.inf), where=growth > 0)
    in_front = np.maximum(np.ceil(AT_EYE / 2 - at_eye), 0)
    vectors = (origin, a, b, c, rows.reshape(-1, 9), slopes, np.abs(reaches) @ reach, scale, growth, in_front)
    return np.concatenate(vectors, axis=1)


def _least_reach(rows: np.ndarray, others: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The λ of each row for which Σ_i |row − λ other|_i weights_i is least: it makes one of the terms 0."""
    quotients = np.divide(rows, others, out=np.zeros_like(rows), where=others != 0)
    slopes = np.concatenate([np.zeros_like(rows[:, :1]), quotients], axis=1)
    sums = np.abs(rows[:, None] - slopes[:, :, None] * others[:, None]) @ weights
    return np.take_along_axis(slopes, sums.argmin(1)[:, None], axis=1)[:, 0]
