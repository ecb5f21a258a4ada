"""Tracing rays to the convex shape around a medium, and through it to the other surfaces of a scene."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def crossing(scene: mi.Scene, shape: mi.Shape, ray: mi.Ray3f, active: mi.Bool) -> tuple[mi.Float, mi.Float]:
    """Distances at which rays enter (0: they start inside) and leave the convex shape; empty where they miss it."""
    boundary = mi.ShapePtr(shape)

    def body(here: mi.Ray3f, active: mi.Bool, entry: mi.Float, exit: mi.Float) -> tuple:
        hit = scene.ray_intersect(here, active)
        distance = dr.dot(hit.p - ray.o, ray.d)
        on_boundary = active & hit.is_valid() & (hit.shape == boundary)
        entering = dr.dot(hit.n, ray.d) < 0
        entry = dr.select(on_boundary & entering, distance, entry)
        exit = dr.select(on_boundary & ~entering, distance, exit)
        # Other surfaces are passed; the caller decides whether they are in the way.
        return hit.spawn_ray(ray.d), active & hit.is_valid() & ~(on_boundary & ~entering), entry, exit

    n = dr.width(ray)
    state = (
        mi.Ray3f(ray),
        mi.Bool(active) & dr.full(mi.Bool, True, n),
        dr.zeros(mi.Float, n),
        dr.full(mi.Float, -dr.inf, n),
    )
    _, _, entry, exit = dr.while_loop(state, lambda here, active, *_: active, body, label="medium boundary")
    return entry, exit


def first_surface(scene: mi.Scene, shape: mi.Shape, ray: mi.Ray3f, active: mi.Bool) -> mi.SurfaceInteraction3f:
    """The first surface on the rays that is not the shape around the medium."""
    boundary = mi.ShapePtr(shape)

    def body(here: mi.Ray3f, active: mi.Bool, seen: mi.SurfaceInteraction3f) -> tuple:
        hit = scene.ray_intersect(here, active)
        passed = active & hit.is_valid() & (hit.shape == boundary)
        return hit.spawn_ray(ray.d), passed, dr.select(active & ~passed, hit, seen)

    n = dr.width(ray)
    state = (mi.Ray3f(ray), mi.Bool(active) & dr.full(mi.Bool, True, n), dr.zeros(mi.SurfaceInteraction3f, n))
    return dr.while_loop(state, lambda here, active, *_: active, body, label="first surface")[2]
