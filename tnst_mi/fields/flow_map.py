"""The flow of a stationary velocity over one frame: where each particle goes and where it came from.

A particle that starts at a cell's centre follows dx/dt = ±u(x), with u in cells per frame, trilinear between the cells
and constant beyond the outermost ones. The time of one frame is divided into n equal stages of Ralston's third-order
Runge–Kutta method (1962):

    k1 = u(x),   k2 = u(x + Δt k1 / 2),   k3 = u(x + 3 Δt k2 / 4),   x ← x + Δt (2 k1 + 3 k2 + 4 k3) / 9.

Per evaluation of u it is more accurate here than the midpoint method, and no less than the classical one of fourth
order, for which an interpolated velocity is not smooth enough (docs/transport.md). The divergence of u, integrated
along with the position, is the logarithm of the determinant of the map's Jacobian (Liouville's formula). What is
integrated is called the rates here: the three components of u and, with volume, its divergence.

Derivatives are those of the discrete trace, its number of stages held fixed. Backwards, a path is traced again, noting
where its stages start; these are then visited from the last to the first, and each adds the adjoints of its three
evaluations to the cells that were interpolated. A path's few numbers stay in the local memory of its thread.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.grid import Cells, Shape
from tnst_mi.fields.kernels import opaque, opaque_int, stored
from tnst_mi.fields.potentials import AxisDifference
from tnst_mi.fields.stencil import Trilinear
from tnst_mi.fields.sums import RepeatableSum, largest_magnitude

#: A stage of "auto" crosses about this many cells at most, as long as a path has no more than `AUTO_STAGES`.
CELLS_PER_STAGE = 3.0
AUTO_STAGES = 32

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


@dataclass(frozen=True)
class Paths:
    """The paths from some cells, with the flow or against it.

    Attributes:
        cells: where they start.
        sign: 1 along u, -1 along −u.
        stages: number of stages of each path, or of all; a path without any ends where it starts.
    """

    cells: Cells
    sign: int
    stages: mi.UInt32

    @property
    def step(self) -> mi.Float:
        """The length of a stage in frames, with the sign."""
        return opaque(float(self.sign)) / mi.Float(dr.maximum(self.stages, 1))

    def chosen(self, indices: mi.UInt32) -> Paths:
        """Those with the given numbers."""
        cells = Cells.of(self.cells.shape, dr.gather(mi.UInt32, self.cells.number, indices))
        each = dr.width(self.stages) > 1
        return Paths(cells, self.sign, dr.gather(mi.UInt32, self.stages, indices) if each else self.stages)

    def only(self, active: mi.Bool) -> Paths:
        """The same, without stages where not active."""
        return Paths(self.cells, self.sign, dr.select(active, self.stages, 0))


class FlowMap:
    """The maps x → x(1) along u and against u.

    Args:
        v: velocity at all cells, in full-resolution cells per frame.
        h: size of a cell in full-resolution cells; u is v / h.
        shape: (D, H, W).
        with_volume: whether the divergence is integrated too.
    """

    def __init__(self, v: mi.Vector3f, h: float, shape: Shape, with_volume: bool) -> None:
        self.shape, self.channels, self._per_cell = shape, 4 if with_volume else 3, dr.rcp(opaque(h))
        self._rates = _rates(v * self._per_cell, shape, with_volume)
        dr.eval(self._rates)

    def velocity(self, cells: Cells) -> mi.Vector3f:
        """u at some cells."""
        return mi.Vector3f(*cells.own(self._rates, self.channels)[:3])

    def trace(
        self, cells: Cells, sign: int, stages: int | None, active: mi.Bool | None = None
    ) -> tuple[Paths, list[mi.Float]]:
        """The paths from some cells, and the end of each: its displacement (x, y, z) in cells.

        With volume, that is followed by the logarithm of the determinant of the map's Jacobian.

        Args:
            cells: where they start.
            sign: 1 along u, -1 along −u.
            stages: number of stages of all paths, from 1 to `MOST_STAGES`. If None, each path has its own: the largest
                |u| that a trial in a single stage meets, over `CELLS_PER_STAGE`, rounded up to 1 to `AUTO_STAGES`.
            active: which paths are traced; the others have no stages and end where they start. None traces all.
        """
        tried = stages is None
        count = mi.UInt32(opaque_int(1 if tried else stages))
        if active is not None:
            count = dr.select(active, count, 0)
        direction = opaque(float(sign))

        def stage(
            k: mi.UInt32, count: mi.UInt32, state: list[mi.Float], trial: mi.Bool
        ) -> tuple[mi.UInt32, mi.UInt32, list[mi.Float], mi.Bool]:
            step = direction / mi.Float(count)
            evaluations = self._evaluations(cells, state, step)
            k, state = k + 1, _after(state, evaluations, step)
            if not tried:
                return k, count, state, trial
            # The trial is the path itself where a single stage is enough; the others begin anew.
            needed = _stages_needed(evaluations)
            again = trial & (needed > 1)
            state = [dr.select(again, 0, x) for x in state]
            return dr.select(again, 0, k), dr.select(again, needed, count), state, mi.Bool(False)

        _, count, state, _ = dr.while_loop(
            (mi.UInt32(0), count, self._start(cells), mi.Bool(tried)),
            lambda k, count, state, trial: k < count,
            stage,
            labels=("k", "count", "state", "trial"),
        )
        return Paths(cells, sign, count), state

    def tangent(self, paths: Paths, change: mi.Vector3f) -> list[mi.Float]:
        """The derivative of `trace` along a change of v, given at all cells."""
        change_of_rates = _rates(change * self._per_cell, self.shape, self.channels == 4)
        dr.eval(change_of_rates)
        step = paths.step

        def stage(
            k: mi.UInt32, state: list[mi.Float], tangent: list[mi.Float]
        ) -> tuple[mi.UInt32, list[mi.Float], list[mi.Float]]:
            evaluations = self._evaluations(paths.cells, state, step)
            moved, after = [mi.Float(0)] * self.channels, list(tangent)
            for node, weight, (stencil, corners, _) in zip(_NODES, _WEIGHTS, evaluations, strict=True):
                position = mi.Vector3f(*(t + node * step * m for t, m in zip(tangent[:3], moved[:3], strict=True)))
                changed = stencil.value(stencil.read(change_of_rates, self.channels))
                slopes = stencil.gradient(corners)
                moved = [c + dr.dot(slope, position) for c, slope in zip(changed, slopes, strict=True)]
                after = [a + weight * step * m for a, m in zip(after, moved, strict=True)]
            return k + 1, _after(state, evaluations, step), after

        _, _, tangent = dr.while_loop(
            (mi.UInt32(0), self._start(paths.cells), self._start(paths.cells)),
            lambda k, state, tangent: k < paths.stages,
            stage,
            labels=("k", "state", "tangent"),
        )
        return tangent

    def pull_back(self, adjoints: Sequence[tuple[Paths, list[mi.Float]]]) -> mi.Vector3f:
        """The adjoint of v at all cells, one array in memory per component.

        Args:
            adjoints: paths, each with the adjoint of what `trace` returned.
        """
        # The unit of the sums must be known before anything is added, so how much each path adds in all is found first.
        # It grows along the path where the flow stretches, without a useful bound. Finding it only gathers, which takes
        # a third of the time of adding.
        largest = mi.Float(0)
        for paths, adjoint in adjoints:
            largest = dr.maximum(largest, largest_magnitude(self._visit_backwards(paths, adjoint, None)))
        total = RepeatableSum(self.channels * math.prod(self.shape), largest, len(adjoints) * math.prod(self.shape))
        for paths, adjoint in adjoints:
            self._visit_backwards(paths, adjoint, total)
        return _transposed_rates(total, self.shape, self.channels, self._per_cell)

    def _visit_backwards(self, paths: Paths, adjoint: list[mi.Float], total: RepeatableSum | None) -> mi.Float:
        """Add the adjoints of all evaluations to `total`, if there is one; by path, the sum of their magnitudes."""
        cells, step = paths.cells, paths.step
        starts = dr.alloc_local(mi.Vector3f, MOST_STAGES)
        starts[0] = dr.zeros(mi.Vector3f, dr.width(cells.x))

        def stage(k: mi.UInt32, state: list[mi.Float], starts: dr.Local) -> tuple[mi.UInt32, list[mi.Float], dr.Local]:
            state = _after(state, self._evaluations(cells, state, step), step)
            starts[k] = mi.Vector3f(*state[:3])
            return k + 1, state, starts

        _, _, starts = dr.while_loop(
            (mi.UInt32(1), self._start(cells), starts),
            lambda k, state, starts: k < paths.stages,
            stage,
            labels=("k", "state", "starts"),
        )

        def stage_back(
            k: mi.UInt32, adjoint: list[mi.Float], added: mi.Float, starts: dr.Local
        ) -> tuple[mi.UInt32, list[mi.Float], mi.Float, dr.Local]:
            k = k - 1
            evaluations = self._evaluations(cells, list(starts[k]), step)
            before, returned = list(adjoint), mi.Vector3f(0)
            waiting: tuple[Trilinear, list[list[mi.Float]]] | None = None
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
                    waiting = stencil, _merged(stencil, stencil.shares(of_rate), waiting, total)
            if waiting is not None and total is not None:
                waiting[0].add(total, waiting[1])
            return k, before, added, starts

        _, _, added, _ = dr.while_loop(
            (mi.UInt32(paths.stages), list(adjoint), dr.zeros(mi.Float, dr.width(cells.x)), starts),
            lambda k, adjoint, added, starts: k > 0,
            stage_back,
            labels=("k", "adjoint", "added", "starts"),
        )
        dr.eval(added if total is None else total.total)
        return added

    def _start(self, cells: Cells) -> list[mi.Float]:
        return [dr.zeros(mi.Float, dr.width(cells.x)) for _ in range(self.channels)]

    def _evaluations(self, cells: Cells, state: list[mi.Float], step: mi.Float) -> list[_Evaluation]:
        """The three evaluations of a stage."""
        rates, found = [mi.Float(0)] * 3, []
        for node in _NODES:
            offset = mi.Vector3f(*(x + node * step * k for x, k in zip(state[:3], rates[:3], strict=True)))
            stencil = Trilinear(cells, offset, "edge")
            corners = stencil.read(self._rates, self.channels)
            rates = stencil.value(corners)
            found.append(_Evaluation(stencil, corners, rates))
        return found


def _after(state: list[mi.Float], evaluations: list[_Evaluation], step: mi.Float) -> list[mi.Float]:
    """The state after a stage."""
    for weight, evaluation in zip(_WEIGHTS, evaluations, strict=True):
        state = [x + weight * step * k for x, k in zip(state, evaluation.rates, strict=True)]
    return state


def _stages_needed(evaluations: list[_Evaluation]) -> mi.UInt32:
    """The stages of "auto" for a path that meets these rates in a single one."""
    fastest = mi.Float(0)
    for evaluation in evaluations:
        fastest = dr.maximum(fastest, dr.norm(mi.Vector3f(*evaluation.rates[:3])))
    # Clipped before and after it becomes an integer: any velocity, finite or not, gives a number of stages.
    return mi.UInt32(dr.clip(mi.Int32(dr.minimum(dr.ceil(fastest / CELLS_PER_STAGE), AUTO_STAGES)), 1, AUTO_STAGES))


def _merged(
    stencil: Trilinear,
    shares: list[list[mi.Float]],
    waiting: tuple[Trilinear, list[list[mi.Float]]] | None,
    total: RepeatableSum,
) -> list[list[mi.Float]]:
    """The shares of the cells around, with those that wait to be added to the same cells; others are added now.

    Neighbouring evaluations often lie between the same cells, and an addition is ten times as slow as a reading.
    """
    if waiting is None:
        return shares
    earlier, values = waiting
    same = dr.all(stencil.steps == earlier.steps)
    earlier.add(total, values, ~same)
    return [
        [own + dr.select(same, other, 0) for own, other in zip(mine, others, strict=True)]
        for mine, others in zip(shares, values, strict=True)
    ]


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
