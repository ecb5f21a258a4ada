"""Light that a burning volume sends out, as the smoke around it scatters and absorbs it.

Media of Mitsuba 3.9 do not emit. Light adds up, though: the picture of burning smoke under lights is that of the smoke
under the lights, which Mitsuba traces, plus that of the same smoke in the light of the fire alone, traced here.

Paths begin at the camera. Delta tracking proposes collisions at the rate σ̄, the majorant of the extinction; the share
σ_t / σ̄ of them is real. For the emission j per length, each proposed collision at x adds j(x) / σ̄. Along a flight
through transmittance T this has the expectation ∫ T j ds, also where there is fire and no smoke: the collision
estimator (Novák et al. 2018, "Monte Carlo methods for volumetric light transport simulation", section 5).
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

#: As in `scenes/looks/studio.xml`.
MAX_DEPTH, RR_DEPTH = 128, 6


class FireLight:
    """A box of emission in a scene with media.

    Args:
        low: the lowest corner of the box (x, y, z) in the world.
        high: the highest.
    """

    def __init__(self, low: Sequence[float], high: Sequence[float]) -> None:
        edges = (np.asarray(high) - np.asarray(low)).tolist()
        placed = mi.ScalarTransform4f().translate(list(low)) @ mi.ScalarTransform4f().scale(edges)
        grid = mi.VolumeGrid(np.zeros((2, 2, 2, 3), np.float32))
        self._emission = mi.load_dict(
            {"type": "gridvolume", "grid": grid, "to_world": placed, "raw": True, "accel": False}
        )
        self._parameters = mi.traverse(self._emission)
        self._sampler = mi.load_dict({"type": "independent"})

    def set(self, emission: np.ndarray) -> None:
        """Set the emission (D, H, W, 3), linear RGB radiance per length in the world, of cells that fill the box."""
        self._parameters["data"] = mi.TensorXf(np.ascontiguousarray(emission, np.float32))
        self._parameters.update()

    def render(self, scene: mi.Scene, sensor: mi.Sensor, seed: int) -> mi.TensorXf:
        """One path per pixel of a camera outside of media: the fire's light alone, linear radiance (height, width, 3).

        Pixels are box filtered and share no paths: the same seed gives the same bits.
        """
        width, height = sensor.film().crop_size()
        pixel = dr.arange(mi.UInt32, width * height)
        self._sampler.seed(seed, width * height)
        corner = mi.Point2f(pixel % width, pixel // width)
        place = (corner + self._sampler.next_2d()) / mi.Point2f(width, height)
        ray, weight = sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
        light = weight * _light_along(scene, self._emission, self._sampler, ray)
        return mi.TensorXf(dr.ravel(mi.Color3f(light)), (height, width, 3))


@dr.syntax
def _light_along(scene: mi.Scene, emission: mi.Volume, sampler: mi.Sampler, ray: mi.Ray3f) -> mi.Color3f:
    """The emission that one random path collects along each ray, whose origins are outside of media."""
    ray = mi.Ray3f(ray)
    light, throughput = mi.Color3f(0.0), mi.Color3f(1.0)
    depth = mi.UInt32(0)
    medium = dr.zeros(mi.MediumPtr)
    surface = dr.zeros(mi.SurfaceInteraction3f)
    flies_on = mi.Bool(False)  # in the direction in which `surface` was found
    active = mi.Bool(True)
    while active:
        # Russian roulette, as Mitsuba's path tracers play it.
        survival = dr.minimum(dr.max(throughput), 0.99)
        plays = depth > RR_DEPTH
        active &= ~plays | (sampler.next_1d(active) < survival)
        throughput[plays] = throughput / survival

        surface[active & ~flies_on] = scene.ray_intersect(ray, active & ~flies_on)
        inside = active & (medium != None)  # noqa: E711 (an array of pointers)
        collision = medium.sample_interaction(ray, sampler.next_1d(inside), 0, inside)
        collides = inside & collision.is_valid() & (collision.t < surface.t)

        majorant = collision.combined_extinction[0]
        emitted = emission.eval_3(collision, collides)
        light[collides] += throughput * mi.Color3f(emitted) / majorant

        scatters = collides & (sampler.next_1d(collides) * majorant < collision.sigma_t[0])
        # A null collision: the path flies on from it.
        flies_on = collides & ~scatters
        ray.o[flies_on] = collision.p
        surface.t[flies_on] = surface.t - collision.t
        context = mi.PhaseFunctionContext(sampler)
        phase = medium.phase_function()
        direction, weight, _ = phase.sample(
            context, collision, sampler.next_1d(scatters), sampler.next_2d(scatters), scatters
        )
        throughput[scatters] *= weight * collision.sigma_s / collision.sigma_t
        ray[scatters] = collision.spawn_ray(direction)

        meets = active & ~collides & surface.is_valid()
        bsdf = surface.bsdf(ray)
        sampled, reflected = bsdf.sample(
            mi.BSDFContext(), surface, sampler.next_1d(meets), sampler.next_2d(meets), meets
        )
        meets &= sampled.pdf > 0.0
        throughput[meets] *= reflected
        ray[meets] = surface.spawn_ray(surface.to_world(sampled.wo))
        crosses = meets & surface.is_medium_transition()
        medium[crosses] = surface.target_medium(ray.d)

        turns = scatters | (meets & ~mi.has_flag(sampled.sampled_type, mi.BSDFFlags.Null))
        depth[turns] += 1
        active &= (collides | meets) & (depth < MAX_DEPTH) & dr.any(throughput != 0.0)
    return light
