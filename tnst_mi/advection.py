"""Semi-Lagrangian and MacCormack advection, with hand-derived derivatives.

Semi-Lagrangian:  f(x) = d(x − v(x)), one Euler back-trace, trilinear.
MacCormack:       b(x) = f(x + v(x)),  result = f + (d − b)/2, reverted to f where that leaves the range of the eight
                  cells around the departure point x − v (Selle et al. 2008).

The adjoint needs one scatter (of the backward leg, onto f); everything else is local to a cell. The revert is a
switch: its choice is held fixed when differentiating.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi

from tnst_mi.arrays import any_array_kind
from tnst_mi.errors import InputError
from tnst_mi.grid import Cells, RepeatableSum, Shape, Trilinear, gather, largest_magnitude, opaque

#: A displacement of more cells than this is a mistake, not a motion to be followed in steps of one cell.
_MOST_SUBSTEPS = 10_000

METHODS = ("maccormack", "semi_lagrangian", "maccormack_unlimited")


def _interleave(components: list[mi.Float]) -> mi.Float:
    """Flat array with the channels of a cell next to each other."""
    return components[0] if len(components) == 1 else dr.ravel(mi.Vector3f(*components))


class _Step(dr.CustomOp):
    """One advection step of a field with `channels` values per cell (1 or 3)."""

    def eval(
        self,
        field: mi.TensorXf,
        velocity: mi.TensorXf,
        shape: Shape,
        method: str,
        h: float,
        outside: str,
        reverted: mi.TensorXf | None,
        field_varies: bool,
    ) -> mi.TensorXf:
        self.shape, self.outside, self.h, self.field_varies = shape, outside, h, field_varies
        self.channels = 1 if len(field.shape) == 3 else field.shape[3]
        self.corrected = method != "semi_lagrangian"
        self.field, self.velocity = field.array, velocity.array
        self.tensor_shape, self.velocity_shape = tuple(field.shape), tuple(velocity.shape)

        cells, displacement = self._cells_and_displacement()
        departure = Trilinear(cells, -displacement, outside)
        corners = departure.read(self.field, self.channels)
        forward = departure.value(corners)
        if not self.corrected:
            return mi.TensorXf(_interleave(forward), self.tensor_shape)

        # The backward leg interpolates f, which must be in memory first.
        self.forward_step = _interleave(forward)
        dr.eval(self.forward_step)
        arrival = Trilinear(cells, displacement, outside)
        backward = arrival.value(arrival.read(self.forward_step, self.channels))
        here = dr.arange(mi.UInt32, math.prod(self.shape))
        result, kept = [], []
        for c in range(self.channels):
            slot = here if self.channels == 1 else here * self.channels + c
            f = dr.gather(mi.Float, self.forward_step, slot)
            value = f + 0.5 * (dr.gather(mi.Float, self.field, slot) - backward[c])
            if reverted is not None:
                keep = dr.gather(mi.Float, reverted.array, slot) == 0
            elif method == "maccormack":
                keep = _in_range(value, [corner[c] for corner in corners])
            else:
                keep = mi.Bool(True)
            result.append(dr.select(keep, value, f))
            kept.append(dr.select(keep, 1.0, mi.Float(0)))
        self.kept = _interleave(kept) if method == "maccormack" or reverted is not None else None
        output = mi.TensorXf(_interleave(result), self.tensor_shape)
        dr.eval(output, self.kept)
        return output

    def _cells_and_displacement(self) -> tuple[Cells, mi.Vector3f]:
        cells = Cells.of(self.shape)
        index = dr.arange(mi.UInt32, math.prod(self.shape))
        v = mi.Vector3f(*gather(self.velocity, index, 3))
        return cells, v * dr.rcp(opaque(self.h))

    def _channels_of(self, values: mi.Float) -> list[mi.Float]:
        return gather(values, dr.arange(mi.UInt32, math.prod(self.shape)), self.channels)

    def forward(self) -> None:
        cells, displacement = self._cells_and_displacement()
        velocity_tangent = self.grad_in("velocity").array
        index = dr.arange(mi.UInt32, math.prod(self.shape))
        moved = mi.Vector3f(*gather(velocity_tangent, index, 3))
        moved *= dr.rcp(opaque(self.h))
        field_tangent = self.grad_in("field").array

        departure = Trilinear(cells, -displacement, self.outside)
        slopes = departure.gradient(departure.read(self.field, self.channels))
        carried = departure.value(departure.read(field_tangent, self.channels))
        f = [value - dr.dot(slope, moved) for value, slope in zip(carried, slopes, strict=True)]
        if not self.corrected:
            self.set_grad_out(mi.TensorXf(_interleave(f), self.tensor_shape))
            return
        f_flat = _interleave(f)
        dr.eval(f_flat)
        arrival = Trilinear(cells, displacement, self.outside)
        slopes = arrival.gradient(arrival.read(self.forward_step, self.channels))
        carried = arrival.value(arrival.read(f_flat, self.channels))
        b = _interleave([value + dr.dot(slope, moved) for value, slope in zip(carried, slopes, strict=True)])
        correction = 0.5 * (field_tangent - b)
        if self.kept is not None:
            correction *= self.kept
        self.set_grad_out(mi.TensorXf(f_flat + correction, self.tensor_shape))

    def backward(self) -> None:
        g = self.grad_out().array
        dr.eval(g)
        cells, displacement = self._cells_and_displacement()
        size, count = dr.width(self.field), 8 * math.prod(self.shape)
        velocity_gradient = mi.Vector3f(0)
        direct = None
        on_forward_step = g
        if self.corrected:
            kept = g if self.kept is None else g * self.kept
            on_backward_step = self._channels_of(-0.5 * kept)
            arrival = Trilinear(cells, displacement, self.outside)
            total = RepeatableSum(size, largest_magnitude(g), count)
            arrival.splat(total, on_backward_step)
            for slope, value in zip(
                arrival.gradient(arrival.read(self.forward_step, self.channels)),
                on_backward_step,
                strict=True,
            ):
                velocity_gradient += slope * value
            on_forward_step = g + total.result()
            direct = 0.5 * kept
            dr.eval(on_forward_step, velocity_gradient)

        departure = Trilinear(cells, -displacement, self.outside)
        pulled = self._channels_of(on_forward_step)
        for slope, value in zip(departure.gradient(departure.read(self.field, self.channels)), pulled, strict=True):
            velocity_gradient -= slope * value
        velocity_gradient *= dr.rcp(opaque(self.h))
        self.set_grad_in("velocity", mi.TensorXf(dr.ravel(velocity_gradient), self.velocity_shape))
        if self.field_varies:
            total = RepeatableSum(size, largest_magnitude(on_forward_step), count)
            departure.splat(total, pulled)
            gradient = total.result() if direct is None else total.result() + direct
            self.set_grad_in("field", mi.TensorXf(gradient, self.tensor_shape))

    def name(self) -> str:
        return "advection step"


def _in_range(value: mi.Float, corners: list[mi.Float]) -> mi.Bool:
    low = high = corners[0]
    for corner in corners[1:]:
        low, high = dr.minimum(low, corner), dr.maximum(high, corner)
    return (value >= low) & (value <= high)


def step(
    field: mi.TensorXf,
    velocity: mi.TensorXf,
    method: str = "maccormack",
    h: float = 1.0,
    outside: str = "zero",
    reverted: mi.TensorXf | None = None,
) -> mi.TensorXf:
    """One advection step of Dr.Jit tensors.

    `reverted`, of the field's shape and non-zero where the result is f, fixes the limiter's choice. Finite differences
    need the choice fixed: the limiter is a switch, so a difference across it is no derivative.
    """
    shape = tuple(velocity.shape)[:3]
    return dr.custom(_Step, field, velocity, shape, method, float(h), outside, reverted, bool(dr.grad_enabled(field)))


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
    count = substeps(v, h) if steps == "auto" else steps
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        raise InputError(f"advect: steps {steps!r} given, expected a whole number >= 1 or 'auto'")
    part = v if count == 1 else v * dr.rcp(opaque(count))
    for _ in range(count):
        field = step(field, part, method, h, outside)
    return field


def substeps(v: mi.TensorXf, h: float) -> int:
    """Number of sub-steps that "auto" stands for: ⌈max |v| / h⌉, so that none crosses more than one cell."""
    index = dr.arange(mi.UInt32, math.prod(v.shape[:3]))
    values = dr.detach(v.array)
    fastest = dr.max(dr.norm(mi.Vector3f(*gather(values, index, 3))))[0] if dr.width(values) else 0.0
    if not fastest / h <= _MOST_SUBSTEPS:
        raise InputError(
            f"advect: the largest displacement is {fastest:g} cells of size {h:g}, expected at most {_MOST_SUBSTEPS} "
            'for steps "auto"; give a number of steps'
        )
    return max(1, math.ceil(fastest / h))
