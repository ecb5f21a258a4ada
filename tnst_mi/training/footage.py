"""The smoke that a network learns from: frames of an input with their mirror images, and the loss of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.density_unit import ReferenceDensity, scaled
from tnst_mi.fields.resampling import resample_density
from tnst_mi.frame import Frame
from tnst_mi.losses.scales import rms_scales
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.gradient import OctaveProblem, problem_of
from tnst_mi.optimisation.parameterisation import Fields
from tnst_mi.optimisation.plan import FramePlan, Plan, plan_of
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.exposure import brightness
from tnst_mi.rendering.levels import by_frame, levels_seen

#: Number of frames, evenly spaced, from whose images the terms of the loss get their scales.
_CALIBRATING = 4


@dataclass(frozen=True)
class Take:
    """A frame as it is shown to the network.

    Attributes:
        plan: of the frame.
        density: (D, H, W) in the run's unit, on the grid of the finest octave.
        full: the same on the frame's own grid.
    """

    plan: FramePlan
    density: mi.TensorXf
    full: mi.TensorXf


class Footage:
    """An input and its loss.

    Attributes:
        name: of the input.
        problem: of the finest octave.
    """

    def __init__(self, name: str, frames: Sequence[Frame], recipe: Recipe, network: GoogLeNet) -> None:
        """Measure the frames.

        Raises:
            InputError: no frame has smoke, frames differ in shape, or the recipe cannot be used.
        """
        self.name, self._frames = name, frames
        shape = frames[0].density.shape
        reference = ReferenceDensity()
        for frame in frames:
            if frame.density.shape != shape:
                raise InputError(f"{frame.name}: has shape {frame.density.shape}, expected {shape} as the first frame")
            reference.add(frame.density)
        self._scale = reference.scale(recipe.density_scale)
        numbers = [frame.number for frame in frames]
        recipes = by_frame(recipe, numbers, shape)
        bright = brightness(frames, recipes, levels_seen(recipe, shape), self._scale)
        self._plan = plan_of(
            recipe,
            [frame.name for frame in frames],
            numbers,
            [of_frame.step_scale for of_frame in bright],
            [of_frame.exposure for of_frame in bright],
            shape,
            self._scale,
        )
        if not self._plan.alive:
            raise InputError(f"{name}: has no smoke that can be seen at this gamma, so there is nothing to learn from")
        self.problem = problem_of(self._plan, self._plan.octaves[-1], network)
        self.problem = self._calibrated(self.problem)

    def __len__(self) -> int:
        """Number of frames with smoke."""
        return len(self._plan.alive)

    @property
    def plan(self) -> Plan:
        """The plan of the frames."""
        return self._plan

    def take(self, position: int, mirrored: tuple[bool, bool] = (False, False)) -> Take:
        """A frame with smoke, mirrored along z and x or not: smoke rises along y."""
        plan = self._plan.alive[position]
        density = scaled(self._frames[plan.index].density, self._scale)
        axes = tuple(axis for axis, flipped in zip((0, 2), mirrored, strict=True) if flipped)
        octave, full = self.problem.octave, mi.TensorXf(np.ascontiguousarray(np.flip(density, axes), np.float32))
        return Take(plan, resample_density(full, 1.0, octave.shape, octave.cell_size), full)

    def judged(self, take: Take, fields: Fields) -> float:
        """The loss of a frame that is transported by fields, in the fixed views."""
        parameterisation, full = take.plan.parameterisation, self._plan.full
        with dr.suspend_grad():
            fields = parameterisation.carried(fields, self.problem.octave, full)
            moved = parameterisation.density(fields, take.full, full.cell_size)
        return self.problem.judge(take.plan, moved.numpy())[0]

    def zeros(self) -> Fields:
        """The fields that leave smoke as it is."""
        return self._plan.alive[0].parameterisation.zeros(self.problem.octave)

    def _calibrated(self, problem: OctaveProblem) -> OctaveProblem:
        if self._plan.recipe.loss_scaling == "none":
            return problem
        chosen = np.unique(np.linspace(0, len(self) - 1, _CALIBRATING).round().astype(int))
        return problem.scaled(rms_scales(self._square_sums(problem, chosen)))

    def _square_sums(self, problem: OctaveProblem, chosen: np.ndarray) -> Iterator[dict[str, tuple[float, int]]]:
        for position in chosen:
            take = self.take(int(position))
            seed = take.plan.seed(len(self._plan.octaves) - 1, 0)
            zeros = take.plan.parameterisation.zeros(problem.octave)
            yield problem.gradient_square_sum(take.plan, zeros, take.density, seed)


#: All ways to mirror a frame.
MIRRORINGS = ((False, False), (False, True), (True, False), (True, True))
