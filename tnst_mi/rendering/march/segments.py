"""A part of a ray that lies in one medium: what it shows, how much it lets through, and the derivatives of both."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.kernels import opaque
from tnst_mi.fields.sums import RepeatableSum
from tnst_mi.rendering.march.back_projection import RaysTogether
from tnst_mi.rendering.march.converging import back_projection
from tnst_mi.rendering.march.grid_march import GridMarch
from tnst_mi.rendering.march.lattice import Lattice
from tnst_mi.rendering.march.medium import GridMedium, HomogeneousMedium
from tnst_mi.rendering.march.quadratures import Quadrature

#: Longer segments than this, in world units, count as this long: infinity times no extinction would not be a number.
_LONGEST = 1e8


class Segment(ABC):
    """One segment of every ray, in one medium; empty for rays without one.

    Attributes:
        crossed: whether a ray has a segment that is not empty.
    """

    crossed: mi.Bool

    @abstractmethod
    def radiance(self) -> tuple[Any, Any]:
        """What the segments show in front of black, and their transmittance T."""

    @abstractmethod
    def tangent(self) -> tuple[Any, Any, Any]:
        """Derivative of that radiance along the tangent of the medium's parameters, T, and the derivative of T."""

    @abstractmethod
    def scatter_adjoint(
        self, L: Any, δL: mi.Spectrum, behind: mi.Spectrum | None, together: RaysTogether | None
    ) -> None:
        """Accumulate δL · ∂L/∂p into the gradients of the medium's parameters p.

        Args:
            L: what the segment and everything behind it show.
            δL: adjoint of L.
            behind: what everything behind it shows, None if that is black.
            together: what the rays have in common, if they are all those of some viewpoints.
        """

    def in_front_of(self, behind: mi.Spectrum | None) -> Any:
        """What the segment and everything behind it show."""
        L, T = self.radiance()
        return L if behind is None else mi.Spectrum(L) + T * behind


class GridSegment(Segment):
    """A segment in a grid, marched sample by sample."""

    def __init__(self, medium: GridMedium, lattice: Lattice, quadrature: Quadrature) -> None:
        self.medium, self.lattice, self.quadrature = medium, lattice, quadrature
        self.crossed = lattice.exit > lattice.entry

    def radiance(self) -> tuple[Any, Any]:
        """What the segments show in front of black, and their transmittance T."""
        L, τ = self.quadrature.radiance(GridMarch(self.medium, self.lattice))
        return L, dr.exp(-τ)

    def tangent(self) -> tuple[Any, Any, Any]:
        """Derivative of that radiance along the tangent of the extinction tensor, T, and the derivative of T."""
        with dr.resume_grad():
            σ_dot = dr.grad(self.medium.extinction)
        L_dot, τ, τ_dot = self.quadrature.tangent(GridMarch(self.medium, self.lattice), σ_dot)
        T = dr.exp(-τ)
        return L_dot, T, -T * τ_dot

    def scatter_adjoint(
        self, L: Any, δL: mi.Spectrum, behind: mi.Spectrum | None, together: RaysTogether | None
    ) -> None:
        """Accumulate δL · ∂L/∂σ_t into the gradient of the extinction tensor."""
        medium, lattice = self.medium, self.lattice
        # `RBIntegrator` suspends derivatives around this function.
        with dr.resume_grad():
            if not dr.grad_enabled(medium.extinction):
                return
        L, march = mi.Spectrum(L), GridMarch(medium, lattice)
        if medium.channels == 1:
            A, B = dr.sum(δL), dr.sum(δL * L)
        else:
            A, B = mi.Color3f(δL), mi.Color3f(δL * L)

        if together is not None and medium.channels == 1:
            projection = back_projection(medium, lattice, together)
            self.quadrature.adjoint(march, A, B, lambda k, _, adjoint: projection.store(k, adjoint))
            with dr.resume_grad():
                # Removed from the AD graph, whose reference would make the in-place addition copy the array.
                total = dr.grad(medium.extinction).array
                dr.clear_grad(medium.extinction)
            projection.add_to(total)
        else:
            limit = self.quadrature.limit(lattice)
            bound = dr.max(dr.sum(dr.abs(δL) * (limit + dr.abs(L))) * lattice.step) * dr.abs(opaque(medium.scale))
            size, addends = dr.width(medium.extinction.array), dr.width(lattice.count) * lattice.longest
            sums = RepeatableSum(size, bound, addends)
            self.quadrature.adjoint(march, A, B, lambda _, stencil, adjoint: stencil.splat(sums, adjoint))
            total = sums.result()
        with dr.resume_grad():
            dr.accum_grad(medium.extinction, mi.TensorXf(total, tuple(medium.extinction.shape)))


class HomogeneousSegment(Segment):
    """A segment in a homogeneous medium, integrated exactly: the limit of any quadrature for small steps.

    Its derivatives are those of a closed form, left to Dr.Jit.
    """

    def __init__(self, medium: HomogeneousMedium, entry: mi.Float, exit: mi.Float, quadrature: Quadrature) -> None:
        self.medium, self.quadrature, self.crossed = medium, quadrature, exit > entry
        self._length = dr.select(self.crossed, dr.minimum(exit - entry, _LONGEST), 0)

    def _integrals(self, σ_t: mi.Spectrum) -> tuple[mi.Spectrum, mi.Spectrum]:
        τ = σ_t * self._length
        # The mean transmittance (1 − exp(−τ))/τ, near 0 by its series. The quotient is kept from 0/0, whose derivative
        # would not be a number even where it is not selected.
        thin = τ < 1e-2
        quotient = dr.select(thin, 1, τ)
        mean = dr.select(thin, 1 - τ * (0.5 - τ * (1 / 6 - τ / 24)), (1 - dr.exp(-quotient)) / quotient)
        return self.quadrature.source(σ_t) * self._length * mean, dr.exp(-τ)

    def radiance(self) -> tuple[Any, Any]:
        """What the segments show in front of black, and their transmittance T."""
        return self._integrals(dr.detach(self.medium.extinction()))

    def tangent(self) -> tuple[Any, Any, Any]:
        """Derivative of that radiance along the tangent of the extinction, T, and the derivative of T."""
        with dr.resume_grad():
            L, T = self._integrals(self.medium.extinction())
            if not dr.grad_enabled(L, T):
                return dr.zeros(mi.Spectrum), T, dr.zeros(mi.Spectrum)
            # The parameters' tangents are kept: rays may pass through the medium again.
            L_dot, T_dot = dr.forward_to(L, T, flags=dr.ADFlag.ClearNone)
            return L_dot, dr.detach(T), T_dot

    def scatter_adjoint(
        self, L: Any, δL: mi.Spectrum, behind: mi.Spectrum | None, together: RaysTogether | None
    ) -> None:
        """Accumulate δL · ∂L/∂σ_t into the gradient of what the extinction is computed from."""
        with dr.resume_grad():
            σ_t = self.medium.extinction()
            if dr.grad_enabled(σ_t):
                L, T = self._integrals(σ_t)
                dr.backward(dr.sum(δL * (L if behind is None else L + T * behind)))
