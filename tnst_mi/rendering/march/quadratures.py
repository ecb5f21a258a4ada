"""The quadratures of `tnst_mi.choices`: what a march adds up along a ray, and the derivatives of that.

In all of them h is the distance between samples, σ_k = γ d_k the extinction at sample k counted from the camera, τ_k =
h Σ_{i≤k} σ_i the optical depth up to and including that sample, and T_k = exp(−τ_k). W_k is what the samples up to k
show of white smoke, in units of `Quadrature.unit`; what they show of coloured smoke follows from it (`coloured`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.kernels import opaque
from tnst_mi.fields.stencil import ClampedStencil
from tnst_mi.rendering.march.grid_march import GridMarch, in_smoke
from tnst_mi.rendering.march.lattice import Lattice


class Quadrature(ABC):
    """A discretisation of the integral along a ray.

    Args:
        gamma: ratio γ of extinction to emission.
    """

    #: Whether samples without smoke show something.
    shows_empty_space = False

    def __init__(self, gamma: float) -> None:
        self.inv_gamma = opaque(1 / gamma)

    @abstractmethod
    def radiance(self, march: GridMarch) -> tuple[Any, Any]:
        """What the smoke on each ray shows in front of black, and its optical depth τ."""

    @abstractmethod
    def tangent(self, march: GridMarch, σ_dot: mi.TensorXf) -> tuple[Any, Any, Any]:
        """Derivative of the radiance along the tangent σ_dot of the extinction, τ, and its derivative."""

    @abstractmethod
    def adjoint(self, march: GridMarch, A: Any, B: Any, deposit: Any) -> None:
        """Call `deposit(k, stencil, δL ∂L/∂σ_k)` for every sample, given A = δL and B = δL · L.

        L is all that the ray shows, including what lies behind the smoke.
        """

    @abstractmethod
    def limit(self, lattice: Lattice) -> mi.Float:
        """Upper limit of the radiance in front of black."""

    @abstractmethod
    def source(self, σ_t: mi.Spectrum) -> mi.Spectrum:
        """What extinction σ_t emits per length: in small steps, the radiance is the integral of this times T."""

    @abstractmethod
    def unit(self, lattice: Lattice) -> Any:
        """The unit of W, a factor."""

    @abstractmethod
    def white(self, W: Any, h: Any, σ: Any, τ: Any) -> Any:
        """W_k from W_{k−1}, by the operations of `radiance`, so that both have the same bits."""

    @abstractmethod
    def white_tangent(self, W_dot: Any, h: Any, σ: Any, τ: Any, σ_dot: Any, τ_dot: Any) -> Any:
        """The derivative of W_k from that of W_{k−1}."""

    @abstractmethod
    def gain(self, T_before: Any, T: Any) -> Any:
        """The g_k of ∂L/∂σ_k = h (c_k g_k − (L − S_k)), in units of `unit`; S_k is of the samples before k."""


class InclusiveSum(Quadrature):
    """paper: L = Σ h σ_k T_k / γ.

    ∂L/∂σ_k = h (T_k/γ − (L − S_k)), where S_k is the part of L from the samples before k: what sample k emits towards
    the sensor, minus what it absorbs of everything at and behind it.
    """

    def radiance(self, march: GridMarch) -> tuple[Any, Any]:
        """Σ h σ_k T_k / γ and τ."""
        h, zeros = march.lattice.step, march.zeros()

        def emit(stencil: ClampedStencil, τ: Any, L: Any) -> tuple:
            σ = march.extinction(march.σ_t, stencil)
            τ = τ + h * σ
            return τ, L + h * σ * dr.exp(-τ)

        τ, L = march.visit_smoke((zeros, zeros), emit, "emission_absorption")
        return L * self.inv_gamma, τ

    def tangent(self, march: GridMarch, σ_dot: mi.TensorXf) -> tuple[Any, Any, Any]:
        """Σ h (σ̇_k − σ_k τ̇_k) T_k / γ, τ and τ̇."""
        h, zeros = march.lattice.step, march.zeros()

        def visit(_: mi.UInt32, stencil: ClampedStencil, τ: Any, τ_dot: Any, L_dot: Any) -> tuple:
            σ = march.extinction(march.σ_t, stencil)
            δσ = march.extinction(σ_dot, stencil)
            τ, τ_dot = τ + h * σ, τ_dot + h * δσ
            return τ, τ_dot, L_dot + h * (δσ - σ * τ_dot) * dr.exp(-τ)

        τ, τ_dot, L_dot = march.visit((zeros, zeros, zeros), visit, "emission_absorption tangent")
        return L_dot * self.inv_gamma, τ, τ_dot

    def adjoint(self, march: GridMarch, A: Any, B: Any, deposit: Any) -> None:
        """A march that accumulates S_k."""
        h, zeros, occupancy = march.lattice.step, march.zeros(), march.medium.occupancy

        def emit(stencil: ClampedStencil, τ: Any, T: Any, S: Any) -> tuple:
            σ = march.extinction(march.σ_t, stencil)
            τ = τ + h * σ
            T = dr.exp(-τ)
            return τ, T, S + h * σ * T * self.inv_gamma

        def visit(k: mi.UInt32, stencil: ClampedStencil, τ: Any, T: Any, S: Any) -> tuple:
            # Empty space, too, has a derivative: it could emit and absorb.
            before = S
            τ, T, S = in_smoke(occupancy, emit, stencil, τ, T, S)
            deposit(k, stencil, (A * (T * self.inv_gamma + before) - B) * h * march.scale)
            return τ, T, S

        march.visit((zeros, zeros + 1, zeros), visit, "emission_absorption adjoint")

    def limit(self, lattice: Lattice) -> mi.Float:
        """1/γ, the radiance of opaque smoke in small steps."""
        return self.inv_gamma

    def source(self, σ_t: mi.Spectrum) -> mi.Spectrum:
        """The density σ_t/γ."""
        return σ_t * self.inv_gamma

    def unit(self, lattice: Lattice) -> mi.Float:
        """1/γ."""
        return self.inv_gamma

    def white(self, W: Any, h: Any, σ: Any, τ: Any) -> Any:
        """Σ h σ_k T_k."""
        return W + h * σ * dr.exp(-τ)

    def white_tangent(self, W_dot: Any, h: Any, σ: Any, τ: Any, σ_dot: Any, τ_dot: Any) -> Any:
        """Σ h (σ̇_k − σ_k τ̇_k) T_k."""
        return W_dot + h * (σ_dot - σ * τ_dot) * dr.exp(-τ)

    def gain(self, T_before: Any, T: Any) -> Any:
        """T_k."""
        return T


class Exact(Quadrature):
    """exact: L = (1 − T)/γ. The integrals of the segments between samples telescope: only τ is needed.

    ∂L/∂σ_k = h (1/γ − L) for every k, with or without something behind the smoke.
    """

    def radiance(self, march: GridMarch) -> tuple[Any, Any]:
        """(1 − T)/γ and τ."""
        h = march.lattice.step

        def absorb(stencil: ClampedStencil, τ: Any) -> tuple:
            return (τ + h * march.extinction(march.σ_t, stencil),)

        (τ,) = march.visit_smoke((march.zeros(),), absorb, "emission_absorption")
        return -_expm1(-τ) * self.limit(march.lattice), τ

    def tangent(self, march: GridMarch, σ_dot: mi.TensorXf) -> tuple[Any, Any, Any]:
        """T τ̇/γ, τ and τ̇."""
        h, zeros = march.lattice.step, march.zeros()

        def visit(_: mi.UInt32, stencil: ClampedStencil, τ: Any, τ_dot: Any) -> tuple:
            return (
                τ + h * march.extinction(march.σ_t, stencil),
                τ_dot + h * march.extinction(σ_dot, stencil),
            )

        τ, τ_dot = march.visit((zeros, zeros), visit, "emission_absorption tangent")
        return dr.exp(-τ) * τ_dot * self.limit(march.lattice), τ, τ_dot

    def adjoint(self, march: GridMarch, A: Any, B: Any, deposit: Any) -> None:
        """The same for all samples of a ray."""
        constant = (A * self.limit(march.lattice) - B) * march.lattice.step * march.scale

        def visit(k: mi.UInt32, stencil: ClampedStencil) -> tuple:
            deposit(k, stencil, constant)
            return ()

        march.visit((), visit, "emission_absorption adjoint")

    def limit(self, lattice: Lattice) -> mi.Float:
        """1/γ, the radiance of opaque smoke."""
        return self.inv_gamma

    def source(self, σ_t: mi.Spectrum) -> mi.Spectrum:
        """The density σ_t/γ."""
        return σ_t * self.inv_gamma

    def unit(self, lattice: Lattice) -> mi.Float:
        """The upper limit of the radiance."""
        return self.limit(lattice)

    def white(self, W: Any, h: Any, σ: Any, τ: Any) -> Any:
        """1 − T_k."""
        return -_expm1(-τ)

    def white_tangent(self, W_dot: Any, h: Any, σ: Any, τ: Any, σ_dot: Any, τ_dot: Any) -> Any:
        """T_k τ̇_k."""
        return dr.exp(-τ) * τ_dot

    def gain(self, T_before: Any, T: Any) -> Any:
        """T_{k−1}: the segment of sample k emits c_k (T_{k−1} − T_k)."""
        return T_before


class Transmittance(Exact):
    """transmittance: L = 1 − T, γ times exact."""

    def limit(self, lattice: Lattice) -> mi.Float:
        """1, the opacity of opaque smoke."""
        return opaque(1.0)

    def source(self, σ_t: mi.Spectrum) -> mi.Spectrum:
        """γ times the density."""
        return σ_t


class IntegratedTransmittance(Quadrature):
    """integrated_transmittance: L = Σ h T_k over all samples inside the box; those of empty space count.

    ∂L/∂σ_k = −h Σ_{j≥k} h T_j = −h (L − S_k), where S_k is the part of L from the samples before k. That also holds
    with something behind the smoke, of which L then contains T times the radiance.
    """

    shows_empty_space = True

    def radiance(self, march: GridMarch) -> tuple[Any, Any]:
        """Σ h T_k and τ."""
        h, zeros, occupancy, absorb = march.lattice.step, march.zeros(), march.medium.occupancy, self._absorber(march)

        def visit(_: mi.UInt32, stencil: ClampedStencil, τ: Any, T: Any, L: Any) -> tuple:
            τ, T = in_smoke(occupancy, absorb, stencil, τ, T)
            return τ, T, L + h * T

        τ, _, L = march.visit((zeros, zeros + 1, zeros), visit, "emission_absorption")
        return L, τ

    def tangent(self, march: GridMarch, σ_dot: mi.TensorXf) -> tuple[Any, Any, Any]:
        """−Σ h τ̇_k T_k, τ and τ̇."""
        h, zeros = march.lattice.step, march.zeros()

        def visit(_: mi.UInt32, stencil: ClampedStencil, τ: Any, τ_dot: Any, L_dot: Any) -> tuple:
            τ = τ + h * march.extinction(march.σ_t, stencil)
            τ_dot = τ_dot + h * march.extinction(σ_dot, stencil)
            return τ, τ_dot, L_dot - h * τ_dot * dr.exp(-τ)

        τ, τ_dot, L_dot = march.visit((zeros, zeros, zeros), visit, "emission_absorption tangent")
        return L_dot, τ, τ_dot

    def adjoint(self, march: GridMarch, A: Any, B: Any, deposit: Any) -> None:
        """A march that accumulates S_k."""
        h, zeros, occupancy, absorb = march.lattice.step, march.zeros(), march.medium.occupancy, self._absorber(march)

        def visit(k: mi.UInt32, stencil: ClampedStencil, τ: Any, T: Any, S: Any) -> tuple:
            deposit(k, stencil, (A * S - B) * h * march.scale)
            τ, T = in_smoke(occupancy, absorb, stencil, τ, T)
            return τ, T, S + h * T

        march.visit((zeros, zeros + 1, zeros), visit, "emission_absorption adjoint")

    @staticmethod
    def _absorber(march: GridMarch) -> Any:
        """The step (τ, T) → (τ, T) of a sample in smoke."""

        def absorb(stencil: ClampedStencil, τ: Any, _: Any) -> tuple:
            τ = τ + march.lattice.step * march.extinction(march.σ_t, stencil)
            return τ, dr.exp(-τ)

        return absorb

    def limit(self, lattice: Lattice) -> mi.Float:
        """The length of the longest ray inside the box."""
        return opaque(lattice.longest) * lattice.step

    def source(self, σ_t: mi.Spectrum) -> mi.Spectrum:
        """1, with or without smoke."""
        return mi.Spectrum(1)

    def unit(self, lattice: Lattice) -> float:
        """1."""
        return 1.0

    def white(self, W: Any, h: Any, σ: Any, τ: Any) -> Any:
        """Σ h T_k."""
        return W + h * dr.exp(-τ)

    def white_tangent(self, W_dot: Any, h: Any, σ: Any, τ: Any, σ_dot: Any, τ_dot: Any) -> Any:
        """−Σ h τ̇_k T_k."""
        return W_dot - h * τ_dot * dr.exp(-τ)

    def gain(self, T_before: Any, T: Any) -> Any:
        """0: what is shown does not depend on the density there."""
        return T * 0


def _expm1(x: Any) -> Any:
    """exp(x) − 1 without cancellation near 0, where it is the series x (1 + x/2 (1 + x/3 (1 + x/4)))."""
    return dr.select(dr.abs(x) < 1e-2, x * (1 + x * (0.5 + x * (1 / 6 + x * (1 / 24)))), dr.exp(x) - 1)


_KINDS = {
    "paper": InclusiveSum,
    "exact": Exact,
    "transmittance": Transmittance,
    "integrated_transmittance": IntegratedTransmittance,
}


def quadrature(name: str, gamma: float) -> Quadrature:
    """The quadrature of a name in `tnst_mi.choices.QUADRATURES`."""
    return _KINDS[name](gamma)
