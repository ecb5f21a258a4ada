"""What rays see at their ends, behind all smoke: emitters, or whatever another integrator finds there."""

from __future__ import annotations

from collections.abc import Iterable

import drjit as dr
import mitsuba as mi

from tnst_mi.rendering.march.ray_path import RayEnd


def emitters_seen(scene: mi.Scene, end: RayEnd, active: mi.Bool) -> mi.Spectrum | None:
    """Radiance of the emitters at the ends of the rays, None if the scene has none.

    Raises:
        RuntimeError: a ray ends on a surface that is not an emitter.
    """
    emitter = end.surface.emitter(scene, active)
    if dr.any(active & end.surface.is_valid() & (emitter == dr.zeros(mi.EmitterPtr))):
        raise RuntimeError(
            "emission_absorption: a surface is seen that is not an emitter: give the integrator a nested one that "
            'renders it, such as {"type": "emission_absorption", "behind": {"type": "volpath"}}'
        )
    return emitter.eval(end.surface, active) if len(scene.emitters()) > 0 else None


class NestedIntegrator:
    """A Mitsuba integrator that says what is seen where rays end.

    Args:
        integrator: any that samples radiance along rays.

    Raises:
        ValueError: it does not.
    """

    def __init__(self, integrator: mi.Object) -> None:
        if not isinstance(integrator, mi.SamplingIntegrator):
            raise ValueError(
                "emission_absorption: the nested integrator cannot sample single rays, expected one that can, such as "
                "volpath, path or direct"
            )
        self._integrator = integrator

    def radiance(
        self,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.Ray3f,
        end: RayEnd,
        media: Iterable[mi.Medium],
        active: mi.Bool,
    ) -> mi.Spectrum:
        """Radiance at the ends of the rays, without derivatives.

        The nested integrator gets rays that start just in front of the surface, and the medium there. A ray that ends
        on no surface gets one that meets nothing: it shows the environment.
        """
        on_surface = end.surface.is_valid()
        nested = mi.RayDifferential3f(ray)
        nested.o = dr.select(on_surface, end.surface.spawn_ray(-ray.d).o, ray.o)
        nested.maxt = dr.select(on_surface, dr.inf, 0)
        L = mi.Spectrum(0)
        with dr.suspend_grad():
            if isinstance(self._integrator, mi.CppADIntegrator):
                # Integrators written in Python; they start outside of any medium.
                arguments = {"depth": mi.UInt32(0), "δL": None, "δaovs": None, "state_in": None}
                mode = dr.ADMode.Primal
                L = self._integrator.sample(
                    mode=mode, scene=scene, sampler=sampler, ray=nested, active=active, **arguments
                )
                return mi.Spectrum(L[0])
            nothing = dr.zeros(mi.MediumPtr)
            for medium in (None, *media):
                here = active & (end.medium == (nothing if medium is None else mi.MediumPtr(medium)))
                if medium is None or dr.any(here):
                    L = dr.select(here, self._integrator.sample(scene, sampler, nested, medium, here)[0], L)
        return L
