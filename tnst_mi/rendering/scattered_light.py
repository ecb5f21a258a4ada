"""The `scattered_light` integrator plugin: light that smoke in a grid scatters, with little noise in its derivative.

Importing this module registers the plugin for the active variant; `rendering.plugins` does so for every variant.

Paths are those of Mitsuba's `prbvolpath`: delta tracking with emitter sampling, differentiated by path replay (Vicini,
Speierer, Jakob, "Path replay backpropagation", SIGGRAPH 2021). One thing differs. Delta tracking proposes collisions at
the rate μ, the majorant, of which the share σ_t/μ is real. The derivative with respect to σ_t is what is scattered at
the real ones over σ_t: huge and rare in thin smoke, which makes nearly all of its variance. Here at least the share
`floor` is real wherever there is smoke; weights make up for it, so that the mean is the same.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

_common = mi.ad.integrators.common

#: With a floor, collisions in smoke with a smaller share than this are never real: what a path has yet to find is known
#: up to its rounding, which the derivative divides by the extinction.
_LEAST_SHARE = 1e-5


class ScatteredLight(_common.RBIntegrator):
    r"""
    Scattered light (:monosp:`scattered_light`)
    -------------------------------------------

    .. pluginparameters::

     * - max_depth, rr_depth
       - |int|
       - As of `prbvolpath`. (Default: 6 and 5)
     * - floor
       - |float|
       - Least probability, below 1, with which a proposed collision is a real one where the extinction is not 0. Much
         more than 1/(μ s), on lengths s through thin smoke, adds noise instead. (Default: 0, delta tracking)
     * - first_order
       - |int|
       - Light that was scattered less often than this is left out. (Default: 1)

    The scene has one shape, the box of its medium, and emitters that belong to none. The medium's extinction is grey.
    Derivatives are those with respect to the extinction and the albedo.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.floor = float(props.get("floor", 0.0))
        self.first_order = int(props.get("first_order", 1))

    @dr.syntax
    def sample(
        self,
        mode: dr.ADMode,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.Ray3f,
        δL: mi.Spectrum | None,
        state_in: mi.Spectrum | None,
        active: mi.Bool,
        **_: object,
    ) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float], mi.Spectrum]:
        """See `RBIntegrator`: the scattered radiance, or its derivative, along rays from outside of the smoke."""
        if dr.hint(mode == dr.ADMode.Forward, mode="scalar"):
            raise RuntimeError("scattered_light: there are no forward-mode derivatives")
        adjoint = mode == dr.ADMode.Backward
        least_share = _LEAST_SHARE if self.floor else 0.0
        medium = scene.shapes()[0].interior_medium()
        phase, context = medium.phase_function(), mi.PhaseFunctionContext(sampler)

        ray, active = mi.Ray3f(ray), mi.Bool(active)
        # What a replayed path has yet to find.
        L = mi.Spectrum(state_in if adjoint else 0)
        δL = mi.Spectrum(δL if adjoint else 0)
        throughput, order = mi.Float(1), mi.UInt32(0)
        # What the throughput would be without a floor. Were paths ended for being faint after a collision in thin
        # smoke, the few that survive would have a derivative there as large as they are rare.
        unforced = mi.Float(1)
        last, last_pdf = dr.zeros(mi.Interaction3f), mi.Float(1)

        while active:
            survival = dr.select(order > self.rr_depth, dr.minimum(unforced, 0.99), 1)
            active &= sampler.next_1d(active) < survival
            throughput *= dr.rcp(survival)
            unforced *= dr.rcp(survival)

            with dr.resume_grad(when=adjoint):
                event = medium.sample_interaction(ray, sampler.next_1d(active), 0, active)
                event.t = dr.detach(event.t)
                collides = active & event.is_valid()
                majorant = dr.detach(event.combined_extinction.x)
                share = dr.detach(event.sigma_t.x) / majorant
                probability = dr.select(share > least_share, dr.maximum(share, self.floor), 0)
                scatters = collides & (sampler.next_1d(active) < probability)
                weight = (
                    dr.select(scatters, event.sigma_s.x / probability, event.sigma_n.x / (1 - probability)) / majorant
                )
                weight = dr.select(collides, weight, 1)
                if dr.hint(adjoint, mode="scalar"):
                    dr.backward(δL * weight * dr.select(collides, L / dr.maximum(dr.detach(weight), 1e-8), 0))
            event, weight = dr.detach(event), dr.detach(weight)
            throughput *= weight
            escapes = active & ~collides & (order >= self.first_order)
            order[scatters] += 1
            unforced[scatters] *= event.sigma_s.x / event.sigma_t.x
            active &= collides & (order < self.max_depth) & (throughput > 0)
            scatters &= active

            # Light that a scattered ray runs into.
            sky = dr.zeros(mi.SurfaceInteraction3f, dr.width(ray.o))
            sky.wi = -ray.d
            found = mi.DirectionSample3f(scene, sky, last)
            light_pdf = scene.pdf_emitter_direction(last, found, escapes)
            met = throughput * _common.mis_weight(last_pdf, light_pdf) * sky.emitter(scene).eval(sky, escapes)
            L[escapes] += -met if adjoint else met

            # Light that is looked for.
            light, emitted = scene.sample_emitter_direction(event, sampler.next_2d(scatters), False, scatters)
            value, phase_pdf = phase.eval_pdf(context, event, light.d, scatters)
            lit = scatters & (light.pdf > 0) & (order >= self.first_order)
            shadow, replayed = mi.Ray3f(event.p, light.d), sampler.clone()
            shadow.maxt = light.dist
            visible = self._transmittance(medium, shadow, sampler, lit)
            weight = throughput * value * _common.mis_weight(light.pdf, dr.select(light.delta, 0, phase_pdf))
            direct = weight * visible * emitted
            L[lit] += -direct if adjoint else direct
            if dr.hint(adjoint, mode="scalar"):
                self._transmittance_adjoint(medium, shadow, replayed, lit, δL * direct)

            direction, phase_weight, phase_pdf = phase.sample(
                context, event, sampler.next_1d(scatters), sampler.next_2d(scatters), scatters
            )
            throughput[scatters] *= phase_weight.x
            last[scatters], last_pdf[scatters] = event, phase_pdf
            ray.o[collides] = event.p
            ray.d[scatters] = direction

        return δL if adjoint else L, order > 0, [], L

    @dr.syntax
    def _transmittance(self, medium: mi.Medium, ray: mi.Ray3f, sampler: mi.Sampler, active: mi.Bool) -> mi.Float:
        """An estimate of the transmittance along rays, by ratio tracking."""
        ray, active, T = mi.Ray3f(ray), mi.Bool(active), mi.Float(1)
        while active:
            event = medium.sample_interaction(ray, sampler.next_1d(active), 0, active)
            active &= event.is_valid()
            T[active] *= event.sigma_n.x / event.combined_extinction.x
            ray.o[active] = event.p
            ray.maxt[active] = ray.maxt - event.t
        return T

    @dr.syntax
    def _transmittance_adjoint(
        self, medium: mi.Medium, ray: mi.Ray3f, sampler: mi.Sampler, active: mi.Bool, gradient: mi.Spectrum
    ) -> None:
        """Accumulate the gradient with respect to the logarithm of that estimate, from the same random numbers."""
        ray, active = mi.Ray3f(ray), mi.Bool(active)
        while active:
            with dr.resume_grad():
                event = medium.sample_interaction(ray, sampler.next_1d(active), 0, active)
                active &= event.is_valid()
                null = event.sigma_n.x
                dr.backward(gradient * dr.select(active, null / dr.detach(null), 0))
            ray.o[active] = dr.detach(event.p)
            ray.maxt[active] = ray.maxt - dr.detach(event.t)

    def to_string(self) -> str:
        """One line for Mitsuba's log."""
        return f"ScatteredLight[floor = {self.floor}, first_order = {self.first_order}]"


mi.register_integrator("scattered_light", ScatteredLight)
