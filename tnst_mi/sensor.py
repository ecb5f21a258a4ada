"""The `orthographic_views` sensor plugin: several centred orthographic views of one grid in one image.

Importing this module registers the plugin for the active variant; `tnst_mi.plugins` does so for every variant.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.grid import Divisor, opaque, opaque_int
from tnst_mi.medium import ParallelRays
from tnst_mi.views import camera_frame


class OrthographicViews(mi.Sensor):
    r"""
    Stack of orthographic views (:monosp:`orthographic_views`)
    ----------------------------------------------------------

    .. pluginparameters::

     * - view_count
       - |int|
       - Number V of views. The film shows them from top to bottom: its height is V times that of a view.
         (Default: 1)
     * - spacing
       - |float|
       - Distance between pixels in world units. (Default: 1)
     * - distance
       - |float|
       - Distance of the sensor plane from the centre, in world units; it must lie outside the scene. (Default: 1000)

    All views look at the origin, which is the centre of their images. Rendering them in one launch costs one kernel
    instead of V, and moving them needs no new kernel.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.view_count = int(props.get("view_count", 1))
        self.spacing = float(props.get("spacing", 1.0))
        self.distance = float(props.get("distance", 1000.0))
        width, height = self.film().size()
        if self.view_count < 1 or height % self.view_count:
            raise ValueError(
                f'orthographic_views: a film of height {height} cannot show "view_count" = {self.view_count} views'
            )
        self.view_width, self.view_height = int(width), int(height) // self.view_count
        self.set_views([(0.0, 0.0)] * self.view_count)

    def set_views(self, views: Sequence[tuple[float, float]]) -> None:
        """Point the views at new (azimuth, elevation) angles in degrees; as many as `view_count`."""
        if len(views) != self.view_count:
            raise ValueError(f"orthographic_views: {len(views)} views given, expected {self.view_count}")
        self.views = [(float(azimuth), float(elevation)) for azimuth, elevation in views]
        #: right, up and towards-the-camera vectors of every view: 9 numbers each.
        self.frames = mi.Float(np.ravel([_camera_frame(*view) for view in self.views]).astype(np.float32))

    def sample_ray(
        self,
        time: mi.Float,
        sample1: mi.Float,
        sample2: mi.Point2f,
        sample3: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        """Ray through a position `sample2` of the film, in [0, 1]²."""
        width, height = (opaque(n) for n in (self.view_width, self.view_height))
        row = sample2.y * height * opaque(self.view_count)
        view = dr.clip(mi.UInt32(row / height), 0, mi.UInt32(opaque_int(self.view_count - 1)))
        spacing = opaque(self.spacing)
        x = (sample2.x * width - width * 0.5) * spacing
        y = (height * 0.5 - (row - mi.Float(view) * height)) * spacing

        right, up, towards = (
            mi.Vector3f(*(dr.gather(mi.Float, self.frames, view * 9 + 3 * v + i, active) for i in range(3)))
            for v in range(3)
        )
        ray = dr.zeros(mi.Ray3f, dr.width(row))
        ray.o = mi.Point3f(right * x + up * y + towards * opaque(self.distance))
        ray.d = -towards
        ray.maxt = dr.inf
        ray.time = time
        return ray, mi.Spectrum(1)

    def pixel_rays(self, first: int, count: int) -> mi.Ray3f:
        """Rays through the pixel centres of `count` views from number `first`, row by row."""
        pixel = dr.arange(mi.UInt32, count * self.view_height * self.view_width)
        row, column = Divisor(self.view_width).split(pixel)
        row += mi.UInt32(opaque_int(first * self.view_height))
        x = (mi.Float(column) + 0.5) / opaque(self.view_width)
        y = (mi.Float(row) + 0.5) / opaque(self.view_count * self.view_height)
        return self.sample_ray(0.0, 0.0, mi.Point2f(x, y), mi.Point2f(0.5))[0]

    def parallel_rays(self, view: int) -> ParallelRays | None:
        """What the rays through the pixel centres of a view have in common; None where they are but one row."""
        if min(self.view_width, self.view_height) < 2:
            return None
        return ParallelRays(self.view_width, self.view_height, -_camera_frame(*self.views[view])[2])

    def sample_ray_differential(self, *arguments: object, **named: object) -> tuple[mi.RayDifferential3f, mi.Spectrum]:
        """As `sample_ray`; no textures are filtered in these scenes, so the differentials are left out."""
        ray, weight = self.sample_ray(*arguments, **named)
        return mi.RayDifferential3f(ray), weight

    def to_string(self) -> str:
        """One line for Mitsuba's log."""
        return f"OrthographicViews[view_count = {self.view_count}, spacing = {self.spacing}]"


#: Within an iteration the same views are set several times.
_camera_frame = functools.lru_cache(maxsize=256)(camera_frame)


mi.register_sensor("orthographic_views", OrthographicViews)
