"""Transport of fields along a velocity: semi-Lagrangian and MacCormack advection, in one step or several.

The step itself and its derivatives are in `maccormack`.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi

from tnst_mi.errors import InputError
from tnst_mi.fields.arrays import any_array_kind
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
    if isinstance(velocity, PotentialVelocity):
        arrays, source = velocity.potentials, velocity.source
    else:
        arrays, source = {"v": velocity}, lambda arrays: GivenVelocity(arrays["v"])
    return dr.custom(
        AdvectionStep, field, arrays, source, method, float(h), outside, reverted, bool(dr.grad_enabled(field))
    )


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
    """Transport a field by a velocity, the T(d, v) of paper Eq. 4.

    The result at x is the field at x − v(x), so positive v_x moves it towards +x.

    Args:
        field: scalar (D, H, W) or vector (D, H, W, 3) field at the cell centres.
        v: velocity (D, H, W, 3), components (x, y, z), in full-resolution cells per frame.
        method: "maccormack" (limited by reverting, Selle et al. 2008), "semi_lagrangian", or
            "maccormack_unlimited" (linear in the field).
        h: size of a cell in full-resolution cells, > 0.
        outside: "zero" reads 0 outside the grid, "edge" repeats the border cells. Vector fields usually want "edge".
        steps: number n of sub-steps of v/n, each a full step of the method; "auto" is ⌈max |v| / h⌉, at least 1.

    Returns:
        The transported field, in the shape and array kind of the input. Differentiable with respect to the field and v.

    Raises:
        InputError: the method or boundary is unknown, the shapes do not match, or the grid is too large to be indexed.

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
    if steps != "auto" and (not isinstance(steps, int) or isinstance(steps, bool) or steps < 1):
        raise InputError(f"advect: steps {steps!r} given, expected a whole number >= 1 or 'auto'")
    require_indexable(3 * math.prod(tuple(v.shape)[:3]), "advect: a field")
    count = substeps(v, h) if steps == "auto" else steps
    for _ in range(count):
        field = step(field, v, method, h * count, outside)
    return field


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
