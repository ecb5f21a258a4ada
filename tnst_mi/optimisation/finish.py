"""The result of a frame: the fields that were reached, applied to the unstylized smoke at full resolution."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.advection import advect
from tnst_mi.frame import Frame
from tnst_mi.optimisation.parameterisation import Transport
from tnst_mi.optimisation.result import Stylized
from tnst_mi.optimisation.state import SequenceState, Shot


def stylized_frame(state: SequenceState, index: int, frame: Frame) -> Stylized:
    """What a frame has become, without its losses.

    A frame that is left unchanged, or has not entered an octave yet, comes as it is. In a solid the smoke stays what it
    was, and v* is 0.

    Args:
        state: of the sequence.
        index: of the frame.
        frame: the frame.
    """
    octave, shot = state.reached(), state.shots[index]
    if shot.still or state.done(octave, index) < 0:
        return _unchanged(frame, shot)
    parameters = state.restored(octave, index)
    parameters.enter(state.levels[-1])
    moves = isinstance(parameters, Transport)
    with dr.suspend_grad():
        velocity = parameters.velocity().numpy() if moves else np.zeros((*frame.density.shape, 3), np.float32)
        if moves and frame.obstacle is not None:
            # Potentials do not change in a solid, but those around it have velocities a cell inside.
            velocity[frame.obstacle] = 0
            density = advect(frame.density, velocity, steps=shot.recipe.steps)
        else:
            density = parameters.density(mi.TensorXf(frame.density)).numpy()
    if frame.obstacle is not None:
        density = np.where(frame.obstacle, frame.density, density)
    blend = shot.recipe.blend
    result = Stylized(np.float32((1.0 - blend) * frame.density + blend * np.maximum(density, 0)), velocity)
    fields = parameters.arrays()
    result.potential = fields.get("phi"), fields.get("psi")
    result.history = state.history(shot.name)
    for entry in result.history:
        name = f"octave {entry['octave']}"
        result.timings[name] = result.timings.get(name, 0.0) + entry["seconds"]
    result.timings["total"] = sum(result.timings.values())
    return result


def _unchanged(frame: Frame, shot: Shot) -> Stylized:
    result = Stylized(frame.density.copy(), np.zeros((*frame.density.shape, 3), np.float32))
    if shot.still:
        seen = f"renders black at gamma {shot.recipe.gamma:g}" if frame.density.any() else "is empty"
        result.note = f"{frame.name} {seen}: nothing to stylize, left unchanged"
    return result
