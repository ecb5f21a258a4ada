"""The `camera_views` sensor plugin: several viewpoints of one grid in one image; `orthographic_views` is its old name.

Importing this module registers the plugin for the active variant; `rendering.plugins` does so for every variant.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from tnst_mi.rendering.cameras.camera import Viewpoint
from tnst_mi.rendering.cameras.perspective import ViewpointRays, rays_of


class CameraViews(mi.Sensor):
    r"""
    Stack of viewpoints (:monosp:`camera_views`)
    --------------------------------------------

    .. pluginparameters::

     * - view_count
       - |int|
       - Number V of views. The film shows them from top to bottom: its height is V times the height of a view.
         (Default: 1)
     * - spacing
       - |float|
       - Distance between pixels of views in world units, in the plane through the centre. (Default: 1)
     * - distance
       - |float|
       - Distance from the centre at which rays start, in world units, unless they start at an eye nearer than that; it
         must lie outside the scene. (Default: 1000)
     * - through_centres
       - |bool|
       - Whether rays go through the centres of pixels, whatever the sampler says: images of path tracers are then
         of the same rays as ours, instead of averages over the areas of pixels. (Default: |false|)

    Views look at the origin, which is the centre of their images; :py:class:`tnst_mi.Camera` may be anywhere. Rendering
    them in one launch costs one kernel instead of V, and moving them needs no new kernel, but for a second one when not
    all are centred orthographic views any more. At first, all look along -z.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.view_count = int(props.get("view_count", 1))
        self.spacing = float(props.get("spacing", 1.0))
        self.distance = float(props.get("distance", 1000.0))
        self.through_centres = bool(props.get("through_centres", False))
        #: By how much all rays are displaced, in world units; None: not at all.
        self.displacement: mi.Vector3f | None = None
        width, height = self.film().size()
        if self.view_count < 1 or height % self.view_count:
            raise ValueError(
                f'camera_views: a film of height {height} cannot show "view_count" = {self.view_count} views'
            )
        self._width, self._height = int(width), int(height) // self.view_count
        self.set_views([(0.0, 0.0)] * self.view_count)

    def set_views(self, views: Sequence[Viewpoint]) -> None:
        """Set new views, in degrees and with or without a distance, or cameras, `view_count` of them."""
        if len(views) != self.view_count:
            raise ValueError(f"camera_views: {len(views)} views given, expected {self.view_count}")
        self.rays = rays_of(views, self._width, self._height, self.spacing, self.distance)

    def sample_ray(
        self,
        time: mi.Float,
        sample1: mi.Float,
        sample2: mi.Point2f,
        sample3: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        """Ray through a position `sample2` of the film, in [0, 1]², and its weight; `sample1` chooses wavelengths."""
        if self.through_centres:
            size = mi.Vector2f(self._width, self._height * self.view_count)
            sample2 = mi.Point2f((dr.floor(sample2 * size) + 0.5) / size)
        ray = self.rays.through(sample2, active)
        if self.displacement is not None:
            ray.o += self.displacement
        ray.time = time
        if not mi.is_spectral:
            return ray, mi.Spectrum(1)
        ray.wavelengths, weight = self.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), sample1, active)
        return ray, weight

    def axis(self, position: mi.Point2f) -> mi.Vector3f | None:
        """Where the cameras of the rays through such positions look; None if all are centred orthographic views."""
        return self.rays.axis(position) if isinstance(self.rays, ViewpointRays) else None

    def sample_ray_differential(self, *arguments: object, **named: object) -> tuple[mi.RayDifferential3f, mi.Spectrum]:
        """Like `sample_ray`; no textures are filtered in these scenes, so the differentials are omitted."""
        ray, weight = self.sample_ray(*arguments, **named)
        return mi.RayDifferential3f(ray), weight

    def to_string(self) -> str:
        """One line for Mitsuba's log."""
        return f"CameraViews[view_count = {self.view_count}, spacing = {self.spacing}]"


for _name in ("camera_views", "orthographic_views"):
    mi.register_sensor(_name, CameraViews)
