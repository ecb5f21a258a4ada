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
from tnst_mi.fields.stencil import ClampedStencil
from tnst_mi.fields.sums import RepeatableSum
from tnst_mi.rendering.cameras.orthographic import ParallelRays
from tnst_mi.rendering.march.back_projection import BackProjection
from tnst_mi.rendering.march.boundary import SceneMedium, crossing, seen_behind
from tnst_mi.rendering.march.lattice import Lattice
from tnst_mi.rendering.march.medium import GridMedium


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
         ``transmittance``: 1 − exp(−γ h Σ d). (Default: ``paper``)
     * - step
       - |float|
       - Distance h between samples in world units. (Default: the shortest edge of the grid's cells)

    Works in any scene with one ``heterogeneous`` medium, its ``sigma_t`` a ``gridvolume``, inside a convex shape with a
    ``null`` BSDF, and with any sensor. The medium emits and absorbs; its albedo and phase function are ignored.
    Emitters seen through the medium are attenuated and added. Surfaces inside the medium are an error. The sample
    positions are the same in every view of a grid: see :py:class:`tnst_mi.rendering.march.lattice.Lattice`.

    Derivatives are with respect to ``sigma_t.data``. The reverse-mode pass replays the march and stores nothing per
    step; its result is bit-identical in every run. With one extinction channel the march is scalar, with three it is
    done per channel.
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
        lattice.rays = parallel
        if mode == dr.ADMode.Primal:
            L = self._radiance(medium, lattice, background)
        elif mode == dr.ADMode.Backward:
            L = state_in
            self._scatter_adjoint(medium, lattice, L, δL)
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

    def _extinction(self, medium: GridMedium, tensor: mi.TensorXf, stencil: ClampedStencil) -> Any:
        """Interpolated extinction: `mi.Float` for a grey medium, `mi.Color3f` for a coloured one."""
        value = stencil.value(stencil.read(tensor.array, medium.channels))
        scale = opaque(medium.scale)
        return value[0] * scale if medium.channels == 1 else mi.Color3f(*value) * scale

    def _zeros(self, medium: GridMedium, lattice: Lattice) -> Any:
        value_type = mi.Float if medium.channels == 1 else mi.Color3f
        return dr.zeros(value_type, dr.width(lattice.count))

    @dr.syntax
    def _radiance(self, medium: GridMedium, lattice: Lattice, background: mi.Spectrum | None) -> Any:
        σ_t, occupancy, h = dr.detach(medium.extinction), medium.occupancy, lattice.step
        inv_gamma = opaque(1 / self.gamma)  # 1/γ: emission over extinction
        τ = self._zeros(medium, lattice)  # optical depth from the sensor
        L = self._zeros(medium, lattice)  # radiance, times γ
        k = dr.zeros(mi.UInt32, dr.width(lattice.count))

        # --------------------- March ---------------------
        while dr.hint(k < lattice.count, label="emission_absorption"):
            stencil = lattice.stencil(k)
            if dr.hint(occupancy.at(stencil.lower), label="smoke"):
                σ = self._extinction(medium, σ_t, stencil)
                τ += h * σ
                if dr.hint(self.quadrature == "paper", mode="scalar"):
                    L += h * σ * dr.exp(-τ)
            k += 1

        # ------------------- Quadrature ------------------
        if dr.hint(self.quadrature != "paper", mode="scalar"):
            L = -_expm1(-τ)  # the segments' transmittances telescope
        if dr.hint(self.quadrature != "transmittance", mode="scalar"):
            L *= inv_gamma
        return L if background is None else mi.Spectrum(L) + dr.exp(-τ) * background

    def _scatter_adjoint(self, medium: GridMedium, lattice: Lattice, L: Any, δL: mi.Spectrum) -> None:
        """Accumulate δL · ∂L/∂σ_t into the gradient of the extinction tensor.

        paper:  ∂L/∂σ_k = h (exp(−τ_k)/γ − (L − S_k)), where S_k is the part of L from the samples before k: what sample
        k emits towards the sensor, minus what it absorbs of everything at and behind it.
        exact:  ∂L/∂σ_k = h (1/γ − L) for every k, and h (1 − L) for transmittance.
        """
        # `RBIntegrator` suspends derivatives around this function.
        with dr.resume_grad():
            if not dr.grad_enabled(medium.extinction):
                return
        L = mi.Spectrum(L)
        if medium.channels == 1:
            A, B = dr.sum(δL), dr.sum(δL * L)
        else:
            A, B = mi.Color3f(δL), mi.Color3f(δL * L)

        if lattice.rays is not None and medium.channels == 1:
            projection = BackProjection(medium, lattice, lattice.rays)
            self._march_adjoint(medium, lattice, A, B, lambda k, _, adjoint: projection.store(k, adjoint))
            with dr.resume_grad():
                # Removed from the AD graph, whose reference would make the in-place addition copy the array.
                total = dr.grad(medium.extinction).array
                dr.clear_grad(medium.extinction)
            projection.add_to(total)
        else:
            limit = self._limit
            bound = dr.max(dr.sum(dr.abs(δL) * (limit + dr.abs(L)))) * lattice.step * dr.abs(opaque(medium.scale))
            size, addends = dr.width(medium.extinction.array), dr.width(lattice.count) * lattice.longest
            sums = RepeatableSum(size, bound, addends)
            self._march_adjoint(medium, lattice, A, B, lambda _, stencil, adjoint: stencil.splat(sums, adjoint))
            total = sums.result()
        with dr.resume_grad():
            dr.accum_grad(medium.extinction, mi.TensorXf(total, tuple(medium.extinction.shape)))

    @dr.syntax
    def _march_adjoint(self, medium: GridMedium, lattice: Lattice, A: Any, B: Any, deposit: Any) -> None:
        """Call `deposit(k, stencil, δL ∂L/∂σ_k)` for every sample, given A = δL and B = δL · L."""
        σ_t, occupancy = dr.detach(medium.extinction), medium.occupancy
        h, scale, inv_gamma = lattice.step, opaque(medium.scale), opaque(1 / self.gamma)
        paper = self.quadrature == "paper"
        constant = (A * self._limit - B) * h * scale  # of the other quadratures: the same for every sample of a ray
        τ = self._zeros(medium, lattice)  # optical depth from the sensor
        T = self._zeros(medium, lattice) + 1  # transmittance
        S = self._zeros(medium, lattice)  # radiance of the samples so far
        k = dr.zeros(mi.UInt32, dr.width(lattice.count))

        while dr.hint(k < lattice.count, label="emission_absorption adjoint"):
            stencil = lattice.stencil(k)
            if dr.hint(paper, mode="scalar"):
                before = S
                if dr.hint(occupancy.at(stencil.lower), label="smoke"):
                    σ = self._extinction(medium, σ_t, stencil)
                    τ += h * σ
                    T = dr.exp(-τ)
                    S = S + h * σ * T * inv_gamma  # not in place: `before` keeps its value
                # Empty space, too, has a derivative: it could emit and absorb.
                deposit(k, stencil, (A * (T * inv_gamma + before) - B) * h * scale)
            else:
                deposit(k, stencil, constant)
            k += 1

    @property
    def _limit(self) -> mi.Float:
        """The radiance of opaque smoke."""
        return opaque(1 / self.gamma if self.quadrature != "transmittance" else 1.0)

    @dr.syntax
    def _tangent(self, medium: GridMedium, lattice: Lattice, background: mi.Spectrum | None) -> Any:
        """Derivative of the radiance along the tangent of the extinction tensor."""
        with dr.resume_grad():
            σ_t, σ_dot = dr.detach(medium.extinction), dr.grad(medium.extinction)
        h, inv_gamma = lattice.step, opaque(1 / self.gamma)
        τ = self._zeros(medium, lattice)
        τ_dot = self._zeros(medium, lattice)
        L_dot = self._zeros(medium, lattice)
        k = dr.zeros(mi.UInt32, dr.width(lattice.count))

        while dr.hint(k < lattice.count, label="emission_absorption tangent"):
            stencil = lattice.stencil(k)
            σ = self._extinction(medium, σ_t, stencil)
            δσ = self._extinction(medium, σ_dot, stencil)
            τ += h * σ
            τ_dot += h * δσ
            L_dot += h * (δσ - σ * τ_dot) * dr.exp(-τ)
            k += 1

        T = dr.exp(-τ)
        if dr.hint(self.quadrature != "paper", mode="scalar"):
            L_dot = T * τ_dot
        if dr.hint(self.quadrature != "transmittance", mode="scalar"):
            L_dot *= inv_gamma
        return L_dot if background is None else mi.Spectrum(L_dot) - T * τ_dot * background

    def to_string(self) -> str:
        """One line for Mitsuba's log."""
        step = self.step if self.step > 0 else "voxel"
        return f"EmissionAbsorption[gamma = {self.gamma}, quadrature = {self.quadrature}, step = {step}]"


def _expm1(x: Any) -> Any:
    """exp(x) − 1 without cancellation near 0, where it is the series x (1 + x/2 (1 + x/3 (1 + x/4)))."""
    return dr.select(dr.abs(x) < 1e-2, x * (1 + x * (0.5 + x * (1 / 6 + x * (1 / 24)))), dr.exp(x) - 1)


mi.register_integrator("emission_absorption", EmissionAbsorption)
