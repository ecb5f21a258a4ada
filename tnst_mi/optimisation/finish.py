"""The result of a frame: its optimised fields, applied to the unstylized smoke at full resolution."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.advection import advect
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
    """
    if items is None or frame.still or items.iterations_done(frame) < 0:
        return _unchanged(source, frame)
    full, parameterisation = items.plan.octaves[-1], frame.parameterisation
    fields = parameterisation.carried(items.fields(frame), items.octave, full)
    with dr.suspend_grad():
        if isinstance(parameterisation, Transport):
            velocity = parameterisation.velocity(fields, full.cell_size).numpy()
        else:
            velocity = np.zeros((*source.density.shape, 3), np.float32)
        if isinstance(parameterisation, Transport) and source.obstacle is not None:
            # Potentials do not change inside a solid, but those around it produce velocities one cell into it.
            velocity[source.obstacle] = 0
            density = advect(source.density, velocity, steps=frame.recipe.steps)
        else:
            density = parameterisation.density(fields, mi.TensorXf(source.density), full.cell_size).numpy()
    if source.obstacle is not None:
        density = np.where(source.obstacle, source.density, density)
    blend = frame.recipe.blend
    blended = (1.0 - blend) * source.density + blend * np.maximum(density, 0)
    phi, psi = (fields[name].numpy() if name in fields else None for name in ("phi", "psi"))
    return Stylized(blended.astype(np.float32), velocity, (phi, psi))


def _unchanged(source: Frame, frame: FramePlan) -> Stylized:
    result = Stylized(source.density.copy(), np.zeros((*source.density.shape, 3), np.float32))
    if frame.still:
        seen = f"renders black at gamma {frame.recipe.gamma:g}" if source.density.any() else "is empty"
        result.note = f"{source.name} {seen}: nothing to stylize, left unchanged"
    return result
