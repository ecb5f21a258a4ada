"""Semi-Lagrangian and MacCormack advection, with hand-derived derivatives.

Semi-Lagrangian:  f(x) = d(x − v(x)), one Euler back-trace, trilinear.
MacCormack:       b(x) = f(x + v(x)),  result = f + (d − b)/2, reverted to f where that leaves the range of the eight
                  cells around the departure point x − v (Selle et al. 2008).

With w = 0 where the result is reverted and 1 elsewhere, and g = ∂L/∂result, the adjoint is

    ∂L/∂b = −w g/2,    ∂L/∂f = g + Bᵀ ∂L/∂b,    ∂L/∂v = ∇f(x + v) ∂L/∂b − ∇d(x − v) ∂L/∂f,
    ∂L/∂d = w g/2 + Fᵀ ∂L/∂f,

where F and B interpolate at x − v and x + v. It needs one scatter, Bᵀ, and where the field is differentiated a second
one; everything else is local to a cell. The revert is a switch: its choice is held fixed when differentiating.

Where the eight cells around x − v are equal, as in all the air around the smoke, the range has no width: the result is
f whatever v is, and neither the correction nor a derivative with respect to v has anything to do. So once f is known,
the limited step works on the other cells alone, unless the field is differentiated too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from tnst_mi.errors import InputError
from tnst_mi.fields.arrays import any_array_kind
from tnst_mi.fields.grid import Cells, RepeatableSum, Trilinear, largest_magnitude, opaque, stored
from tnst_mi.fields.potentials import PotentialVelocity

#: A displacement of more cells than this is a mistake, not a motion to be followed in steps of one cell.
_MOST_SUBSTEPS = 10_000

METHODS = ("maccormack", "semi_lagrangian", "maccormack_unlimited")


def _interleave(components: list[mi.Float]) -> mi.Float:
    """Flat array with the channels of a cell next to each other, written with the next evaluation."""
    return stored(components[0]) if len(components) == 1 else dr.ravel(mi.Vector3f(*components))


@dataclass(frozen=True)
class _GivenVelocity:
    """A velocity that is in memory, with the interface of `PotentialVelocity`."""

    v: mi.TensorXf

    def at(self, cells: Cells) -> mi.Vector3f:
        return mi.Vector3f(*cells.own(self.v.array, 3))

    def transpose(self, g: mi.Vector3f) -> dict[str, mi.TensorXf]:
        return {"v": mi.TensorXf(dr.ravel(g), tuple(self.v.shape))}


class _Step(dr.CustomOp):
    """One advection step of a field with `channels` values per cell (1 or 3)."""

    def eval(
        self,
        field: mi.TensorXf,
        velocity: dict[str, mi.TensorXf],
        source: Callable[[dict[str, mi.TensorXf]], _GivenVelocity | PotentialVelocity],
        method: str,
        h: float,
        outside: str,
        reverted: mi.TensorXf | None,
        field_varies: bool,
    ) -> mi.TensorXf:
        self.outside, self.h, self.field_varies = outside, h, field_varies
        self.tensor_shape = tuple(field.shape)
        self.shape, self.channels = self.tensor_shape[:3], math.prod(self.tensor_shape[3:])
        self.corrected = method != "semi_lagrangian"
        self.field, self.source, self.velocity = field.array, source, source(velocity)
        #: Storage indices of the cells that the correction and ∂/∂v are computed for; None for all of them.
        self.chosen: mi.UInt32 | None = None
        #: By channel, which of them keep the corrected value; None where all do.
        self.kept: list[mi.Bool] | None = None

        departure, _ = self._stencils(Cells.of(self.shape))
        corners = departure.read(self.field, self.channels)
        self.forward_step = _interleave(departure.value(corners))
        limited = method == "maccormack" and reverted is None
        if limited and not field_varies:
            self.chosen = dr.compress(stored(_varied(corners)))
            if dr.width(self.chosen) == 0:
                self.chosen, self.corrected = None, False
        dr.eval(self.forward_step)
        if not self.corrected:
            return mi.TensorXf(mi.Float(self.forward_step), self.tensor_shape)

        # The backward leg interpolates f, which is in memory now.
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
                low, high = _range([corner[c] for corner in corners])
                keep = (value >= low) & (value <= high)
            elif reverted is not None:
                keep = dr.gather(mi.Float, reverted.array, slot) == 0
            dr.scatter(result, value, slot, keep, dr.ReduceMode.NoConflicts)
            kept.append(keep)
        if limited or reverted is not None:
            self.kept = [stored(keep) for keep in kept]
        dr.eval(result, self.kept)
        return mi.TensorXf(result, self.tensor_shape)

    def _stencils(self, cells: Cells) -> tuple[Trilinear, Trilinear]:
        """Around x − v and x + v."""
        displacement = self.velocity.at(cells) * dr.rcp(opaque(self.h))
        return Trilinear(cells, -displacement, self.outside), Trilinear(cells, displacement, self.outside)

    def _keep(self, values: list[mi.Float]) -> list[mi.Float]:
        """Values where the correction is kept, 0 elsewhere."""
        if self.kept is None:
            return values
        return [dr.select(keep, value, 0) for keep, value in zip(self.kept, values, strict=True)]

    def forward(self) -> None:
        field_tangent, velocity_tangent = self.grad_in("field").array, self.source(self.grad_in("velocity"))

        def carried(stencil: Trilinear, cells: Cells, values: mi.Float, tangent: mi.Float, sign: int) -> list[mi.Float]:
            """Derivative of the values interpolated at x + sign · v."""
            moved = velocity_tangent.at(cells) * (sign * dr.rcp(opaque(self.h)))
            slopes = stencil.gradient(stencil.read(values, self.channels))
            interpolated = stencil.value(stencil.read(tangent, self.channels))
            return [value + dr.dot(slope, moved) for value, slope in zip(interpolated, slopes, strict=True)]

        cells = Cells.of(self.shape)
        departure, _ = self._stencils(cells)
        result = _interleave(carried(departure, cells, self.field, field_tangent, -1))
        dr.eval(result)
        if self.corrected:
            cells = Cells.of(self.shape, self.chosen)
            _, arrival = self._stencils(cells)
            b = carried(arrival, cells, self.forward_step, result, 1)
            d = cells.own(field_tangent, self.channels)
            corrections = self._keep([0.5 * (x - y) for x, y in zip(d, b, strict=True)])
            forward_tangent, result = result, mi.Float(result)
            for c, correction in enumerate(corrections):
                slot = cells.number * self.channels + c
                value = dr.gather(mi.Float, forward_tangent, slot) + correction
                dr.scatter(result, value, slot, mode=dr.ReduceMode.NoConflicts)
        self.set_grad_out(mi.TensorXf(result, self.tensor_shape))

    def backward(self) -> None:
        g = self.grad_out().array
        dr.eval(g)
        on_backward_step: list[mi.Float] = []
        scattered: RepeatableSum | None = None
        cells = Cells.of(self.shape, self.chosen)
        if self.corrected:
            _, arrival = self._stencils(cells)
            on_backward_step = [stored(v) for v in self._keep([-0.5 * v for v in cells.own(g, self.channels)])]
            scattered = RepeatableSum(dr.width(self.field), _largest(on_backward_step), 8 * math.prod(self.shape))
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
        bound = _largest([on_forward_step, *on_backward_step])
        total = RepeatableSum(dr.width(self.field), bound, 9 * math.prod(self.shape))
        departure.splat(total, everywhere.own(on_forward_step, self.channels))
        for c, value in enumerate(on_backward_step):
            total.add(cells.number * self.channels + c, -value)
        self.set_grad_in("field", mi.TensorXf(total.result(), self.tensor_shape))

    def name(self) -> str:
        return "advection step"


def _largest(arrays: list[mi.Float]) -> mi.Float:
    """The largest magnitude in some arrays."""
    result = mi.Float(0)
    for array in arrays:
        result = dr.maximum(result, largest_magnitude(array))
    return result


def _range(corners: list[mi.Float]) -> tuple[mi.Float, mi.Float]:
    """Smallest and largest value."""
    low = high = corners[0]
    for corner in corners[1:]:
        low, high = dr.minimum(low, corner), dr.maximum(high, corner)
    return low, high


def _varied(corners: list[list[mi.Float]]) -> mi.Bool:
    """Whether the corners differ in any channel."""
    varied = mi.Bool(False)
    for channel in zip(*corners, strict=True):
        low, high = _range(list(channel))
        varied |= low < high
    return varied


def step(
    field: mi.TensorXf,
    velocity: mi.TensorXf | PotentialVelocity,
    method: str = "maccormack",
    h: float = 1.0,
    outside: str = "zero",
    reverted: mi.TensorXf | None = None,
) -> mi.TensorXf:
    """One advection step of Dr.Jit tensors, by a velocity (D, H, W, 3) or by that of potentials.

    `reverted`, of the field's shape and non-zero where the result is f, fixes the limiter's choice. Finite differences
    need the choice fixed: the limiter is a switch, so a difference across it is no derivative.
    """
    if isinstance(velocity, PotentialVelocity):
        arrays, source = velocity.potentials, velocity.source
    else:
        arrays, source = {"v": velocity}, lambda arrays: _GivenVelocity(arrays["v"])
    return dr.custom(_Step, field, arrays, source, method, float(h), outside, reverted, bool(dr.grad_enabled(field)))


def revert_mask(field: mi.TensorXf, velocity: mi.TensorXf, h: float = 1.0, outside: str = "zero") -> mi.TensorXf:
    """1 where the limiter of one MacCormack step reverts to the semi-Lagrangian value, else 0; shape of the field."""
    field, velocity = dr.detach(field), dr.detach(velocity)
    limited = step(field, velocity, "maccormack", h, outside)
    free = step(field, velocity, "maccormack_unlimited", h, outside)
    return mi.TensorXf(dr.select(limited.array == free.array, mi.Float(0), 1.0), tuple(field.shape))


@any_array_kind("field", "v")
def advect(
    field: mi.TensorXf,
    v: mi.TensorXf,
    method: str = "maccormack",
    h: float = 1.0,
    outside: str = "zero",
    steps: int | str = 1,
) -> mi.TensorXf:
    """Transport a field by a velocity: the result at x is the field at x − v(x), so positive v_x moves it towards +x.

    Args:
        field: scalar (D, H, W) or vector (D, H, W, 3) field at the cell centres.
        v: velocity (D, H, W, 3), components (x, y, z), in full-resolution cells per frame.
        method: "maccormack" (limited by reverting, Selle et al. 2008), "semi_lagrangian", or
            "maccormack_unlimited" (linear in the field).
        h: size of a cell in full-resolution cells, > 0.
        outside: "zero" reads 0 outside the grid, "edge" repeats the border cells. Vector fields usually want "edge".
        steps: number n of sub-steps of v/n, each a full step of the method; "auto" is ⌈max |v| / h⌉, at least 1.

    Returns:
        The transported field, in the shape and array kind given. Differentiable in the field and in v.

    Raises:
        InputError: an unknown method or boundary, or shapes that do not belong together.
    """
    if method not in METHODS:
        raise InputError(f"advect: method {method!r} is unknown, expected one of {', '.join(METHODS)}")
    if outside not in ("zero", "edge"):
        raise InputError(f"advect: outside {outside!r} is unknown, expected 'zero' or 'edge'")
    if len(v.shape) != 4 or v.shape[3] != 3 or tuple(field.shape) not in (tuple(v.shape)[:3], tuple(v.shape)):
        raise InputError(
            f"advect: field {tuple(field.shape)} and velocity {tuple(v.shape)} given, "
            "expected (D, H, W) or (D, H, W, 3), and (D, H, W, 3) on the same grid"
        )
    if not h > 0.0:
        raise InputError(f"advect: h {h} given, expected a cell size > 0")
    if steps != "auto" and (not isinstance(steps, int) or isinstance(steps, bool) or steps < 1):
        raise InputError(f"advect: steps {steps!r} given, expected a whole number >= 1 or 'auto'")
    count = substeps(v, h) if steps == "auto" else steps
    for _ in range(count):
        field = step(field, v, method, h * count, outside)
    return field


def substeps(v: mi.TensorXf, h: float) -> int:
    """Number of sub-steps that "auto" stands for: ⌈max |v| / h⌉, so that none crosses more than one cell."""
    values = dr.detach(v.array)
    fastest = dr.max(dr.norm(dr.unravel(mi.Vector3f, values)))[0] if dr.width(values) else 0.0
    if not fastest / h <= _MOST_SUBSTEPS:
        raise InputError(
            f"advect: the largest displacement is {fastest:g} cells of size {h:g}, expected at most {_MOST_SUBSTEPS} "
            'for steps "auto"; give a number of steps'
        )
    return max(1, math.ceil(fastest / h))
