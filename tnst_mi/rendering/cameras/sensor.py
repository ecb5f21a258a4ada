"""The `orthographic_views` sensor plugin: several centred orthographic views of one grid in one image.

Importing this module registers the plugin for the active variant; `rendering.plugins` does so for every variant.
"""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi

from tnst_mi.rendering.cameras.orthographic import OrthographicRays
from tnst_mi.rendering.cameras.views import View


class OrthographicViews(mi.Sensor):
    r"""
    Stack of orthographic views (:monosp:`orthographic_views`)
    ----------------------------------------------------------

    .. pluginparameters::

     * - view_count
       - |int|
       - Number V of views. The film shows them from top to bottom: its height is V times the height of a view.
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
        self._width, self._height = int(width), int(height) // self.view_count
        self.set_views([(0.0, 0.0)] * self.view_count)

    def set_views(self, views: Sequence[View]) -> None:
        """Set the views to new (azimuth, elevation) angles in degrees, `view_count` of them."""
        if len(views) != self.view_count:
            raise ValueError(f"orthographic_views: {len(views)} views given, expected {self.view_count}")
        self.rays = OrthographicRays(self._width, self._height, self.spacing, self.distance, views)

    def sample_ray(
        self,
        time: mi.Float,
        sample1: mi.Float,
        sample2: mi.Point2f,
        sample3: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        """Ray through a position `sample2` of the film, in [0, 1]²."""
        ray = self.rays.through(sample2, active)
        ray.time = time
        return ray, mi.Spectrum(1)

    def sample_ray_differential(self, *arguments: object, **named: object) -> tuple[mi.RayDifferential3f, mi.Spectrum]:
        """Like `sample_ray`; no textures are filtered in these scenes, so the differentials are omitted."""
        ray, weight = self.sample_ray(*arguments, **named)
        return mi.RayDifferential3f(ray), weight

    def to_string(self) -> str:
        """One line for Mitsuba's log."""
        return f"OrthographicViews[view_count = {self.view_count}, spacing = {self.spacing}]"


mi.register_sensor("orthographic_views", OrthographicViews)
