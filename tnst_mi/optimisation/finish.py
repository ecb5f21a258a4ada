"""The result of a frame: its optimised fields, applied to the unstylized smoke at full resolution."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.kernels import opaque
from tnst_mi.frame import Frame
from tnst_mi.geometry.other_grids import OtherGrid
from tnst_mi.optimisation.colouring import COLOUR, final_colour
from tnst_mi.optimisation.items.state import Items
from tnst_mi.optimisation.movement import Movement
from tnst_mi.optimisation.parameterisation import Fields, Parameterisation, Transport, times
from tnst_mi.optimisation.plan import FramePlan, Plan
from tnst_mi.optimisation.result import Stylized
from tnst_mi.regions.octave_masks import border_of


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
    # The input's own values are transported, in a unit that is a power of two from that of the fields.
    mantissa, exponent = math.frexp(items.plan.density_scale)
    fields = parameterisation.rescaled(parameterisation.carried(items.fields(frame), items.octave, full), 1 / mantissa)
    fields = _within_regions(fields, items, frame, source)
    # Interpolation between the cells of an octave can exceed what they have.
    fields = frame.within_reach(fields, full.cell_size, items.plan.allowed(frame, source, full))
    if strength < 1.0:
        fields = fields.times(strength)
    movement = None
    if isinstance(parameterisation.of_density, Transport):
        moving = parameterisation.of_density
        shown = frame.recipe.colour != "off"
        movement = Movement(moving, fields, full.cell_size, source, exponent, frame.recipe.blend, shown)
        density, velocity = movement.density(source.density), movement.velocity.numpy()
    else:
        density = _offset(parameterisation, fields, source, exponent, full.cell_size, frame.recipe.blend)
        velocity = np.zeros((*source.density.shape, 3), np.float32)
    if not (np.isfinite(density).all() and np.isfinite(velocity).all()):
        raise InputError(
            f"{source.name}: the stylized density or velocity is not finite; try a smaller eta ({frame.recipe.eta:g}) "
            "or gamma"
        )
    phi, psi = (fields[name].numpy() if name in fields else None for name in ("phi", "psi"))
    result = Stylized(density, velocity, (phi, psi), movement=movement)
    if COLOUR in fields:
        result.colour = _coloured(items.plan, frame, source, fields[COLOUR], movement)
    begun = items.level > 0 or items.iterations_done(frame) > 0
    if begun and not any(dr.any(field.array != 0) for field in fields.values()):
        result.note = f"{source.name}: left unchanged, since {_why_unchanged(items, frame, source)}"
    return result


def _coloured(
    plan: Plan, frame: FramePlan, source: Frame, change: mi.TensorXf, movement: Movement | None
) -> np.ndarray | None:
    """The colours of a result, display values; `change` is that of the full grid, times the strength."""
    if plan.colours is None:
        return None
    masks = () if plan.regions is None else plan.regions.masks(frame.index, source)
    unstylized, start = plan.colours.unstylized(source), plan.colours.start(frame.index, source, masks)
    if plan.colours.grid(source) is not None and movement is not None:
        # Both are the colours that the smoke has, which move with it.
        unstylized = start = movement.carried(OtherGrid(unstylized), of_colour=True)
    recipe = frame.recipe
    return final_colour(unstylized, start, change, recipe.strength * recipe.blend, recipe.blend, source.obstacle)


def _within_regions(fields: Fields, items: Items, frame: FramePlan, source: Frame) -> Fields:
    """Fields of the full grid that end where the frame's regions do, though the cells of an octave reach beyond."""
    regions = items.plan.regions
    border = None if regions is None else border_of(regions.masks(frame.index, source), items.octave)
    if border is None:
        return fields
    restored = border.restored()
    return Fields({name: times(restored, field) for name, field in fields.items()})


def _why_unchanged(items: Items, frame: FramePlan, source: Frame) -> str:
    regions = items.plan.regions
    if regions is not None and regions.outside(frame.index, source):
        return "it has no smoke in a mask"
    return (
        "nothing that the loss looks at responds to it: choose other layers or channels, or check the network's weights"
    )


def _offset(
    parameterisation: Parameterisation, fields: Fields, source: Frame, exponent: int, h: float, blend: float
) -> np.ndarray:
    """The density of a frame whose cells change in place, scaled by a power of two meanwhile."""
    unstylized = mi.TensorXf(np.ldexp(source.density, exponent))
    with dr.suspend_grad():
        density = parameterisation.density(fields, unstylized, h)
    share, before, after = opaque(blend), unstylized.array, density.array
    if source.obstacle is not None:
        after = dr.select(mi.Bool(source.obstacle.ravel()), before, after)
    mixed = dr.select(after == before, before, (1 - share) * before + share * dr.maximum(after, 0))
    blended = mi.TensorXf(mixed, source.density.shape)
    return np.ldexp(blended.numpy(), -exponent)


def _unchanged(source: Frame, frame: FramePlan) -> Stylized:
    result = Stylized(source.density.copy(), np.zeros((*source.density.shape, 3), np.float32))
    if frame.still:
        seen = "renders black at this gamma" if source.density.any() else "is empty"
        result.note = f"{source.name} {seen}: nothing to stylize, left unchanged"
    return result
