"""Tracing rays through a scene: the parts of them that lie in media, and the surface at which they end."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


@dataclass(frozen=True)
class Stretch:
    """A part of every ray between two boundaries.

    Attributes:
        medium: the medium there, null for rays that have no such part.
        entry, exit: distances along the rays at which it begins and ends.
    """

    medium: mi.MediumPtr
    entry: mi.Float
    exit: mi.Float

    def inside(self, medium: mi.Medium) -> tuple[mi.Float, mi.Float] | None:
        """Entry and exit of the stretches that lie in `medium`, empty for other rays; None if there are none."""
        here = (self.medium == mi.MediumPtr(medium)) & (self.exit > self.entry)
        if not dr.any(here):
            return None
        return dr.select(here, self.entry, dr.inf), dr.select(here, self.exit, -dr.inf)


@dataclass(frozen=True)
class RayEnd:
    """Where rays end.

    Attributes:
        surface: the first surface that rays do not pass through; invalid for rays that leave the scene or reach
            their `maxt` before.
        distance: to that surface, or the ray's `maxt`.
        medium: the medium just in front of the surface, null if there is none.
    """

    surface: mi.SurfaceInteraction3f
    distance: mi.Float
    medium: mi.MediumPtr


def passes_straight(bsdf: mi.BSDF | mi.BSDFPtr) -> bool | mi.Bool:
    """Whether rays pass straight through surfaces of the BSDF: it is `null`, and nothing else in part."""
    return (bsdf.flags() & int(mi.BSDFFlags.All)) == int(mi.BSDFFlags.Null)


def _nothing_hit(ray: mi.Ray3f) -> mi.SurfaceInteraction3f:
    """The interaction of rays that leave the scene, as the environment expects it."""
    surface = dr.zeros(mi.SurfaceInteraction3f, dr.width(ray))
    surface.wi, surface.t = -ray.d, dr.inf
    return surface


def escaped(ray: mi.Ray3f) -> RayEnd:
    """The end of rays that meet no surface at all."""
    return RayEnd(_nothing_hit(ray), ray.maxt, dr.zeros(mi.MediumPtr, dr.width(ray)))


def first_surface(scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool) -> RayEnd:
    """The end of rays whose medium there does not matter: it is left null."""

    def body(here: mi.Ray3f, active: mi.Bool, seen: mi.SurfaceInteraction3f, end: mi.Float) -> tuple:
        hit = scene.ray_intersect(here, active)
        distance = dr.dot(hit.p - ray.o, ray.d)
        passed = active & hit.is_valid() & passes_straight(hit.bsdf())
        stopped = active & hit.is_valid() & ~passed
        here = hit.spawn_ray(ray.d)
        here.maxt = ray.maxt - distance
        return here, passed, dr.select(stopped, hit, seen), dr.select(stopped, distance, end)

    n = dr.width(ray)
    state = (mi.Ray3f(ray), mi.Bool(active) & dr.full(mi.Bool, True, n), _nothing_hit(ray), mi.Float(ray.maxt))
    result = dr.while_loop(state, lambda here, active, *_: active, body, label="first surface")
    return RayEnd(result[2], result[3], dr.zeros(mi.MediumPtr, n))


def trace(scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool, named: mi.Medium | None) -> tuple[list[Stretch], RayEnd]:
    """The stretches of rays in media, nearest first, and where the rays end.

    A boundary says what is on its near side and what on its far side. The far side of one and the near side of the next
    describe the same stretch; before the first boundary, the sensor and the near side tell what the ray starts in.
    Where two boundaries touch, a ray meets only one of them, so that one of the two descriptions may be missing.

    The surface at which a ray ends says what is on its near side, too, if it names media. That counts where nothing
    else tells, and is no contradiction otherwise: the surface may touch a boundary, and hide it. One in a shape group
    tells nothing, since its media may not be among those of the scene.

    Args:
        scene: what the rays are traced through.
        ray, active: the rays, and which of them to trace.
        named: the medium in which their sensor says that they start, if it names one.

    Raises:
        RuntimeError: two descriptions contradict each other: media overlap. Or a ray meets an instance of a medium.
    """
    n = dr.width(ray)
    nothing = dr.zeros(mi.MediumPtr, n)
    here, active = mi.Ray3f(ray), mi.Bool(active) & dr.full(mi.Bool, True, n)
    # Boundaries beyond the far end, too, tell what a ray starts in.
    here.maxt = dr.full(mi.Float, dr.inf, n)
    medium = nothing if named is None else dr.select(active, mi.MediumPtr(named), nothing)
    # `lost` is the medium that a ray was in when it met a boundary whose near side did not name it. If the ray meets
    # that medium's own end later on, it was in both.
    lost = dr.zeros(mi.MediumPtr, n)
    # Where the stretch at hand begins, where the ray ends, and whether it is known what the ray started in.
    start, end = dr.zeros(mi.Float, n), mi.Float(ray.maxt) + dr.zeros(mi.Float, n)
    known = dr.full(mi.Bool, named is not None, n)
    overlap, instanced = dr.zeros(mi.Bool, n), dr.zeros(mi.Bool, n)
    surface, at_surface = _nothing_hit(ray), dr.zeros(mi.MediumPtr, n)
    stretches = []
    state = (here, active, medium, lost, start, end, known, overlap, instanced, surface, at_surface)
    # Not part of the generated code, so that every crossing runs the same kernel.
    dr.make_opaque(state)
    while dr.any(active):
        hit = scene.ray_intersect(here, active)
        met = active & hit.is_valid()
        distance = dr.select(met, dr.dot(hit.p - ray.o, ray.d), dr.inf)
        passes = passes_straight(hit.bsdf())
        boundary = met & passes & hit.is_medium_transition()
        stops = met & ~passes & (distance < end)
        in_instance = hit.instance != dr.zeros(mi.ShapePtr)
        tells = boundary | (stops & hit.is_medium_transition() & ~in_instance)
        surface, end = dr.select(stops, hit, surface), dr.select(stops, distance, end)

        near, far = (dr.select(tells, hit.target_medium(side), nothing) for side in (-ray.d, ray.d))
        in_medium = medium != nothing
        differs = dr.select(in_medium, boundary & (near != medium), near == lost)
        overlap |= tells & (start < end) & (near != nothing) & differs
        if named is not None and named.is_homogeneous():
            # Rays that start in the medium meet its boundary from outside. (A grid is empty beyond its box anyway.)
            overlap |= boundary & (start == 0) & in_medium & (near == nothing) & (far == medium)
        instanced |= boundary & in_instance
        lost = dr.select(boundary & in_medium & (near == nothing), medium, lost)
        medium = dr.select(in_medium, medium, near)

        done = active & (~met | ((distance >= end) & (known | tells)))
        closed = boundary | done
        stretches.append(Stretch(dr.select(closed, medium, nothing), start, dr.minimum(distance, end)))
        at_surface = dr.select(done & surface.is_valid() & (start < end), medium, at_surface)

        medium = dr.select(boundary, far, medium)
        start, known = dr.select(boundary, distance, start), known | boundary
        here, active = hit.spawn_ray(ray.d), active & ~done
        dr.eval(here, active, medium, lost, start, end, known, overlap, instanced, surface, at_surface, stretches[-1])
    if dr.any(overlap):
        raise RuntimeError(
            "emission_absorption: media overlap: a shape inside a medium must name that medium as its `exterior`, "
            "and a sensor no other medium than the one it is in"
        )
    if dr.any(instanced):
        raise RuntimeError("emission_absorption: a medium is in a shape group, expected none in instances")
    return stretches, RayEnd(surface, end, at_surface)
