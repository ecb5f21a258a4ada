"""MacCormack advection along the flow of a stationary velocity, as a Dr.Jit operation with hand-derived derivatives.

As in `maccormack`, with the ends of curved paths in place of x − v and x + v: p = φ⁻¹(x) is where the smoke comes from
and q = φ(x) where it would go (`flow_map`). The field is interpolated once, however many stages the paths have:

    f(x) = d(p(x)),   b(x) = f(q(x)),   result = f + (d − b)/2, reverted to f outside the range of the cells around p.

The conservative form multiplies the result by the determinant J of the Jacobian of φ⁻¹, which keeps ∫ d where the
velocity has a divergence.

The adjoint first finds those of p, q and log J, by the formulas of `maccormack`; `FlowMap` takes them to the velocity.
On a CPU, the limited operation traces only paths that matter. A cell with v = 0 keeps its place, so that what it sees
is known without a path: the others are traced back, if they are close enough to the smoke to see any, and those with
v = 0 beside smoke, whose derivative is not 0. Only cells that see smoke are then corrected and differentiated.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.flow_map import FlowMap
from tnst_mi.fields.grid import Cells
from tnst_mi.fields.kernels import stored
from tnst_mi.fields.maccormack import AdvectionStep, GivenVelocity, varied
from tnst_mi.fields.potentials import PotentialVelocity
from tnst_mi.fields.stencil import Trilinear
from tnst_mi.fields.sums import RepeatableSum
from tnst_mi.machine.backend import on_gpu

#: The logarithm of a volume is clamped to this, so that its exponential is finite in float32, and 0 times it is 0.
_MOST_VOLUME = 60.0


class FlowAdvection(AdvectionStep):
    """Advection of a field with `channels` values per cell (1 or 3) along the flow of a velocity over one frame."""

    def eval(
        self,
        field: mi.TensorXf,
        velocity: dict[str, mi.TensorXf],
        source: Callable[[dict[str, mi.TensorXf]], GivenVelocity | PotentialVelocity],
        method: str,
        h: float,
        outside: str,
        reverted: mi.TensorXf | None,
        field_varies: bool,
        stages: int | None,
        conservative: bool,
    ) -> mi.TensorXf:
        """The field after one frame; see `AdvectionStep.eval` for most of the arguments.

        Args:
            field, velocity, source, method, h, outside, reverted, field_varies: as there.
            stages: of every path; None to take as many as each needs, see `FlowMap.paths`.
            conservative: whether the result is multiplied by the determinant of the Jacobian of φ⁻¹.
        """
        self._keep_arguments(field, velocity, source, method, h, outside, field_varies)
        self.conservative = conservative
        limited = method == "maccormack" and reverted is None
        flow = self._flow()

        cells, active = Cells.of(self.shape), None
        sparse = limited and not field_varies
        # A GPU visits all cells, and leaves most of them at once: their number would have to be read, which stalls it.
        compressed = sparse and not on_gpu()
        if sparse:
            active = self._within_reach(cells, flow)
            if compressed:
                cells, active = _chosen(cells, active), mi.Bool(True)
            u = flow.velocity(cells)
            active &= (u.x != 0) | (u.y != 0) | (u.z != 0) | self._matters(cells, mi.Vector3f(0))
            if compressed:
                cells, active = _chosen(cells, active), None
        paths, departure = flow.trace(cells, -1, stages, active)
        departure = [stored(x) for x in departure]
        dr.eval(paths.stages, departure)
        self.forward_step = mi.Float(self.field)
        stencil = Trilinear(cells, mi.Vector3f(*departure[:3]), outside)
        for c, value in enumerate(stencil.value(stencil.read(self.field, self.channels))):
            dr.scatter(self.forward_step, value, cells.number * self.channels + c, mode=dr.ReduceMode.NoConflicts)
        if sparse:
            # The others see nothing but equal values, and therefore keep what they see.
            active = self._matters(cells, mi.Vector3f(*departure[:3]))
        if compressed:
            seen, active = _indices(active), None
            departure, paths = [dr.gather(mi.Float, x, seen) for x in departure], paths.chosen(seen)
            cells, self.chosen = paths.cells, paths.cells.chosen
        elif active is not None:
            paths = paths.only(active)
        there, arrival = flow.trace(cells, 1, stages, active) if self.corrected else (paths, departure)
        #: Along −v and along v: the paths of the chosen cells, and where they end, in cells from their start.
        self.paths = paths, there
        self.ends = mi.Vector3f(*departure[:3]), mi.Vector3f(*arrival[:3])
        self.log_volume = dr.clip(departure[3], -_MOST_VOLUME, _MOST_VOLUME) if conservative else None
        dr.eval(self.forward_step, [path.stages for path in self.paths], self.ends, self.log_volume, self.chosen)

        result = self._corrected_step(limited, reverted) if self.corrected else mi.Float(self.forward_step)
        if self.log_volume is not None:
            plain, result = result, mi.Float(result)
            for c, value in enumerate(self._scaled(cells.own(plain, self.channels))):
                dr.scatter(result, value, cells.number * self.channels + c, mode=dr.ReduceMode.NoConflicts)
            self.result = result
            dr.eval(result)
        return mi.TensorXf(result, self.tensor_shape)

    def _flow(self) -> FlowMap:
        return FlowMap(self.velocity.at(Cells.of(self.shape)), self.h, self.shape, self.conservative)

    def _within_reach(self, cells: Cells, flow: FlowMap) -> mi.Bool:
        """Whether a path of the largest velocity could end beside a value other than 0: inside a box, at least."""
        longest, filled = dr.max(dr.norm(flow.velocity(cells))), mi.Bool(False)
        for value in cells.own(self.field, self.channels):
            filled |= value != 0
        # Bounded, so that it fits an integer.
        filled, reach = stored(filled), mi.Int32(dr.minimum(dr.ceil(longest), 2.0**24)) + 1
        within = mi.Bool(True)
        for here, size in zip((cells.x, cells.y, cells.z), cells.size, strict=True):
            first, last = dr.min(dr.select(filled, here, size)), dr.max(dr.select(filled, here, -1))
            within &= (here >= first - reach) & (here <= last + reach)
        return within

    def _matters(self, cells: Cells, offset: mi.Vector3f) -> mi.Bool:
        """Whether the result at the end of a path, or its derivative, is anything but the value at any of its cells."""
        corners = Trilinear(cells, offset, self.outside).read(self.field, self.channels)
        if not self.conservative:
            return varied(corners)
        smoky = mi.Bool(False)
        for corner in corners:
            for value in corner:
                smoky |= value != 0
        return smoky

    def _stencils(self, cells: Cells) -> tuple[Trilinear, Trilinear]:
        """The stencils around p and q."""
        departure, arrival = self.ends
        return Trilinear(cells, departure, self.outside), Trilinear(cells, arrival, self.outside)

    def _scaled(self, values: list[mi.Float]) -> list[mi.Float]:
        """Values of the chosen cells times J."""
        if self.log_volume is None:
            return values
        volume = dr.exp(self.log_volume)
        return [value * volume for value in values]

    def _moved(self, cells: Cells, sign: int) -> mi.Vector3f:
        """The tangent of p or q; that of log J is kept aside."""
        change = self.source(self.grad_in("velocity")).at(Cells.of(self.shape))
        moved = [stored(x) for x in self._flow().tangent(self.paths[sign > 0], change)]
        dr.eval(moved)
        if sign < 0 and self.conservative:
            self.log_volume_tangent = dr.select(dr.abs(self.log_volume) < _MOST_VOLUME, moved[3], 0)
        return mi.Vector3f(*moved[:3])

    def _tangent(self) -> mi.Float:
        tangent = super()._tangent()
        if not self.conservative:
            return tangent
        cells = Cells.of(self.shape, self.chosen)
        total = dr.zeros(mi.Float, dr.width(tangent))
        scaled, result = self._scaled(cells.own(tangent, self.channels)), cells.own(self.result, self.channels)
        for c, (x, value) in enumerate(zip(scaled, result, strict=True)):
            slot = cells.number * self.channels + c
            dr.scatter(total, x + value * self.log_volume_tangent, slot, mode=dr.ReduceMode.NoConflicts)
        return total

    def backward(self) -> None:
        """The adjoints of the field and of the velocity's arrays from the adjoint of the result."""
        g = self.grad_out().array
        if self.conservative:
            dr.eval(g)
            cells = Cells.of(self.shape, self.chosen)
            own, result = cells.own(g, self.channels), cells.own(self.result, self.channels)
            change = sum((x * y for x, y in zip(own, result, strict=True)), mi.Float(0))
            self.on_log_volume = stored(dr.select(dr.abs(self.log_volume) < _MOST_VOLUME, change, 0))
            g = dr.zeros(mi.Float, dr.width(g))
            for c, value in enumerate(self._scaled(own)):
                dr.scatter(g, value, cells.number * self.channels + c, mode=dr.ReduceMode.NoConflicts)
            dr.eval(g, self.on_log_volume)
        self._pull_back(g)

    def _set_velocity_gradient(
        self, g: mi.Float, cells: Cells, on_backward_step: list[mi.Float], scattered: RepeatableSum | None
    ) -> None:
        departure, arrival = self._stencils(cells)
        on_departure, on_arrival = mi.Vector3f(0), mi.Vector3f(0)
        slopes = departure.gradient(departure.read(self.field, self.channels))
        for c, (slope, value) in enumerate(zip(slopes, cells.own(g, self.channels), strict=True)):
            returned = 0 if scattered is None else scattered.at(cells.number * self.channels + c)
            on_departure += slope * (value + returned)
        adjoints = [[*on_departure, *([self.on_log_volume] if self.conservative else [])]]
        if self.corrected:
            slopes = arrival.gradient(arrival.read(self.forward_step, self.channels))
            for slope, value in zip(slopes, on_backward_step, strict=True):
                on_arrival += slope * value
            adjoints.append([*on_arrival, *([mi.Float(0)] if self.conservative else [])])
        adjoints = [[stored(x) for x in adjoint] for adjoint in adjoints]
        dr.eval(adjoints)
        of_velocity = self._flow().pull_back(list(zip(self.paths, adjoints, strict=False)))
        self.set_grad_in("velocity", self.velocity.transpose(of_velocity))

    def name(self) -> str:
        """The name in Dr.Jit's messages."""
        return "advection along a flow"


def _chosen(cells: Cells, active: mi.Bool) -> Cells:
    """The active ones of some cells."""
    return Cells.of(cells.shape, dr.gather(mi.UInt32, cells.number, _indices(active)))


def _indices(chosen: mi.Bool) -> mi.UInt32:
    """Where an array is true; 0 if it is nowhere, since kernels need a size."""
    indices = dr.compress(stored(chosen))
    return indices if dr.width(indices) else mi.UInt32(0)
