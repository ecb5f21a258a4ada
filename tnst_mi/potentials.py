"""Velocity from potentials: v = λ ∇Φ + (1 − λ) ∇×Ψ (paper Eq. 3), and its adjoint in gather form.

Derivatives are central differences, one-sided in the two end cells of every axis. Being one linear map per axis, they
commute: the divergence of ∇×Ψ, taken with the same differences, vanishes to rounding at every cell.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from tnst_mi.arrays import any_array_kind
from tnst_mi.errors import InputError
from tnst_mi.grid import Cells, Shape, opaque


class _AxisDifference:
    """d/dx_axis in cells, and its transpose, applied to one component of a flat array."""

    def __init__(self, cells: Cells, axis: int, scale: mi.Float) -> None:
        self.cells, self.axis, self.scale = cells, axis, scale
        self.coordinate = (cells.x, cells.y, cells.z)[axis]
        self.last = cells.size[axis] - 1

    def _neighbour(self, step: int) -> mi.UInt32:
        coordinates = [self.cells.x, self.cells.y, self.cells.z]
        coordinates[self.axis] = dr.clip(self.coordinate + step, 0, self.last)
        return self.cells.index(*coordinates)

    def _row_weight(self, coordinate: mi.Int32) -> mi.Float:
        """1/2 for a central difference, 1 for the one-sided ones at both ends."""
        return dr.select((coordinate <= 0) | (coordinate >= self.last), 1.0, 0.5)

    def apply(self, values: mi.Float, channels: int, channel: int) -> mi.Float:
        """Difference of the neighbours; a clamped neighbour makes it one-sided."""
        upper = dr.gather(mi.Float, values, self._neighbour(1) * channels + channel)
        lower = dr.gather(mi.Float, values, self._neighbour(-1) * channels + channel)
        return (upper - lower) * self._row_weight(self.coordinate) * self.scale

    def transpose(self, values: mi.Float, channels: int, channel: int) -> mi.Float:
        """Gather form of the transpose: what the rows of both neighbours, and an end's own row, contribute here."""

        def row(step: int, active: mi.Bool) -> mi.Float:
            value = dr.gather(mi.Float, values, self._neighbour(step) * channels + channel, active)
            return value * self._row_weight(self.coordinate + step)

        i = self.coordinate
        total = row(-1, i >= 1) - row(1, i < self.last)
        total += row(0, (i == self.last) & (i > 0)) - row(0, (i == 0) & (i < self.last))
        return total * self.scale


class _Velocity(dr.CustomOp):
    """(Φ, Ψ) → v; linear, so that its derivative in forward mode is the map itself."""

    def eval(self, phi: mi.TensorXf | None, psi: mi.TensorXf | None, shape: Shape, lam: float, h: float) -> mi.TensorXf:
        self.shape, self.lam, self.h = shape, lam, h
        self.has_phi, self.has_psi = phi is not None, psi is not None
        return self._map(phi, psi)

    def _differences(self) -> list[_AxisDifference]:
        cells = Cells.of(self.shape)
        scale = dr.rcp(opaque(self.h))
        return [_AxisDifference(cells, axis, scale) for axis in range(3)]

    def _map(self, phi: mi.TensorXf | None, psi: mi.TensorXf | None) -> mi.TensorXf:
        d = self._differences()
        v = mi.Vector3f(0)
        if phi is not None:
            grad = mi.Vector3f(*(d[axis].apply(phi.array, 1, 0) for axis in range(3)))
            v += grad * opaque(self.lam)
        if psi is not None:
            p = psi.array
            curl = mi.Vector3f(
                d[1].apply(p, 3, 2) - d[2].apply(p, 3, 1),
                d[2].apply(p, 3, 0) - d[0].apply(p, 3, 2),
                d[0].apply(p, 3, 1) - d[1].apply(p, 3, 0),
            )
            v += curl * opaque(1 - self.lam)
        return mi.TensorXf(dr.ravel(v), (*self.shape, 3))

    def forward(self) -> None:
        self.set_grad_out(
            self._map(self.grad_in("phi") if self.has_phi else None, self.grad_in("psi") if self.has_psi else None)
        )

    def backward(self) -> None:
        d = self._differences()
        g = self.grad_out().array
        if self.has_phi:
            grad_phi = sum((d[axis].transpose(g, 3, axis) for axis in range(3)), mi.Float(0))
            self.set_grad_in("phi", mi.TensorXf(grad_phi * opaque(self.lam), self.shape))
        if self.has_psi:
            grad_psi = mi.Vector3f(
                d[2].transpose(g, 3, 1) - d[1].transpose(g, 3, 2),
                d[0].transpose(g, 3, 2) - d[2].transpose(g, 3, 0),
                d[1].transpose(g, 3, 0) - d[0].transpose(g, 3, 1),
            )
            self.set_grad_in("psi", mi.TensorXf(dr.ravel(grad_psi * opaque(1 - self.lam)), (*self.shape, 3)))

    def name(self) -> str:
        return "velocity"


@any_array_kind("phi", "psi")
def velocity(phi: mi.TensorXf | None, psi: mi.TensorXf | None, lam: float, h: float = 1.0) -> mi.TensorXf:
    """Velocity of the potentials, v = λ ∇Φ + (1 − λ) ∇×Ψ (paper Eq. 3).

    Args:
        phi: scalar potential Φ, shape (D, H, W), in full-resolution cells²; None for an absent one.
        psi: vector potential Ψ, shape (D, H, W, 3), components (x, y, z), same unit; None for an absent one.
        lam: share λ of the irrotational part, in [0, 1].
        h: size of a cell in full-resolution cells, > 0.

    Returns:
        Velocity (D, H, W, 3), components (x, y, z), in full-resolution cells per frame, in the array kind given.

    Raises:
        InputError: both potentials are absent, their shapes disagree, or λ or h is out of range.
    """
    if phi is None and psi is None:
        raise InputError("velocity: both potentials are None, expected at least one")
    shape = tuple(phi.shape) if phi is not None else tuple(psi.shape)[:-1]
    if len(shape) != 3 or (psi is not None and tuple(psi.shape) != (*shape, 3)):
        found = f"phi {None if phi is None else phi.shape}, psi {None if psi is None else psi.shape}"
        raise InputError(f"velocity: {found} given, expected (D, H, W) and (D, H, W, 3) on the same grid")
    if not 0.0 <= lam <= 1.0 or not h > 0.0:
        raise InputError(f"velocity: lam {lam} and h {h} given, expected 0 <= lam <= 1 and h > 0")
    return dr.custom(_Velocity, phi, psi, shape, float(lam), float(h))
