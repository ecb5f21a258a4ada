"""Rays of any viewpoints of one grid, stacked: centred views, in perspective or not, and the cameras of shots.

Sets of centred orthographic views alone have their own, simpler rays: see `orthographic`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.kernels import Divisor, on_device, opaque, opaque_int
from tnst_mi.rendering.cameras.camera import Camera, Viewpoint
from tnst_mi.rendering.cameras.orthographic import OrthographicRays
from tnst_mi.rendering.cameras.views import camera_frame, distance_of


@dataclass(frozen=True)
class ImagePlane:
    """The rays of a viewpoint: where they cross a plane that faces the camera, and how they spread from there.

    The ray through a point at X from `foot` in the plane has the direction `spread` X − `towards`: parallel rays have
    no spread. So numbers stay small, and images become those of an orthographic view, however far away an eye is. All
    vectors are (3,) float64, in world space.

    Attributes:
        foot: where the optical axis meets the plane.
        towards: the plane's normal towards the camera, a unit vector.
        corner: from the foot to the upper left corner of the image.
        across, down: from a pixel to the next one in its row, and to the next one in its column.
        spread: 1 over the distance of the eye from the plane; 0 for parallel rays.
        start: how far in front of the plane rays start: at the eye, or nearer where that is outside the grid anyway.
    """

    foot: np.ndarray
    towards: np.ndarray
    corner: np.ndarray
    across: np.ndarray
    down: np.ndarray
    spread: float
    start: float

    @classmethod
    def of(cls, viewpoint: Viewpoint, size: tuple[int, int], pixel: float, outside: float) -> ImagePlane:
        """The plane of a viewpoint, through the origin wherever that is well in front of the camera.

        Args:
            viewpoint: a view of the origin, or a camera.
            size: rows and columns of the image.
            pixel: distance between pixels of a view in the plane through the origin.
            outside: distance from the origin beyond which there is no smoke.
        """
        rows, columns = size
        if isinstance(viewpoint, Camera):
            (right, up, towards), position = viewpoint.axes, viewpoint.position
            before = float(position @ towards)
            # With the origin beside or behind the camera, the plane is elsewhere.
            reach = max(before, outside / 2) if viewpoint.perspective else before
            height = 2 * reach * math.tan(math.radians(viewpoint.field) / 2)
            height = height if viewpoint.perspective else viewpoint.field
            width, foot = viewpoint.aspect * height, position - reach * towards
            centre = -height * (viewpoint.shift[0] * right + viewpoint.shift[1] * up)
            spread = 1 / reach if viewpoint.perspective else 0.0
        else:
            (right, up, towards), distance = camera_frame(*viewpoint[:2]), distance_of(viewpoint)
            before = reach = math.inf if distance is None else distance
            width, height = columns * pixel, rows * pixel
            foot, centre, spread = np.zeros(3), np.zeros(3), 1 / reach
        corner = centre - width / 2 * right + height / 2 * up
        # The plane is `before` − `reach` beyond the origin.
        start = min(reach, outside + (reach - before if spread else 0.0))
        return cls(foot, towards, corner, width / columns * right, -height / rows * up, spread, start)

    def starts_inside(self, size: np.ndarray) -> bool:
        """Whether rays may start inside a box of this size (x, y, z) about the origin."""
        eye = self.foot + self.start * self.towards
        if self.spread and self.start * self.spread > 1 - 1e-12:
            return bool((np.abs(eye) < size / 2).all())
        return float(eye @ self.towards) < float(np.abs(self.towards) @ size / 2)


@dataclass(frozen=True)
class ConvergingRays:
    """Marks rays as those of whole viewpoints, so that the samples of each form a projective lattice.

    Attributes:
        width, height: number of pixels that a viewpoint's rays go through, row by row.
        planes: the image planes of the viewpoints.
        axis: of each ray, the direction in which its camera looks, a unit vector.
    """

    width: int
    height: int
    planes: Sequence[ImagePlane]
    axis: mi.Vector3f

    @property
    def directions(self) -> np.ndarray:
        """By viewpoint, the direction in which it looks: (V, 3)."""
        return np.array([-plane.towards for plane in self.planes])


class ViewpointRays:
    """The rays of V viewpoints whose images are stacked.

    Args:
        width, height: pixels of one image.
        spacing: distance between pixels in world units; cameras have their own.
        distance: distance from the origin beyond which there is no smoke, in world units.
        viewpoints: V of them; see `rendering.cameras.views` and `rendering.cameras.camera`.
    """

    def __init__(
        self, width: int, height: int, spacing: float, distance: float, viewpoints: Sequence[Viewpoint]
    ) -> None:
        self.width, self.height = width, height
        self.planes = [ImagePlane.of(viewpoint, (height, width), spacing, distance) for viewpoint in viewpoints]
        origins = [plane.foot + plane.start * plane.towards for plane in self.planes]
        narrowed = [1 - plane.start * plane.spread for plane in self.planes]
        #: By viewpoint, 17 numbers: five vectors, how much of a point's distance from the axis is left where its ray
        #: starts, and the spread.
        self.numbers = on_device(
            mi.Float,
            np.ravel(
                [
                    [*plane.towards, *origin, *plane.corner, *plane.across, *plane.down, narrow, plane.spread]
                    for plane, origin, narrow in zip(self.planes, origins, narrowed, strict=True)
                ]
            ),
        )

    def through(self, position: mi.Point2f, active: mi.Bool | bool = True) -> mi.Ray3f:
        """Rays through positions in [0, 1]² of the stacked images, measured from the upper left corner."""
        view, row = self._view_and_row(position)
        towards, origin, corner, across, down = (self._vector(view, i, active) for i in range(5))
        narrow, spread = (self._number(view, i, active) for i in (15, 16))
        place = corner + across * (position.x * opaque(self.width)) + down * row
        ray = dr.zeros(mi.Ray3f, dr.width(row))
        ray.o = mi.Point3f(origin + place * narrow)
        ray.d = dr.normalize(place * spread - towards)
        ray.maxt = dr.inf
        return ray

    def axis(self, position: mi.Point2f, active: mi.Bool | bool = True) -> mi.Vector3f:
        """The directions in which the cameras of the rays through such positions look."""
        return -self._vector(self._view_and_row(position)[0], 0, active)

    def through_pixels(self, first: int, count: int) -> mi.Ray3f:
        """Rays through the pixel centres of `count` viewpoints, starting at number `first`, row by row."""
        return self.through(self._centres(first, count))

    def together(self, first: int, count: int) -> ConvergingRays:
        """What the rays of `through_pixels(first, count)` have in common."""
        planes = self.planes[first : first + count]
        return ConvergingRays(self.width, self.height, planes, self.axis(self._centres(first, count)))

    def _centres(self, first: int, count: int) -> mi.Point2f:
        row, column = Divisor(self.width).split_first(count * self.height * self.width)
        row += mi.UInt32(opaque_int(first * self.height))
        x = (mi.Float(column) + 0.5) / opaque(self.width)
        return mi.Point2f(x, (mi.Float(row) + 0.5) / opaque(len(self.planes) * self.height))

    def _view_and_row(self, position: mi.Point2f) -> tuple[mi.UInt32, mi.Float]:
        """The number of the viewpoint, and the row in its image."""
        height, count = opaque(self.height), len(self.planes)
        row = position.y * height * opaque(count)
        view = dr.clip(mi.UInt32(row / height), 0, mi.UInt32(opaque_int(count - 1)))
        return view, row - mi.Float(view) * height

    def _number(self, view: mi.UInt32, i: int, active: mi.Bool | bool) -> mi.Float:
        return dr.gather(mi.Float, self.numbers, view * 17 + i, active)

    def _vector(self, view: mi.UInt32, i: int, active: mi.Bool | bool) -> mi.Vector3f:
        return mi.Vector3f(*(self._number(view, 3 * i + k, active) for k in range(3)))


def require_outside(viewpoints: Sequence[Viewpoint], shape: tuple[int, int, int], h: float, what: str) -> None:
    """Check that no ray starts in a grid (D, H, W) of cells of size h, for what follows rays from outside alone.

    Raises:
        InputError: a camera is inside.
    """
    size = h * np.array(shape[::-1], float)
    for viewpoint in viewpoints:
        if ImagePlane.of(viewpoint, (1, 1), 1.0, 2 * float(np.linalg.norm(size))).starts_inside(size):
            raise InputError(
                f"{what}: a camera is inside the grid of the smoke, from where paths would miss some; expected one "
                f"outside {' × '.join(f'{n:g}' for n in size)} cells along x, y and z about the centre"
            )


def rays_of(
    viewpoints: Sequence[Viewpoint], width: int, height: int, spacing: float, distance: float
) -> OrthographicRays | ViewpointRays:
    """The rays of viewpoints, the simpler ones if all are centred orthographic views; see `ViewpointRays`."""
    views = [viewpoint for viewpoint in viewpoints if not isinstance(viewpoint, Camera) and len(viewpoint) == 2]
    if len(views) == len(viewpoints):
        return OrthographicRays(width, height, spacing, distance, views)
    return ViewpointRays(width, height, spacing, distance, viewpoints)
