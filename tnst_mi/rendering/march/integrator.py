"""The `emission_absorption` integrator plugin (paper Eq. 11).

Importing this module registers the plugin for the active variant; `rendering.plugins` does so for every variant.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

from tnst_mi.choices import QUADRATURES
from tnst_mi.fields.kernels import opaque
from tnst_mi.fields.sums import RepeatableSum
from tnst_mi.rendering.cameras.orthographic import ParallelRays
from tnst_mi.rendering.march.back_projection import BackProjection
from tnst_mi.rendering.march.boundary import SceneMedium, crossing, seen_behind
from tnst_mi.rendering.march.grid_march import GridMarch
from tnst_mi.rendering.march.lattice import Lattice
from tnst_mi.rendering.march.medium import GridMedium
from tnst_mi.rendering.march.quadratures import Quadrature, quadrature


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

    Works in any scene with one ``heterogeneous`` medium, its ``sigma_t`` a ``gridvolume``, inside a convex shape with a
    ``null`` BSDF, and with any sensor. The medium emits and absorbs; its albedo and phase function are ignored.
    Emitters seen through the medium are attenuated and added. Surfaces inside the medium are an error. The sample
    positions are the same in every view of a grid: see :py:class:`tnst_mi.rendering.march.lattice.Lattice`.

    Derivatives are with respect to ``sigma_t.data``. The reverse-mode pass replays the march. For parallel rays it
    stores the adjoint of every sample, and each voxel gathers its own; for others it scatters them and stores nothing
    per step. The result is bit-identical in every run. With one extinction channel the march is scalar, with three it
    is done per channel.
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
        self._medium: SceneMedium | None = None

    def parameters_changed(self, keys: list[str]) -> None:
        """Discard what was resolved from the scene."""
        self._medium = None

    def resolve(self, scene: mi.Scene) -> SceneMedium:
        """The scene's medium, with its current extinction tensor."""
        if self._medium is None or not self._medium.belongs_to(scene):
            self._medium = SceneMedium(scene)
        else:
            self._medium.refresh()
        return self._medium

    def sample(
        self,
        mode: dr.ADMode,
        scene: mi.Scene | GridMedium,
        sampler: mi.Sampler | None,
        ray: mi.Ray3f,
        δL: mi.Spectrum | None,
        state_in: Any,
        active: mi.Bool,
        parallel: ParallelRays | None = None,
        **kwargs: Any,  # Absorbs unused arguments
    ) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float], Any]:
        """Radiance along rays (primal), its tangent (forward), or its adjoint (backward); see `RBIntegrator`.

        A `GridMedium` instead of a scene is marched alone, in front of black: no rays are traced, and on a GPU no OptiX
        is needed. Declaring the rays `parallel` makes the adjoint faster.
        """
        if isinstance(scene, mi.Scene):
            medium = self.resolve(scene)
            lattice, background, valid = self._intersect(scene, medium, ray, active)
        else:
            medium, background = scene, None
            lattice = Lattice(medium, ray, self._sample_distance(medium))
            valid = active & (lattice.exit > lattice.entry)
        if mode == dr.ADMode.Primal:
            L = self._radiance(medium, lattice, background)
        elif mode == dr.ADMode.Backward:
            L = state_in
            self._scatter_adjoint(medium, lattice, L, δL, parallel)
        else:
            L = self._tangent(medium, lattice, background)
        return mi.Spectrum(L), valid, [], L

    # --------------------------------------------------------------------
    # Where a ray passes through the medium, and what is behind it
    # --------------------------------------------------------------------

    def _sample_distance(self, medium: GridMedium) -> float:
        return self.step if self.step > 0 else float(medium.transform.voxel_edges(medium.grid_shape).min())

    def _intersect(
        self, scene: mi.Scene, medium: SceneMedium, ray: mi.Ray3f, active: mi.Bool
    ) -> tuple[Lattice, mi.Spectrum | None, mi.Bool]:
        bounds = None if medium.fills_box else crossing(scene, medium.shape, ray, active)
        lattice = Lattice(medium, ray, self._sample_distance(medium), bounds)
        return lattice, *seen_behind(scene, medium, lattice, ray, active)

    # --------------------------------------------------------------------
    # The march
    # --------------------------------------------------------------------

    def _radiance(self, medium: GridMedium, lattice: Lattice, background: mi.Spectrum | None) -> Any:
        L, τ = self._quadrature.radiance(GridMarch(medium, lattice))
        return L if background is None else mi.Spectrum(L) + dr.exp(-τ) * background

    def _scatter_adjoint(
        self, medium: GridMedium, lattice: Lattice, L: Any, δL: mi.Spectrum, parallel: ParallelRays | None
    ) -> None:
        """Accumulate δL · ∂L/∂σ_t into the gradient of the extinction tensor."""
        # `RBIntegrator` suspends derivatives around this function.
        with dr.resume_grad():
            if not dr.grad_enabled(medium.extinction):
                return
        L, march = mi.Spectrum(L), GridMarch(medium, lattice)
        if medium.channels == 1:
            A, B = dr.sum(δL), dr.sum(δL * L)
        else:
            A, B = mi.Color3f(δL), mi.Color3f(δL * L)

        if parallel is not None and medium.channels == 1:
            projection = BackProjection(medium, lattice, parallel)
            self._quadrature.adjoint(march, A, B, lambda k, _, adjoint: projection.store(k, adjoint))
            with dr.resume_grad():
                # Removed from the AD graph, whose reference would make the in-place addition copy the array.
                total = dr.grad(medium.extinction).array
                dr.clear_grad(medium.extinction)
            projection.add_to(total)
        else:
            limit = self._quadrature.limit(lattice)
            bound = dr.max(dr.sum(dr.abs(δL) * (limit + dr.abs(L)))) * lattice.step * dr.abs(opaque(medium.scale))
            size, addends = dr.width(medium.extinction.array), dr.width(lattice.count) * lattice.longest
            sums = RepeatableSum(size, bound, addends)
            self._quadrature.adjoint(march, A, B, lambda _, stencil, adjoint: stencil.splat(sums, adjoint))
            total = sums.result()
        with dr.resume_grad():
            dr.accum_grad(medium.extinction, mi.TensorXf(total, tuple(medium.extinction.shape)))

    def _tangent(self, medium: GridMedium, lattice: Lattice, background: mi.Spectrum | None) -> Any:
        """Derivative of the radiance along the tangent of the extinction tensor."""
        with dr.resume_grad():
            σ_dot = dr.grad(medium.extinction)
        L_dot, τ, τ_dot = self._quadrature.tangent(GridMarch(medium, lattice), σ_dot)
        return L_dot if background is None else mi.Spectrum(L_dot) - dr.exp(-τ) * τ_dot * background

    @property
    def _quadrature(self) -> Quadrature:
        return quadrature(self.quadrature, self.gamma)

    def to_string(self) -> str:
        """One line for Mitsuba's log."""
        step = self.step if self.step > 0 else "voxel"
        return f"EmissionAbsorption[gamma = {self.gamma}, quadrature = {self.quadrature}, step = {step}]"


mi.register_integrator("emission_absorption", EmissionAbsorption)
