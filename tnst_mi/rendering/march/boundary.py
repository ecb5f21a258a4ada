"""A medium in a scene: the convex shape around it, and tracing rays to that shape and through it to other surfaces."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.rendering.march.lattice import Lattice
from tnst_mi.rendering.march.medium import GridMedium


class SceneMedium(GridMedium):
    """The one medium of a scene, with the shape that bounds it.

    Attributes:
        shape: the Mitsuba shape that bounds the medium.
        fills_box: the shape is the box of the grid.

    Raises:
        RuntimeError: the scene has no medium, or several, or one that the integrator cannot march through.
    """

    def __init__(self, scene: mi.Scene) -> None:
        found = [shape for shape in scene.shapes() if shape.interior_medium() is not None]
        if len(found) != 1:
            raise RuntimeError(
                f"emission_absorption: the scene has {len(found)} shapes with an interior medium, expected one"
            )
        self.shape = found[0]
        if not mi.has_flag(self.shape.bsdf().flags(), mi.BSDFFlags.Null):
            raise RuntimeError("emission_absorption: the shape around the medium must have a `null` BSDF")
        super().__init__(self.shape.interior_medium())
        self.fills_box = self._is_the_box()

    def _is_the_box(self) -> bool:
        """Whether the shape around the medium is the box of the grid, so that no rays need to be traced to find it."""
        if not isinstance(self.shape, mi.Mesh) or self.shape.face_count() != 12:
            return False
        vertices = np.array(mi.traverse(self.shape)["vertex_positions"], np.float64).reshape(-1, 3)
        local = (vertices - self.transform.centre) @ self.transform.matrix.T + 0.5
        corners = np.round(local)
        on_corners = np.abs(local - corners).max() < 1e-4 and np.isin(corners, (0, 1)).all()
        return bool(on_corners and len(np.unique(corners, axis=0)) == 8)

    def belongs_to(self, scene: mi.Scene) -> bool:
        """Whether this is the medium of `scene`."""
        return any(shape is self.shape for shape in scene.shapes())


def crossing(scene: mi.Scene, shape: mi.Shape, ray: mi.Ray3f, active: mi.Bool) -> tuple[mi.Float, mi.Float]:
    """Distances at which rays enter (0 if they start inside) and leave the convex shape; empty if they miss it."""
    boundary = mi.ShapePtr(shape)

    def body(here: mi.Ray3f, active: mi.Bool, entry: mi.Float, exit: mi.Float) -> tuple:
        hit = scene.ray_intersect(here, active)
        distance = dr.dot(hit.p - ray.o, ray.d)
        on_boundary = active & hit.is_valid() & (hit.shape == boundary)
        entering = dr.dot(hit.n, ray.d) < 0
        entry = dr.select(on_boundary & entering, distance, entry)
        exit = dr.select(on_boundary & ~entering, distance, exit)
        # Other surfaces are skipped; the caller decides whether they are in the way.
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


def seen_behind(
    scene: mi.Scene, medium: SceneMedium, lattice: Lattice, ray: mi.Ray3f, active: mi.Bool
) -> tuple[mi.Spectrum | None, mi.Bool]:
    """Radiance of emitters behind the medium, None if there are none, and which rays pass through the medium.

    Rays that end on a surface in front of the medium lose their samples in the lattice.

    Raises:
        RuntimeError: a surface lies inside the medium.
    """
    through = active & (lattice.exit > lattice.entry)
    alone = len(scene.shapes()) == 1
    if alone and scene.environment() is None:
        return None, through
    surface = dr.zeros(mi.SurfaceInteraction3f, dr.width(ray))
    surface.wi, surface.t = -ray.d, dr.inf
    if not alone:
        surface = first_surface(scene, medium.shape, ray, active)
        distance = dr.select(surface.is_valid(), dr.dot(surface.p - ray.o, ray.d), dr.inf)
        if dr.any(through & (distance > lattice.entry) & (distance < lattice.exit)):
            raise RuntimeError(
                "emission_absorption: a surface lies inside the medium, expected none between entry and exit"
            )
        hidden = distance < lattice.exit
        through &= ~hidden
        lattice.leave_out(hidden)
    background = surface.emitter(scene, active).eval(surface, active) if len(scene.emitters()) > 0 else None
    return background, through
