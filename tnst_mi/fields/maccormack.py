"""One step of semi-Lagrangian or MacCormack advection as a Dr.Jit operation with hand-derived derivatives.

Semi-Lagrangian:  f(x) = d(x − v(x)), one Euler back-trace, trilinear.
MacCormack:       b(x) = f(x + v(x)),  result = f + (d − b)/2, reverted to f where that leaves the range of the eight
                  cells around the departure point x − v (Selle et al. 2008).

With w = 0 where the result is reverted and 1 elsewhere, and g = ∂L/∂result, the adjoint is

    ∂L/∂b = −w g/2,    ∂L/∂f = g + Bᵀ ∂L/∂b,    ∂L/∂v = ∇f(x + v) ∂L/∂b − ∇d(x − v) ∂L/∂f,
    ∂L/∂d = w g/2 + Fᵀ ∂L/∂f,

where F and B interpolate at x − v and x + v. It needs one scatter, Bᵀ, and a second one if the field is differentiated;
everything else is local to a cell. The limiter is a switch: its choice is held fixed when differentiating.

Where the eight cells around x − v are equal, as in all the air around the smoke, the range has zero width: the result
is f for any v, so the correction and the derivative with respect to v can be skipped. Once f is known, the limited step
therefore skips these cells, unless the field is differentiated too; on a CPU it is launched for the others only.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.grid import Cells
from tnst_mi.fields.kernels import opaque, stored
from tnst_mi.fields.potentials import PotentialVelocity
from tnst_mi.fields.stencil import Trilinear
from tnst_mi.fields.sums import RepeatableSum, largest_magnitude
from tnst_mi.machine.backend import on_gpu


def interleaved(components: list[mi.Float]) -> mi.Float:
    """Flat array with the channels of a cell next to each other, written at the next evaluation."""
    return stored(components[0]) if len(components) == 1 else dr.ravel(mi.Vector3f(*components))


@dataclass(frozen=True)
class GivenVelocity:
    """A velocity stored in memory, with the interface of `PotentialVelocity`."""

    v: mi.TensorXf

    def at(self, cells: Cells) -> mi.Vector3f:
        """v at some cells."""
        return mi.Vector3f(*cells.own(self.v.array, 3))

    def transpose(self, g: mi.Vector3f) -> dict[str, mi.TensorXf]:
        """∂L/∂v under the name of the stored array."""
        return {"v": mi.TensorXf(dr.ravel(g), tuple(self.v.shape))}


class AdvectionStep(dr.CustomOp):
    """One advection step of a field with `channels` values per cell (1 or 3)."""

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
    ) -> mi.TensorXf:
        """The field after the step; see `tnst_mi.fields.advection.step` for most of the arguments.

        Args:
            field: (D, H, W) or (D, H, W, 3).
            velocity: the arrays that define the velocity, by name.
            source: builds the velocity from them.
            method: one of `METHODS`.
            h: size of a cell in full-resolution cells.
            outside: "zero" or "edge".
            reverted: 1 where the result is reverted, 0 elsewhere; None to let the limiter decide.
            field_varies: whether the field is differentiated too.
        """
        self._keep_arguments(field, velocity, source, method, h, outside, field_varies)
        departure, _ = self._stencils(Cells.of(self.shape))
        corners = departure.read(self.field, self.channels)
        self.forward_step = interleaved(departure.value(corners))
        limited = method == "maccormack" and reverted is None
        # A GPU processes all cells: the number of the others would have to be read back, which stalls it.
        if limited and not field_varies and not on_gpu():
            self.chosen = dr.compress(stored(varied(corners)))
            if dr.width(self.chosen) == 0:
                self.chosen, self.corrected = None, False
        dr.eval(self.forward_step)
        if not self.corrected:
            return mi.TensorXf(mi.Float(self.forward_step), self.tensor_shape)

        return mi.TensorXf(self._corrected_step(limited, reverted), self.tensor_shape)

    def _keep_arguments(
        self,
        field: mi.TensorXf,
        velocity: dict[str, mi.TensorXf],
        source: Callable[[dict[str, mi.TensorXf]], GivenVelocity | PotentialVelocity],
        method: str,
        h: float,
        outside: str,
        field_varies: bool,
    ) -> None:
        self.outside, self.h, self.field_varies = outside, h, field_varies
        self.tensor_shape = tuple(field.shape)
        self.shape, self.channels = self.tensor_shape[:3], math.prod(self.tensor_shape[3:])
        self.corrected = method != "semi_lagrangian"
        self.field, self.source, self.velocity = field.array, source, source(velocity)
        #: Storage indices of the cells that the correction and ∂/∂v are computed for; None for all of them.
        self.chosen: mi.UInt32 | None = None
        #: By channel, which of them keep the corrected value; None if all do.
        self.kept: list[mi.Bool] | None = None

    def _corrected_step(self, limited: bool, reverted: mi.TensorXf | None) -> mi.Float:
        """The result, from the forward step in memory; keeps which cells are corrected."""
        cells = Cells.of(self.shape, self.chosen)
        departure, arrival = self._stencils(cells)
        corners = departure.read(self.field, self.channels)
        backward = arrival.value(arrival.read(self.forward_step, self.channels))
        f, d = cells.own(self.forward_step, self.channels), cells.own(self.field, self.channels)
        result, kept = mi.Float(self.forward_step), []
        for c in range(self.channels):
            value = f[c] + 0.5 * (d[c] - backward[c])
            slot = cells.number * self.channels + c
            keep = mi.Bool(True)
            if limited:
                low, high = value_range([corner[c] for corner in corners])
                keep = (value >= low) & (value <= high)
                if not self.field_varies:
                    keep &= varied(corners)
            elif reverted is not None:
                keep = dr.gather(mi.Float, reverted.array, slot) == 0
            dr.scatter(result, value, slot, keep, dr.ReduceMode.NoConflicts)
            kept.append(keep)
        if limited or reverted is not None:
            self.kept = [stored(keep) for keep in kept]
        dr.eval(result, self.kept)
        return result

    def _stencils(self, cells: Cells) -> tuple[Trilinear, Trilinear]:
        """The stencils around x − v and x + v."""
        displacement = self.velocity.at(cells) * dr.rcp(opaque(self.h))
        return Trilinear(cells, -displacement, self.outside), Trilinear(cells, displacement, self.outside)

    def _keep(self, values: list[mi.Float]) -> list[mi.Float]:
        """Values where the correction is kept, 0 elsewhere."""
        if self.kept is None:
            return values
        return [dr.select(keep, value, 0) for keep, value in zip(self.kept, values, strict=True)]

    def forward(self) -> None:
        """The tangent of the result from the tangents of the field and of the velocity's arrays."""
        self.set_grad_out(mi.TensorXf(self._tangent(), self.tensor_shape))

    def _moved(self, cells: Cells, sign: int) -> mi.Vector3f:
        """The tangent of where the path of each cell ends, x − v or x + v."""
        return self.source(self.grad_in("velocity")).at(cells) * (sign * dr.rcp(opaque(self.h)))

    def _tangent(self) -> mi.Float:
        field_tangent, cells = self.grad_in("field").array, Cells.of(self.shape, self.chosen)
        departure, arrival = self._stencils(cells)

        def carried(stencil: Trilinear, values: mi.Float, tangent: mi.Float, sign: int) -> list[mi.Float]:
            """Derivative of the values interpolated at the end of a path."""
            moved = self._moved(cells, sign)
            slopes = stencil.gradient(stencil.read(values, self.channels))
            interpolated = stencil.value(stencil.read(tangent, self.channels))
            return [value + dr.dot(slope, moved) for value, slope in zip(interpolated, slopes, strict=True)]

        # Where only some cells are computed, the field has no tangent, and the result none in the others.
        forward_tangent = dr.zeros(mi.Float, dr.width(self.field))
        for c, value in enumerate(carried(departure, self.field, field_tangent, -1)):
            dr.scatter(forward_tangent, value, cells.number * self.channels + c, mode=dr.ReduceMode.NoConflicts)
        dr.eval(forward_tangent)
        if not self.corrected:
            return forward_tangent
        b = carried(arrival, self.forward_step, forward_tangent, 1)
        d = cells.own(field_tangent, self.channels)
        result = mi.Float(forward_tangent)
        for c, correction in enumerate(self._keep([0.5 * (x - y) for x, y in zip(d, b, strict=True)])):
            slot = cells.number * self.channels + c
            value = dr.gather(mi.Float, forward_tangent, slot) + correction
            dr.scatter(result, value, slot, mode=dr.ReduceMode.NoConflicts)
        return result

    def backward(self) -> None:
        """The adjoints of the field and of the velocity's arrays from the adjoint of the result."""
        self._pull_back(self.grad_out().array)

    def _pull_back(self, g: mi.Float) -> None:
        dr.eval(g)
        on_backward_step: list[mi.Float] = []
        scattered: RepeatableSum | None = None
        cells = Cells.of(self.shape, self.chosen)
        if self.corrected:
            _, arrival = self._stencils(cells)
            on_backward_step = [stored(v) for v in self._keep([-0.5 * v for v in cells.own(g, self.channels)])]
            scattered = RepeatableSum(dr.width(self.field), largest_of(on_backward_step), 8 * math.prod(self.shape))
            arrival.splat(scattered, on_backward_step)
        self._set_velocity_gradient(g, cells, on_backward_step, scattered)
        if self.field_varies:
            self._set_field_gradient(g, cells, on_backward_step, scattered)

    def _set_velocity_gradient(
        self, g: mi.Float, cells: Cells, on_backward_step: list[mi.Float], scattered: RepeatableSum | None
    ) -> None:
        departure, arrival = self._stencils(cells)
        gradient = mi.Vector3f(0)
        slopes = departure.gradient(departure.read(self.field, self.channels))
        for c, (slope, value) in enumerate(zip(slopes, cells.own(g, self.channels), strict=True)):
            returned = 0 if scattered is None else scattered.at(cells.number * self.channels + c)
            gradient -= slope * (value + returned)
        if scattered is not None:
            slopes = arrival.gradient(arrival.read(self.forward_step, self.channels))
            for slope, value in zip(slopes, on_backward_step, strict=True):
                gradient += slope * value
        gradient *= dr.rcp(opaque(self.h))

        everywhere = dr.zeros(mi.Vector3f, math.prod(self.shape))
        dr.scatter(everywhere, gradient, cells.number, mode=dr.ReduceMode.NoConflicts)
        dr.eval(everywhere)
        self.set_grad_in("velocity", self.velocity.transpose(everywhere))

    def _set_field_gradient(
        self, g: mi.Float, cells: Cells, on_backward_step: list[mi.Float], scattered: RepeatableSum | None
    ) -> None:
        on_forward_step = g if scattered is None else g + scattered.result()
        dr.eval(on_forward_step)
        everywhere = Cells.of(self.shape)
        departure, _ = self._stencils(everywhere)
        bound = largest_of([on_forward_step, *on_backward_step])
        total = RepeatableSum(dr.width(self.field), bound, 9 * math.prod(self.shape))
        departure.splat(total, everywhere.own(on_forward_step, self.channels))
        for c, value in enumerate(on_backward_step):
            total.add(cells.number * self.channels + c, -value)
        self.set_grad_in("field", mi.TensorXf(total.result(), self.tensor_shape))

    def name(self) -> str:
        """The name in Dr.Jit's messages."""
        return "advection step"


def largest_of(arrays: list[mi.Float]) -> mi.Float:
    """The largest magnitude in all arrays."""
    result = mi.Float(0)
    for array in arrays:
        result = dr.maximum(result, largest_magnitude(array))
    return result


def value_range(corners: list[mi.Float]) -> tuple[mi.Float, mi.Float]:
    """Smallest and largest value."""
    low = high = corners[0]
    for corner in corners[1:]:
        low, high = dr.minimum(low, corner), dr.maximum(high, corner)
    return low, high


def varied(corners: list[list[mi.Float]]) -> mi.Bool:
    """Whether the corners differ in any channel."""
    varied = mi.Bool(False)
    for channel in zip(*corners, strict=True):
        low, high = value_range(list(channel))
        varied |= low < high
    return varied
