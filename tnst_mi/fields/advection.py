"""Transport of fields along a velocity: semi-Lagrangian and MacCormack advection, in steps or along the flow.

The step and its derivatives are in `maccormack`, those along the flow in `flow_advection`.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import drjit as dr
import mitsuba as mi

from tnst_mi.choices import TRACES
from tnst_mi.errors import InputError
from tnst_mi.fields.arrays import any_array_kind
from tnst_mi.fields.flow_advection import FlowAdvection
from tnst_mi.fields.flow_map import MOST_STAGES
from tnst_mi.fields.kernels import require_indexable
from tnst_mi.fields.maccormack import AdvectionStep, GivenVelocity
from tnst_mi.fields.potentials import PotentialVelocity

#: Displacements of more cells than this are taken for a mistake, and not followed in sub-steps of one cell.
_MOST_SUBSTEPS = 10_000

METHODS = ("maccormack", "semi_lagrangian", "maccormack_unlimited")


def step(
    field: mi.TensorXf,
    velocity: mi.TensorXf | PotentialVelocity,
    method: str = "maccormack",
    h: float = 1.0,
    outside: str = "zero",
    reverted: mi.TensorXf | None = None,
) -> mi.TensorXf:
    """One advection step of Dr.Jit tensors, by a velocity (D, H, W, 3) or by potentials.

    With x the positions of all cells, `AdvectionStep` computes the following, in few kernels and only for the cells
    that need it:

        departure, arrival = x - v / h, x + v / h
        f = interpolated(field, departure)                      # the semi-Lagrangian step
        b = interpolated(f, arrival)                            # and back again: the field, and twice the error
        result = f + (field - b) / 2
        corners = field[eight_cells_around(departure)]          # (8, D, H, W)
        low, high = corners.min(axis=0), corners.max(axis=0)
        kept = (low <= result) & (result <= high)               # the limiter
        return where(kept, result, f)

    `reverted`, of the field's shape and non-zero where the result is f, fixes the limiter's choice. Finite differences
    need the choice fixed: the limiter is a switch, and a difference across it does not approximate a derivative.
    """
    arrays, source = _arrays_and_source(velocity)
    return dr.custom(
        AdvectionStep, field, arrays, source, method, float(h), outside, reverted, bool(dr.grad_enabled(field))
    )


def flow(
    field: mi.TensorXf,
    velocity: mi.TensorXf | PotentialVelocity,
    method: str = "maccormack",
    h: float = 1.0,
    outside: str = "zero",
    reverted: mi.TensorXf | None = None,
    stages: int | None = None,
    conservative: bool = False,
) -> mi.TensorXf:
    """Like `step`, along the flow of the velocity over one frame; see `FlowAdvection`.

    `stages` and `conservative` are those of `advect`, with None for "auto".
    """
    arrays, source = _arrays_and_source(velocity)
    return dr.custom(
        FlowAdvection,
        field,
        arrays,
        source,
        method,
        float(h),
        outside,
        reverted,
        bool(dr.grad_enabled(field)),
        stages,
        conservative,
    )


def _arrays_and_source(
    velocity: mi.TensorXf | PotentialVelocity,
) -> tuple[dict[str, mi.TensorXf], Callable[[dict[str, mi.TensorXf]], GivenVelocity | PotentialVelocity]]:
    """The arrays that define a velocity, by name, and what builds it from them."""
    if isinstance(velocity, PotentialVelocity):
        return velocity.potentials, velocity.source
    return {"v": velocity}, lambda arrays: GivenVelocity(arrays["v"])


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
    trace: str = "step",
    stages: int | str = "auto",
    conservative: bool = False,
) -> mi.TensorXf:
    """Transport a field by a velocity, the T(d, v) of paper Eq. 4.

    With trace "step", the result at x is the field at x − v(x), so positive v_x moves it towards +x. With trace "flow"
    it is the field at the start of the path that follows v, as a stationary velocity, for one frame and ends at x. They
    agree where v is the same everywhere. Where it turns, a long straight step leaves the flow: smoke is lost, or made,
    even if v has no divergence (docs/transport.md).

    Args:
        field: scalar (D, H, W) or vector (D, H, W, 3) field at the cell centres.
        v: velocity (D, H, W, 3), components (x, y, z), in full-resolution cells per frame.
        method: "maccormack" (limited by reverting, Selle et al. 2008), "semi_lagrangian", or
            "maccormack_unlimited" (linear in the field).
        h: size of a cell in full-resolution cells, > 0.
        outside: "zero" reads 0 outside the grid, "edge" repeats the border cells. Vector fields usually want "edge".
        steps: with trace "step", number n of sub-steps of v/n, each a full step of the method; "auto" is ⌈max |v| / h⌉,
            at least 1.
        trace: "step" goes back along straight lines; "flow" along the flow, and interpolates the field once.
        stages: with trace "flow", number of stages in which a path is traced, from 1 to 64, each of three evaluations
            of v (Ralston's third-order Runge–Kutta method); "auto" lets each path have one for every three cells per
            frame of the largest velocity that a trial in one stage meets, from 1 to 32.
        conservative: with trace "flow", multiply by the determinant of the Jacobian of x ↦ start of its path: the field
            is then a density whose sum is kept, up to what leaves the grid and to what the grid resolves, also where v
            has a divergence.

    Returns:
        The transported field, in the shape and array kind of the input. Differentiable with respect to the field and v.

    Raises:
        InputError: the method, boundary or trace is unknown, an argument belongs to the other trace, the shapes do not
            match, or the grid is too large to be indexed.

    Example:
        >>> import numpy as np
        >>> import tnst_mi
        >>> density = np.array([[[0, 1, 0, 0, 0]]])
        >>> v = np.zeros((1, 1, 5, 3))
        >>> v[..., 0] = 2  # cells towards +x
        >>> tnst_mi.advect(density, v).tolist()
        [[[0.0, 0.0, 0.0, 1.0, 0.0]]]
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
    require_indexable((4 if conservative else 3) * math.prod(tuple(v.shape)[:3]), "advect: a field")
    substep_count, stage_count = _counts(trace, steps, stages, conservative)
    if trace == "flow":
        return flow(field, v, method, h, outside, None, stage_count, conservative)
    count = substep_count or substeps(v, h)
    for _ in range(count):
        field = step(field, v, method, h * count, outside)
    return field


def _counts(trace: str, steps: int | str, stages: int | str, conservative: bool) -> tuple[int | None, int | None]:
    """The numbers of steps and of stages, None for "auto", of arguments of `advect` that belong together."""
    if trace not in TRACES:
        raise InputError(f"advect: trace {trace!r} is unknown, expected 'step' or 'flow'")
    counts = _count("steps", steps, None), _count("stages", stages, MOST_STAGES)
    if trace == "flow" and steps != 1:
        raise InputError(f"advect: steps {steps!r} with trace 'flow' given, expected stages, or trace 'step'")
    if trace == "step" and (stages != "auto" or conservative):
        given = "conservative" if conservative else f"stages {stages!r}"
        raise InputError(f"advect: {given} with trace 'step' given, expected trace 'flow'")
    return counts


def _count(name: str, value: int | str, most: int | None) -> int | None:
    if value == "auto":
        return None
    if isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= (most or value):
        return value
    allowed = ">= 1" if most is None else f"from 1 to {most}"
    raise InputError(f"advect: {name} {value!r} given, expected a whole number {allowed} or 'auto'")


def substeps(v: mi.TensorXf, h: float) -> int:
    """Number of sub-steps for "auto": ⌈max |v| / h⌉, so that none crosses more than one cell."""
    values = dr.detach(v.array)
    fastest = dr.max(dr.norm(dr.unravel(mi.Vector3f, values)))[0] if dr.width(values) else 0.0
    if not fastest / h <= _MOST_SUBSTEPS:
        raise InputError(
            f"advect: the largest displacement is {fastest:g} cells of size {h:g}, expected at most {_MOST_SUBSTEPS} "
            'for steps "auto"; give a number of steps'
        )
    return max(1, math.ceil(fastest / h))
