"""The result of a frame: its optimised fields, applied to the unstylized smoke at full resolution."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.kernels import opaque
from tnst_mi.frame import Frame
from tnst_mi.optimisation.items.state import Items
from tnst_mi.optimisation.parameterisation import Transport
from tnst_mi.optimisation.plan import FramePlan
from tnst_mi.optimisation.result import Stylized


def stylized_frame(items: Items | None, frame: FramePlan, source: Frame) -> Stylized:
    """The stylized frame, without its losses and its history.

    A frame that stays unchanged, or has not entered an octave yet, is returned as it is. Inside a solid the smoke stays
    unchanged, and v* is 0.

    Args:
        items: of the octave that was reached; None if there is none.
        frame: the plan of the frame.
        source: the frame.

    Raises:
        InputError: the stylized density or velocity is not finite.
    """
    strength = frame.recipe.strength
    if items is None or frame.still or items.iterations_done(frame) < 0 or strength == 0.0:
        return _unchanged(source, frame)
    full, parameterisation = items.plan.full, frame.parameterisation
    # The input's own values are transported. They are brought to about 1 by a power of two, which changes none of their
    # bits, so that no product leaves the range of float32.
    mantissa, exponent = math.frexp(items.plan.density_scale)
    fields = parameterisation.rescaled(parameterisation.carried(items.fields(frame), items.octave, full), 1 / mantissa)
    # Interpolation between the cells of an octave can exceed what they have.
    fields = frame.within_reach(fields, full.cell_size, items.plan.allowed(frame, source, full))
    if strength < 1.0:
        fields = fields.times(strength)
    unstylized = mi.TensorXf(np.ldexp(source.density, exponent))
    solid = None if source.obstacle is None else mi.Bool(source.obstacle.ravel())
    with dr.suspend_grad():
        if isinstance(parameterisation, Transport):
            velocity = parameterisation.velocity(fields, full.cell_size)
        else:
            velocity = dr.zeros(mi.TensorXf, (*source.density.shape, 3))
        if isinstance(parameterisation, Transport) and solid is not None:
            # Potentials do not change inside a solid, but those around it produce velocities one cell into it.
            components = dr.select(solid, mi.Vector3f(0), dr.unravel(mi.Vector3f, velocity.array))
            velocity = mi.TensorXf(dr.ravel(components), tuple(velocity.shape))
            density = parameterisation.around_solids(unstylized, velocity, full.cell_size)
        else:
            density = parameterisation.density(fields, unstylized, full.cell_size)
    if not (dr.all(dr.isfinite(density.array)) and dr.all(dr.isfinite(velocity.array))):
        raise InputError(
            f"{source.name}: the stylized density or velocity is not finite; try a smaller eta ({frame.recipe.eta:g}) "
            f"or gamma ({frame.recipe.gamma:g})"
        )
    blend, before = opaque(frame.recipe.blend), unstylized.array
    after = density.array if solid is None else dr.select(solid, before, density.array)
    mixed = (1 - blend) * before + blend * dr.maximum(after, 0)
    if items.plan.regions is not None:
        # Outside a region nothing changes, not even by rounding.
        mixed = dr.select(after == before, before, mixed)
    blended = mi.TensorXf(mixed, source.density.shape).numpy()
    phi, psi = (fields[name].numpy() if name in fields else None for name in ("phi", "psi"))
    result = Stylized(np.ldexp(blended, -exponent), velocity.numpy(), (phi, psi))
    begun = items.level > 0 or items.iterations_done(frame) > 0
    if begun and not any(dr.any(field.array != 0) for field in fields.values()):
        result.note = f"{source.name}: left unchanged, since {_why_unchanged(items, frame, source)}"
    return result


def _why_unchanged(items: Items, frame: FramePlan, source: Frame) -> str:
    regions = items.plan.regions
    if regions is not None and regions.outside(frame.index, source):
        return "it has no smoke in a mask"
    return (
        "nothing that the loss looks at responds to it: choose other layers or channels, or check the network's weights"
    )


def _unchanged(source: Frame, frame: FramePlan) -> Stylized:
    result = Stylized(source.density.copy(), np.zeros((*source.density.shape, 3), np.float32))
    if frame.still:
        seen = f"renders black at gamma {frame.recipe.gamma:g}" if source.density.any() else "is empty"
        result.note = f"{source.name} {seen}: nothing to stylize, left unchanged"
    return result
