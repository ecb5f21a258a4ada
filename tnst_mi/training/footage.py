"""The smoke that a network learns from: frames of an input with their mirror images, and the loss of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.density_unit import ReferenceDensity, scaled
from tnst_mi.fields.kernels import opaque
from tnst_mi.fields.resampling import resample_density, resample_velocity
from tnst_mi.frame import Frame
from tnst_mi.io.files.frame_numbers import frame_step, is_next
from tnst_mi.losses.scales import rms_scales
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.gradient import OctaveProblem, problem_of
from tnst_mi.optimisation.parameterisation import Fields, Transport
from tnst_mi.optimisation.plan import FramePlan, Plan, plan_of
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.exposure import brightness, exposure_of_thicker
from tnst_mi.rendering.levels import by_frame, levels_seen

#: Number of frames, evenly spaced, from whose images the terms of the loss get their scales.
_CALIBRATING = 4


@dataclass(frozen=True)
class Showing:
    """How a frame is shown to the network: what of it is changed, so that it has seen more than it was given.

    Attributes:
        mirrored: along z and along x; smoke rises along y.
        zoom: how many times larger it is, around the centre of its grid, which cuts off what is beyond.
        thicker: factor of its optical thickness, as by another γ.
        lam: λ of the velocity; None for that of the recipe.
    """

    mirrored: tuple[bool, bool] = (False, False)
    zoom: float = 1.0
    thicker: float = 1.0
    lam: float | None = None


@dataclass(frozen=True)
class Take:
    """A frame as it is shown to the network.

    Attributes:
        plan: of the frame.
        density: (D, H, W) in the run's unit, on the grid of the finest octave.
    """

    plan: FramePlan
    density: mi.TensorXf


#: A frame without any change.
AS_IT_IS = Showing()


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
        self._step = frame_step(numbers)
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
        self.problem = self._calibrated(problem_of(self._plan, self._plan.octaves[-1], network))

    def __len__(self) -> int:
        """Number of frames with smoke."""
        return len(self._plan.alive)

    @property
    def plan(self) -> Plan:
        """The plan of the frames."""
        return self._plan

    def take(self, position: int, showing: Showing = AS_IT_IS) -> Take:
        """A frame with smoke, as it is to be shown."""
        plan, octave = self._plan.alive[position], self._plan.octaves[-1]
        density = mi.TensorXf(_flipped(self._full(plan).numpy(), showing.mirrored))
        density = resample_density(density, 1.0, octave.shape, octave.cell_size / showing.zoom)
        return Take(_shown(plan, showing), density * opaque(showing.thicker))

    def carrying(self, position: int, direction: int, showing: Showing) -> tuple[int, mi.TensorXf] | None:
        """The neighbour of a frame before it (direction −1) or after it (1), and how its smoke moves to the frame.

        Returns:
            The neighbour's position, and a displacement (D, H, W, 3) in full-resolution cells on the grid of the
            finest octave; None if there is no neighbour with smoke, or it is farther away than others are, or there is
            no velocity between them.
        """
        index, octave = self._plan.alive[position].index + direction, self.problem.octave
        other = next((place for place, plan in enumerate(self._plan.alive) if plan.index == index), None)
        if other is None:
            return None
        first, second = sorted((index, index - direction))
        number, following = self._frames[first].number, self._frames[second].number
        velocity, step = self._frames[first].velocity, self._step
        apart = number is not None and following is not None and not is_next(number, following, step)
        if velocity is None or apart:
            return None
        along_z, along_x = showing.mirrored
        signs = np.array([-1 if along_x else 1, 1, -1 if along_z else 1], np.float32)
        u = mi.TensorXf(_flipped(velocity, showing.mirrored) * signs)
        u = resample_velocity(u, 1.0, octave.shape, octave.cell_size / showing.zoom)
        return other, u * opaque(-direction * showing.zoom * step)

    def moved(self, position: int, fields: Fields) -> np.ndarray:
        """A frame, transported by fields of the finest octave: (D, H, W) in the run's unit, on its own grid."""
        plan, full = self._plan.alive[position], self._plan.full
        with dr.suspend_grad():
            fields = plan.parameterisation.carried(fields, self.problem.octave, full)
            return plan.parameterisation.density(fields, self._full(plan), full.cell_size).numpy()

    def judged(self, position: int, fields: Fields) -> float:
        """The loss of a frame that is transported by fields, in the fixed views."""
        return self.problem.judge(self._plan.alive[position], self.moved(position, fields))[0]

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

    def _full(self, plan: FramePlan) -> mi.TensorXf:
        """A frame's density in the run's unit, on its own grid."""
        return mi.TensorXf(scaled(self._frames[plan.index].density, self._scale))


def _flipped(field: np.ndarray, mirrored: tuple[bool, bool]) -> np.ndarray:
    """A field (D, H, W, …), mirrored along z and x or not."""
    axes = tuple(axis for axis, flipped in zip((0, 2), mirrored, strict=True) if flipped)
    return np.ascontiguousarray(np.flip(field, axes), np.float32)


def _shown(plan: FramePlan, showing: Showing) -> FramePlan:
    """The plan of a frame as it is shown: as bright, though thicker, and with λ."""
    recipe, parameterisation = plan.recipe, plan.parameterisation
    exposure = exposure_of_thicker(plan.exposure, showing.thicker * showing.zoom, recipe)
    if showing.lam is not None:
        recipe = recipe.updated({"lam": showing.lam}, "lam: ", Path.cwd())
        parameterisation = Transport(
            recipe.lam, recipe.steps, None, None, recipe.transport, recipe.stages, recipe.conservative
        )
    return replace(plan, recipe=recipe, parameterisation=parameterisation, exposure=exposure)
