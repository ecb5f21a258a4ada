"""The flow of a stationary velocity over one frame: where each particle goes and where it came from.

A particle that starts at a cell's centre follows dx/dt = ±u(x), with u in cells per frame, trilinear between the cells
and constant beyond the outermost ones. The time of one frame is divided into n equal stages of Ralston's third-order
Runge–Kutta method (1962), which takes three evaluations and holds one of them at a time:

    k1 = u(x),   k2 = u(x + Δt k1 / 2),   k3 = u(x + 3 Δt k2 / 4),   x ← x + Δt (2 k1 + 3 k2 + 4 k3) / 9.

The divergence of u, integrated along with the position, is the logarithm of the determinant of the map's Jacobian
(Liouville's formula). What is integrated is called the rates here: the three components of u and, if asked for, its
divergence.

Derivatives are those of the discrete trace. Backwards, a cell's path is traced again, the positions at which its stages
start are kept in the registers' local memory, and the stages are then visited from the last to the first: each adds the
adjoints of its three evaluations to the cells that these interpolated between.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.grid import Cells, Shape
from tnst_mi.fields.kernels import opaque, opaque_int, stored
from tnst_mi.fields.potentials import AxisDifference
from tnst_mi.fields.stencil import Trilinear
from tnst_mi.fields.sums import RepeatableSum, largest_magnitude

#: A stage of "auto" crosses about this many cells at most, as long as there are no more than `AUTO_STAGES`.
CELLS_PER_STAGE = 6.0
AUTO_STAGES = 16

#: Each path has room for the starts of this many stages.
MOST_STAGES = 64

#: Ralston's method: the share of Δt at which each rate is evaluated, and its weight in the sum.
_NODES = (0.0, 1 / 2, 3 / 4)
_WEIGHTS = (2 / 9, 3 / 9, 4 / 9)


class _Evaluation(NamedTuple):
    """Where the rates are evaluated, those of the eight cells around, and those interpolated between them."""

    stencil: Trilinear
    corners: list[list[mi.Float]]
    rates: list[mi.Float]


class FlowMap:
    """The maps x → x(1) along u and against u.

    Args:
        v: velocity at all cells, in full-resolution cells per frame.
        h: size of a cell in full-resolution cells; u is v / h.
        shape: (D, H, W).
        stages: number of stages n from 1 to `MOST_STAGES`; None for ⌈max |u| / `CELLS_PER_STAGE`⌉, from 1 to
            `AUTO_STAGES`. It is found on the device and stays there.
        with_volume: whether the divergence is integrated too.
    """

    def __init__(self, v: mi.Vector3f, h: float, shape: Shape, stages: int | None, with_volume: bool) -> None:
        self.shape, self.channels, self._per_cell = shape, 4 if with_volume else 3, dr.rcp(opaque(h))
        self._rates = _rates(v * self._per_cell, shape, with_volume)
        dr.eval(self._rates)
        if stages is None:
            fastest = dr.max(dr.norm(self.velocity(Cells.of(shape))))
            # Clipped as integers, so that even a velocity that is not finite gives a number of stages.
            self._stages = mi.UInt32(dr.clip(mi.Int32(dr.ceil(fastest / CELLS_PER_STAGE)), 1, AUTO_STAGES))
            dr.eval(self._stages)
        else:
            self._stages = mi.UInt32(opaque_int(stages))

    def velocity(self, cells: Cells) -> mi.Vector3f:
        """u at some cells."""
        return mi.Vector3f(*cells.own(self._rates, self.channels)[:3])

    def trace(self, cells: Cells, sign: int) -> list[mi.Float]:
        """The end of each cell's path along `sign` · u: the displacement (x, y, z) in cells.

        With volume, it is followed by the logarithm of the determinant of the map's Jacobian.
        """

        def stage(k: mi.UInt32, state: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
            return k + 1, self._next(state, self._evaluations(cells, state, sign), sign)

        _, state = dr.while_loop((mi.UInt32(0), self._start(cells)), self._unfinished, stage, labels=("k", "state"))
        return state

    def tangent(self, cells: Cells, sign: int, change: mi.Vector3f) -> list[mi.Float]:
        """The derivative of `trace` along a change of v, given at all cells."""
        change_of_rates = _rates(change * self._per_cell, self.shape, self.channels == 4)
        dr.eval(change_of_rates)
        step = self._time_step(sign)

        def stage(
            k: mi.UInt32, state: list[mi.Float], tangent: list[mi.Float]
        ) -> tuple[mi.UInt32, list[mi.Float], list[mi.Float]]:
            evaluations = self._evaluations(cells, state, sign)
            moved, after = [mi.Float(0)] * self.channels, list(tangent)
            for node, weight, (stencil, corners, _) in zip(_NODES, _WEIGHTS, evaluations, strict=True):
                position = mi.Vector3f(*(t + node * step * m for t, m in zip(tangent[:3], moved[:3], strict=True)))
                changed = stencil.value(stencil.read(change_of_rates, self.channels))
                slopes = stencil.gradient(corners)
                moved = [c + dr.dot(slope, position) for c, slope in zip(changed, slopes, strict=True)]
                after = [a + weight * step * m for a, m in zip(after, moved, strict=True)]
            return k + 1, self._next(state, evaluations, sign), after

        loop = (mi.UInt32(0), self._start(cells), self._start(cells))
        _, _, tangent = dr.while_loop(loop, self._unfinished, stage, labels=("k", "state", "tangent"))
        return tangent

    def pull_back(self, cells: Cells, adjoints: Sequence[tuple[int, list[mi.Float]]]) -> mi.Vector3f:
        """The adjoint of v at all cells, one array in memory per component.

        Args:
            cells: those that were traced.
            adjoints: for each sign that they were traced with, the adjoint of what `trace` returned.
        """
        # The unit of the sums must be known before anything is added: how much a path adds in all is found first. It
        # grows along the path where the flow stretches, without a useful bound. Gathering costs little: adding takes
        # ten times as long.
        largest = mi.Float(0)
        for sign, adjoint in adjoints:
            largest = dr.maximum(largest, largest_magnitude(self._visit_backwards(cells, sign, adjoint, None)))
        total = RepeatableSum(self.channels * math.prod(self.shape), largest, len(adjoints) * math.prod(self.shape))
        for sign, adjoint in adjoints:
            self._visit_backwards(cells, sign, adjoint, total)
        return _transposed_rates(total, self.shape, self.channels, self._per_cell)

    def _visit_backwards(
        self, cells: Cells, sign: int, adjoint: list[mi.Float], total: RepeatableSum | None
    ) -> mi.Float:
        """Add the adjoints of all evaluations to `total`, if there is one; by path, the sum of their magnitudes."""
        starts, step = dr.alloc_local(mi.Vector3f, MOST_STAGES), self._time_step(sign)

        def stage(k: mi.UInt32, state: list[mi.Float], starts: dr.Local) -> tuple[mi.UInt32, list[mi.Float], dr.Local]:
            starts[k] = mi.Vector3f(*state[:3])
            return k + 1, self._next(state, self._evaluations(cells, state, sign), sign), starts

        loop = (mi.UInt32(0), self._start(cells), starts)
        k, _, starts = dr.while_loop(
            loop, lambda k, state, starts: self._unfinished(k), stage, labels=("k", "state", "starts")
        )

        def stage_back(
            k: mi.UInt32, adjoint: list[mi.Float], added: mi.Float, starts: dr.Local
        ) -> tuple[mi.UInt32, list[mi.Float], mi.Float, dr.Local]:
            k = k - 1
            evaluations = self._evaluations(cells, list(starts[k]), sign)
            before, returned = list(adjoint), mi.Vector3f(0)
            for i in reversed(range(3)):
                stencil, corners, _ = evaluations[i]
                of_rate = [_WEIGHTS[i] * step * a for a in adjoint]
                if i < 2:
                    of_rate[:3] = [r + _NODES[i + 1] * step * b for r, b in zip(of_rate[:3], returned, strict=True)]
                returned = mi.Vector3f(0)
                for value, slope in zip(of_rate, stencil.gradient(corners), strict=True):
                    returned = returned + value * slope
                before[:3] = [b + r for b, r in zip(before[:3], returned, strict=True)]
                if total is None:
                    for value in of_rate:
                        added = added + dr.abs(value)
                else:
                    stencil.splat(total, of_rate)
            return k, before, added, starts

        _, _, added, _ = dr.while_loop(
            (k, list(adjoint), dr.zeros(mi.Float, dr.width(cells.x)), starts),
            lambda k, adjoint, added, starts: k > 0,
            stage_back,
            labels=("k", "adjoint", "added", "starts"),
        )
        if total is None:
            dr.eval(added)
        else:
            dr.eval(total.total)
        return added

    def _start(self, cells: Cells) -> list[mi.Float]:
        return [dr.zeros(mi.Float, dr.width(cells.x)) for _ in range(self.channels)]

    def _unfinished(self, k: mi.UInt32, *state: object) -> mi.Bool:
        return k < self._stages

    def _time_step(self, sign: int) -> mi.Float:
        return opaque(float(sign)) / mi.Float(self._stages)

    def _evaluations(self, cells: Cells, state: list[mi.Float], sign: int) -> list[_Evaluation]:
        """The three evaluations of a stage."""
        step, rates, found = self._time_step(sign), [mi.Float(0)] * 3, []
        for node in _NODES:
            offset = mi.Vector3f(*(x + node * step * k for x, k in zip(state[:3], rates[:3], strict=True)))
            stencil = Trilinear(cells, offset, "edge")
            corners = stencil.read(self._rates, self.channels)
            rates = stencil.value(corners)
            found.append(_Evaluation(stencil, corners, rates))
        return found

    def _next(self, state: list[mi.Float], evaluations: list[_Evaluation], sign: int) -> list[mi.Float]:
        """The state after a stage."""
        step = self._time_step(sign)
        for weight, evaluation in zip(_WEIGHTS, evaluations, strict=True):
            state = [x + weight * step * k for x, k in zip(state, evaluation.rates, strict=True)]
        return state


def _rates(u: mi.Vector3f, shape: Shape, with_volume: bool) -> mi.Float:
    """The rates at all cells, those of a cell next to each other: u and, with volume, its divergence."""
    components = dr.ravel(u)
    if not with_volume:
        return components
    dr.eval(components)
    cells, divergence = Cells.of(shape), mi.Float(0)
    for axis in range(3):
        divergence = divergence + AxisDifference(cells, axis, mi.Float(1)).apply(components, 3, axis)
    return dr.ravel(mi.Vector4f(*dr.unravel(mi.Vector3f, components), divergence))


def _transposed_rates(total: RepeatableSum, shape: Shape, channels: int, factor: mi.Float) -> mi.Vector3f:
    """The transpose of `_rates` times a factor, one array in memory per component."""
    cells = Cells.of(shape)
    result = mi.Vector3f(*(total.at(cells.number * channels + c) for c in range(3)))
    if channels == 4:
        of_divergence = stored(total.at(cells.number * channels + 3))
        dr.eval(of_divergence)
        result += mi.Vector3f(*(AxisDifference(cells, axis, mi.Float(1)).transpose(of_divergence) for axis in range(3)))
    result = mi.Vector3f(*(stored(component * factor) for component in result))
    dr.eval(result)
    return result
