"""The `emission_absorption` integrator plugin (paper Eq. 11): its properties, and a ray composed of its segments.

Importing this module registers the plugin for the active variant; `rendering.plugins` does so for every variant.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from tnst_mi.choices import QUADRATURES
from tnst_mi.rendering.cameras.perspective import ConvergingRays
from tnst_mi.rendering.cameras.sensor import CameraViews
from tnst_mi.rendering.march.back_projection import RaysTogether
from tnst_mi.rendering.march.behind import NestedIntegrator, emitters_seen
from tnst_mi.rendering.march.coloured import ColouredSegment, ColourGrid
from tnst_mi.rendering.march.lattice import Lattice
from tnst_mi.rendering.march.medium import GridMedium, HomogeneousMedium
from tnst_mi.rendering.march.quadratures import Quadrature, quadrature
from tnst_mi.rendering.march.ray_path import RayEnd, escaped, first_surface, trace
from tnst_mi.rendering.march.scene_media import SceneMedia
from tnst_mi.rendering.march.segments import GridSegment, HomogeneousSegment, Segment


class SensorRays(mi.RayDifferential3f):
    """Rays with what is known of their sensor: Mitsuba passes from `sample_rays` to `sample` the rays alone.

    Attributes:
        medium: the medium in which they start, if the sensor names one.
        axis: of each ray, the direction in which its camera looks; None if the sensor does not tell.
    """

    def __init__(self, rays: mi.RayDifferential3f, medium: mi.Medium | None, axis: mi.Vector3f | None) -> None:
        super().__init__(rays)
        self.medium, self.axis = medium, axis


class EmissionAbsorption(mi.ad.integrators.common.RBIntegrator):
    r"""
    Emission–absorption integrator (:monosp:`emission_absorption`)
    --------------------------------------------------------------

    .. pluginparameters::

     * - gamma
       - |float|
       - Ratio γ > 0 of extinction to emission. The medium carries the extinction σ_t = γ d; it emits σ_t/γ = d.
         (Default: 0.1)
     * - quadrature
       - |string|
       - Discretisation of the integral along a ray, with samples d_k at distance h:
         ``paper``: h Σ d_k exp(−γ h Σ_{i≤k} d_i), the inclusive sum of the authors' program;
         ``exact``: every segment integrated exactly, (1 − exp(−γ h Σ d))/γ;
         ``transmittance``: 1 − exp(−γ h Σ d);
         ``integrated_transmittance``: h Σ_k exp(−γ h Σ_{i≤k} d_i) over all samples inside the grid's box, so that
         empty space is bright and smoke dark. (Default: ``paper``)
     * - step
       - |float|
       - Distance h between samples in world units. (Default: the shortest edge of the grid's cells)

     * - colour
       - |volume|
       - Colour of what the medium emits: a ``gridvolume`` of three channels on the cells of the scene's only
         medium, whose extinction has one channel. Each sample's share of the radiance is multiplied by the colour
         there. (Default: none, white)

     * - (nested)
       - |integrator|
       - Renders the surfaces behind and inside the smoke, and the environment: ``volpath``, ``path``, ``direct``,
         ``prb`` or any other that samples rays, under any name. It decides, too, how light reaches a surface through
         smoke: ``volpath`` attenuates it, for ``path`` the shape around a medium blocks it. (Default: none; only
         emitters can be seen)

    Works in any scene, with any sensor. Rays are traced once: they pass the ``null`` shapes around media, are marched
    through each medium in order, and end at the first other surface, inside a medium or behind all. What is there, or
    the environment where they leave the scene, is attenuated and added. Media emit and absorb; their albedo and phase
    function are ignored. A ray starts in the ``medium`` that its sensor names. Where that names none, it starts in a
    medium if it meets the boundary of one from the inside, or first of all a surface at which it ends and that names
    one on that side, mostly as its ``exterior``. (Mitsuba's path tracers know the sensor's word alone.) Smoke and
    surfaces nearer than ``near_clip`` or beyond ``far_clip`` do not count. (Mitsuba's path tracers forget the far plane
    once a ray has entered a medium.)

    A ``heterogeneous`` medium is sampled at positions that are the same in every view of a grid, with the sensor
    ``camera_views`` in planes across the optical axis: see :py:class:`tnst_mi.rendering.march.lattice.Lattice`. A
    ``homogeneous`` one is integrated exactly, the limit of each quadrature for small steps.

    Derivatives are with respect to the ``sigma_t`` of every medium and to the ``colour``; what lies behind counts as
    constant. Mitsuba keeps ``scale`` as a plain number, without a derivative: multiply ``sigma_t.data`` by a
    differentiable number instead. The reverse-mode pass replays the march. For rays of whole viewpoints it stores the
    adjoint of every sample, and each voxel gathers its own; for others it scatters them and stores nothing per step.
    The derivatives of grids are bit-identical in every run. With one extinction channel the march is scalar, with three
    it is done per channel.

    Errors, of one line each:

    - a medium that is neither ``homogeneous`` nor ``heterogeneous`` with a ``gridvolume`` of filter type ``trilinear``
      as ``sigma_t``; a grid that repeats itself, of wrap mode ``repeat``; no medium at all;
    - a shape around a medium that is an emitter, or has a BSDF other than ``null``, such as a ``mask``, or normals that
      point inwards, as mirroring leaves them (``flip_normals`` turns them);
    - a medium in a shape group;
    - media that overlap; one inside another must name that as its ``exterior``, and the boundaries that rays meet must
      not contradict the medium that their sensor names;
    - without a nested integrator, a surface in sight that is not an emitter.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.gamma = float(props.get("gamma", 0.1))
        self.quadrature = str(props.get("quadrature", "paper"))
        self.step = float(props.get("step", 0.0))
        if not 0 < self.gamma < math.inf:
            raise ValueError(f'emission_absorption: "gamma" is {self.gamma}, expected a number > 0')
        if self.quadrature not in QUADRATURES:
            raise ValueError(
                f'emission_absorption: "quadrature" is {self.quadrature!r}, expected one of {", ".join(QUADRATURES)}'
            )
        if "step" in props and not 0 < self.step < math.inf:
            raise ValueError(f'emission_absorption: "step" is {self.step}, expected a length > 0')
        self._colour = ColourGrid(props["colour"]) if "colour" in props else None
        nested = [NestedIntegrator(value) for name, value in props.objects() if name != "colour"]
        if len(nested) > 1:
            raise ValueError(f"emission_absorption: {len(nested)} nested integrators, expected one at most")
        self._nested = nested[0] if nested else None
        self._media: SceneMedia | None = None

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """Show the colour's parameters."""
        if self._colour is not None:
            callback.put("colour", self._colour.volume, mi.ParamFlags.Differentiable)

    def parameters_changed(self, keys: list[str]) -> None:
        """Discard what was resolved from the scene."""
        self._media = None

    def resolve(self, scene: mi.Scene, named: mi.Medium | None = None) -> SceneMedia:
        """The scene's media and the one that a sensor names, with their current extinctions."""
        if self._media is None or not self._media.belongs_to(scene, named):
            self._media = SceneMedia(scene, named)
        else:
            self._media.refresh()
        if self._colour is not None:
            self._colour.give_to(self._media)
        return self._media

    def sample_rays(
        self, scene: mi.Scene, sensor: mi.Sensor, sampler: mi.Sampler
    ) -> tuple[mi.RayDifferential3f, mi.Spectrum, mi.Vector2f]:
        """Rays of the sensor, with what is known of it; their weights and positions. See `RBIntegrator`."""
        rays, weight, position = super().sample_rays(scene, sensor, sampler)
        axis = None
        # By its name: its class is another one for every time that a variant became active.
        if type(sensor).__name__ == CameraViews.__name__:
            film = sensor.film()
            # Of the pixel's middle, which is in the image of the same viewpoint.
            middle = dr.floor(position) - mi.Vector2f(film.crop_offset()) + 0.5
            axis = sensor.axis(mi.Point2f(middle / mi.Vector2f(film.crop_size())))
        return SensorRays(rays, sensor.get_medium(), axis), weight, position

    def sample(
        self,
        mode: dr.ADMode,
        scene: mi.Scene | GridMedium,
        sampler: mi.Sampler | None,
        ray: mi.Ray3f,
        δL: mi.Spectrum | None,
        state_in: Any,
        active: mi.Bool,
        together: RaysTogether | None = None,
        **kwargs: Any,  # Absorbs unused arguments
    ) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float], Any]:
        """Radiance along rays (primal), its tangent (forward), or its adjoint (backward); see `RBIntegrator`.

        A `GridMedium` instead of a scene is marched alone, in front of black: no rays are traced, and on a GPU no OptiX
        is needed. What the rays of whole viewpoints have `together` makes the adjoint faster, and aligns the samples
        of a camera.
        """
        if isinstance(scene, mi.Scene):
            named, axis = (ray.medium, ray.axis) if isinstance(ray, SensorRays) else (None, None)
            media = self.resolve(scene, named)
            segments, end = self._segments(scene, media, ray, axis, named, active)
            behind, on_surface = self._behind(scene, media, sampler, ray, end, active), end.surface.is_valid()
        else:
            axis = together.axis if isinstance(together, ConvergingRays) else None
            lattice = Lattice(scene, ray, self._sample_distance(scene), axis=axis)
            segments, behind, on_surface = [self._grid_segment(scene, lattice)], None, False
        if mode == dr.ADMode.Primal:
            L = self._radiance(segments, behind)
        elif mode == dr.ADMode.Backward:
            L = state_in
            self._scatter_adjoint(segments, behind, L, δL, together)
        else:
            L = self._tangent(segments, behind)
        valid = active & (functools.reduce(operator.or_, [segment.crossed for segment in segments], on_surface))
        return mi.Spectrum(L), valid, [], L

    # --------------------------------------------------------------------
    # Where a ray passes through media, and what is behind them
    # --------------------------------------------------------------------

    def _sample_distance(self, medium: GridMedium) -> float:
        return self.step if self.step > 0 else float(medium.transform.voxel_edges(medium.grid_shape).min())

    def _segments(
        self,
        scene: mi.Scene,
        media: SceneMedia,
        ray: mi.Ray3f,
        axis: mi.Vector3f | None,
        named: mi.Medium | None,
        active: mi.Bool,
    ) -> tuple[Sequence[Segment], RayEnd]:
        """The segments of the rays in media, nearest first, and the ends of the rays."""
        box = media.box if named is None or (media.box is not None and media.box.medium is named) else None
        if box is not None and (media.only_boundaries or self._nested is None):
            end = escaped(ray) if media.only_boundaries else first_surface(scene, ray, active)
            lattice = Lattice(box, ray, self._sample_distance(box), (mi.Float(0), end.distance), axis)
            return [self._grid_segment(box, lattice)], end
        stretches, end = trace(scene, ray, active, named)
        return [
            self._segment(medium, ray, axis, *bounds)
            for stretch in stretches
            for medium in media.media
            if (bounds := stretch.inside(medium.medium)) is not None
        ], end

    def _segment(
        self,
        medium: GridMedium | HomogeneousMedium,
        ray: mi.Ray3f,
        axis: mi.Vector3f | None,
        entry: mi.Float,
        exit: mi.Float,
    ) -> Segment:
        if isinstance(medium, HomogeneousMedium):
            return HomogeneousSegment(medium, entry, exit, self._quadrature)
        lattice = Lattice(medium, ray, self._sample_distance(medium), (entry, exit), axis)
        return self._grid_segment(medium, lattice)

    def _grid_segment(self, medium: GridMedium, lattice: Lattice) -> GridSegment:
        return (GridSegment if medium.colour is None else ColouredSegment)(medium, lattice, self._quadrature)

    def _behind(
        self,
        scene: mi.Scene,
        media: SceneMedia,
        sampler: mi.Sampler | None,
        ray: mi.Ray3f,
        end: RayEnd,
        active: mi.Bool,
    ) -> mi.Spectrum | None:
        """Radiance at the ends of the rays, None if there is none."""
        if media.only_boundaries and scene.environment() is None:
            return None
        if self._nested is None:
            return emitters_seen(scene, end, active)
        return self._nested.radiance(scene, sampler, ray, end, [medium.medium for medium in media.media], active)

    # --------------------------------------------------------------------
    # The march, composed of segments
    # --------------------------------------------------------------------

    def _radiance(self, segments: Sequence[Segment], behind: mi.Spectrum | None) -> Any:
        L = behind
        for segment in reversed(segments):
            L = segment.in_front_of(L)
        return 0 if L is None else L

    def _scatter_adjoint(
        self,
        segments: Sequence[Segment],
        behind: mi.Spectrum | None,
        L: Any,
        δL: mi.Spectrum,
        together: RaysTogether | None,
    ) -> None:
        """Accumulate δL · ∂L/∂p into the gradients of all media's parameters p."""
        if len(segments) == 1:
            segments[0].scatter_adjoint(L, δL, behind, together)
            return
        # What each segment and everything behind it show, and its transmittance: from the back to the front.
        shown, transmittances = [behind], []
        for segment in reversed(segments):
            L, T = segment.radiance()
            shown.append(mi.Spectrum(L) if shown[-1] is None else mi.Spectrum(L) + T * shown[-1])
            transmittances.append(T)
        dr.eval(shown, transmittances)
        for i, segment in enumerate(segments):
            segment.scatter_adjoint(shown[-1 - i], δL, shown[-2 - i], together)
            δL = δL * transmittances[-1 - i]

    def _tangent(self, segments: Sequence[Segment], behind: mi.Spectrum | None) -> Any:
        """Derivative of the radiance along the tangents of the media's parameters."""
        L_dot = None
        for i, segment in enumerate(reversed(segments)):
            if i > 0:
                behind = mi.Spectrum(segments[-i].in_front_of(behind))
            own, T, T_dot = segment.tangent()
            if behind is not None:
                own = mi.Spectrum(own) + T_dot * behind
            L_dot = own if L_dot is None else mi.Spectrum(own) + T * L_dot
        return 0 if L_dot is None else L_dot

    @property
    def _quadrature(self) -> Quadrature:
        return quadrature(self.quadrature, self.gamma)

    def to_string(self) -> str:
        """One line for Mitsuba's log."""
        step = self.step if self.step > 0 else "voxel"
        return f"EmissionAbsorption[gamma = {self.gamma}, quadrature = {self.quadrature}, step = {step}]"


mi.register_integrator("emission_absorption", EmissionAbsorption)
