"""Velocity from potentials: v = λ ∇Φ + (1 − λ) ∇×Ψ (paper Eq. 3), and its adjoint in gather form.

Derivatives are central differences, one-sided in the two end cells of every axis. As linear maps along one axis each,
they commute: the divergence of ∇×Ψ, taken with the same differences, vanishes up to rounding in every cell.

A grid of one cell along an axis is a plane: nothing varies along that axis, and v has no component along it, since that
would carry the smoke out of the grid.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from tnst_mi.errors import InputError
from tnst_mi.fields.arrays import any_array_kind
from tnst_mi.fields.grid import Cells, Shape
from tnst_mi.fields.kernels import opaque, require_indexable, stored


class AxisDifference:
    """d/dx_axis in cells, and its transpose."""

    def __init__(self, cells: Cells, axis: int, scale: mi.Float) -> None:
        self.scale = scale
        self.coordinate, self.last = (cells.x, cells.y, cells.z)[axis], cells.size[axis] - 1
        stride = (mi.Int32(1), cells.size.x, cells.size.x * cells.size.y)[axis]
        here = mi.Int32(cells.number)
        #: Storage indices of the neighbours; beyond an end, the index of the cell itself.
        self.below = mi.UInt32(here - dr.select(self.coordinate > 0, stride, 0))
        self.above = mi.UInt32(here + dr.select(self.coordinate < self.last, stride, 0))

    def _row_weight(self, coordinate: mi.Int32) -> mi.Float:
        """1/2 for a central difference, 1 for the one-sided ones at both ends."""
        return dr.select((coordinate <= 0) | (coordinate >= self.last), 1.0, 0.5)

    def apply(self, values: mi.Float, channels: int = 1, channel: int = 0) -> mi.Float:
        """Difference of the neighbours in one channel; where a neighbour is missing, the cell itself replaces it."""
        above = dr.gather(mi.Float, values, self.above * channels + channel)
        below = dr.gather(mi.Float, values, self.below * channels + channel)
        return (above - below) * self._row_weight(self.coordinate) * self.scale

    def transpose(self, values: mi.Float) -> mi.Float:
        """The transpose in gather form: contributions of both neighbours' rows and, in an end cell, of its own row."""
        i = self.coordinate
        below = dr.gather(mi.Float, values, self.below, i > 0) * self._row_weight(i - 1)
        above = dr.gather(mi.Float, values, self.above, i < self.last) * self._row_weight(i + 1)
        own = dr.select(i == self.last, values, 0) - dr.select(i == 0, values, 0)
        return (below - above + own) * self.scale


@dataclass(frozen=True)
class PotentialVelocity:
    """v evaluated on demand at given cells, so that it need not be stored, and the transpose of this linear map.

    Args:
        phi: Φ (D, H, W), None if absent.
        psi: Ψ (D, H, W, 3), None if absent.
        lam: λ.
        h: size of a cell in full-resolution cells.
    """

    phi: mi.TensorXf | None
    psi: mi.TensorXf | None
    lam: float
    h: float

    @property
    def potentials(self) -> dict[str, mi.TensorXf]:
        """The potentials that are present, by name."""
        return {name: value for name, value in (("phi", self.phi), ("psi", self.psi)) if value is not None}

    @property
    def source(self) -> Callable[[dict[str, mi.TensorXf]], PotentialVelocity]:
        """The map from potentials by name to their velocity."""
        lam, h = self.lam, self.h
        return lambda potentials: PotentialVelocity(potentials.get("phi"), potentials.get("psi"), lam, h)

    @property
    def shape(self) -> Shape:
        """(D, H, W)."""
        return tuple(next(iter(self.potentials.values())).shape)[:3]

    def _in_plane(self, v: mi.Vector3f) -> mi.Vector3f:
        """The vector without its components along axes of one cell; as an orthogonal projection, its own transpose."""
        still = dr.zeros(mi.Float, dr.width(v))
        return mi.Vector3f(*(x if n > 1 else still for x, n in zip(v, reversed(self.shape), strict=True)))

    def _differences(self, cells: Cells) -> list[AxisDifference]:
        scale = dr.rcp(opaque(self.h))
        return [AxisDifference(cells, axis, scale) for axis in range(3)]

    def at(self, cells: Cells) -> mi.Vector3f:
        """v in full-resolution cells per frame."""
        d = self._differences(cells)
        v = mi.Vector3f(0)
        if self.phi is not None:
            v += mi.Vector3f(*(difference.apply(self.phi.array) for difference in d)) * opaque(self.lam)
        if self.psi is not None:
            p = self.psi.array
            curl = mi.Vector3f(
                d[1].apply(p, 3, 2) - d[2].apply(p, 3, 1),
                d[2].apply(p, 3, 0) - d[0].apply(p, 3, 2),
                d[0].apply(p, 3, 1) - d[1].apply(p, 3, 0),
            )
            v += curl * opaque(1 - self.lam)
        return self._in_plane(v)

    def transpose(self, g: mi.Vector3f) -> dict[str, mi.TensorXf]:
        """From ∂L/∂v at all cells, one array in memory per component, to ∂L/∂Φ and ∂L/∂Ψ where present."""
        d, g = self._differences(Cells.of(self.shape)), self._in_plane(g)
        result = {}
        if self.phi is not None:
            grad_phi = d[0].transpose(g.x) + d[1].transpose(g.y) + d[2].transpose(g.z)
            result["phi"] = mi.TensorXf(stored(grad_phi * opaque(self.lam)), self.shape)
        if self.psi is not None:
            grad_psi = mi.Vector3f(
                d[2].transpose(g.y) - d[1].transpose(g.z),
                d[0].transpose(g.z) - d[2].transpose(g.x),
                d[1].transpose(g.x) - d[0].transpose(g.y),
            )
            result["psi"] = mi.TensorXf(dr.ravel(grad_psi * opaque(1 - self.lam)), (*self.shape, 3))
        dr.eval(result)
        return result


class _Velocity(dr.CustomOp):
    """The velocity as a tensor; since it is linear, its forward-mode derivative is the map itself."""

    def eval(
        self,
        potentials: dict[str, mi.TensorXf],
        source: Callable[[dict[str, mi.TensorXf]], PotentialVelocity],
    ) -> mi.TensorXf:
        self.source, self.velocity = source, source(potentials)
        return self._tensor(self.velocity)

    @staticmethod
    def _tensor(velocity: PotentialVelocity) -> mi.TensorXf:
        return mi.TensorXf(dr.ravel(velocity.at(Cells.of(velocity.shape))), (*velocity.shape, 3))

    def forward(self) -> None:
        self.set_grad_out(self._tensor(self.source(self.grad_in("potentials"))))

    def backward(self) -> None:
        g = mi.Vector3f(*(stored(component) for component in dr.unravel(mi.Vector3f, self.grad_out().array)))
        dr.eval(g)
        self.set_grad_in("potentials", self.velocity.transpose(g))

    def name(self) -> str:
        return "velocity"


@any_array_kind("phi", "psi")
def velocity(phi: mi.TensorXf | None, psi: mi.TensorXf | None, lam: float, h: float = 1.0) -> mi.TensorXf:
    """Velocity of the potentials, v = λ ∇Φ + (1 − λ) ∇×Ψ (paper Eq. 3).

    Args:
        phi: scalar potential Φ, shape (D, H, W), in full-resolution cells²; None if absent.
        psi: vector potential Ψ, shape (D, H, W, 3), components (x, y, z), same unit; None if absent.
        lam: share λ of the irrotational part, in [0, 1].
        h: size of a cell in full-resolution cells, > 0.

    Returns:
        Velocity (D, H, W, 3), components (x, y, z), in full-resolution cells per frame, 0 along an axis of one cell, in
        the array kind of the input.

    Raises:
        InputError: both potentials are absent, their shapes disagree, the grid is too large to be indexed, or λ or h is
            out of range.

    Example:
        >>> import numpy as np
        >>> import tnst_mi
        >>> phi = np.arange(4.0) * np.ones((2, 3, 4))  # rises by 1 per cell along x
        >>> v = tnst_mi.velocity(phi, None, lam=0.5)
        >>> v.shape
        (2, 3, 4, 3)
        >>> v[0, 0, 0].tolist()
        [0.5, 0.0, 0.0]
    """
    if phi is not None:
        shape = tuple(phi.shape)
    elif psi is not None:
        shape = tuple(psi.shape)[:-1]
    else:
        raise InputError("velocity: both potentials are None, expected at least one")
    if len(shape) != 3 or (psi is not None and tuple(psi.shape) != (*shape, 3)):
        found = f"phi {None if phi is None else phi.shape}, psi {None if psi is None else psi.shape}"
        raise InputError(f"velocity: {found} given, expected (D, H, W) and (D, H, W, 3) on the same grid")
    if not 0.0 <= lam <= 1.0 or not h > 0.0:
        raise InputError(f"velocity: lam {lam} and h {h} given, expected 0 <= lam <= 1 and h > 0")
    require_indexable(3 * math.prod(shape), "velocity: a field")
    velocity_of = PotentialVelocity(phi, psi, float(lam), float(h))
    return dr.custom(_Velocity, velocity_of.potentials, velocity_of.source)
