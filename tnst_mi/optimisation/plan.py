"""What is planned before anything is computed: the octaves, and for each frame its recipe and its step size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tnst_mi.fields.grid import Octave, Shape, octaves
from tnst_mi.losses.objective import Objective
from tnst_mi.optimisation.goals import objective_of, term_weights
from tnst_mi.optimisation.parameterisation import DensityOffset, Parameterisation, Transport
from tnst_mi.optimisation.window import window_weights
from tnst_mi.recipe.recipe import Recipe


@dataclass(frozen=True)
class FramePlan:
    """What is planned for a frame.

    Attributes:
        index: its place in the sequence, from 0.
        name: what files and the log call it.
        number: what seeds its views.
        recipe: the recipe at this frame.
        step_scale: the factor S_t / max_t S_t of η (the σ of paper Eq. 2).
        parameterisation: what is optimised, and how a density follows from it.
        weights: of the terms of the loss; None where the objective has its own.
    """

    index: int
    name: str
    number: int
    recipe: Recipe
    step_scale: float
    parameterisation: Parameterisation
    weights: tuple[float, ...] | None

    @property
    def eta(self) -> float:
        """The step size η_t."""
        return self.recipe.eta * self.step_scale

    @property
    def still(self) -> bool:
        """Nothing is seen of the frame, so nothing of it is changed."""
        return self.step_scale == 0.0

    def seed(self, octave: int, iteration: int) -> tuple[int, ...]:
        """What the views of an iteration, and the renderer where it is random, are drawn from."""
        return self.recipe.seed, self.number, octave, iteration


@dataclass(frozen=True)
class Plan:
    """What is planned for a sequence.

    Attributes:
        recipe: of the sequence.
        frames: the plans of the frames, in their order.
        shape: (D, H, W) of the frames.
        exposure: factor from rendered images to the network's [0, 1].
        objective: what to minimise.
    """

    recipe: Recipe
    frames: tuple[FramePlan, ...]
    shape: Shape
    exposure: float
    objective: Objective

    @cached_property
    def octaves(self) -> list[Octave]:
        """From coarse to fine."""
        return octaves(self.shape, self.recipe.octaves, self.recipe.scale_factor)

    @property
    def rows(self) -> int:
        """H of the full grid."""
        return self.shape[1]

    @property
    def window(self) -> int:
        """Frames in a window; a single frame has no other to follow."""
        return self.recipe.window if len(self.frames) > 1 else 1

    @cached_property
    def window_weights(self) -> np.ndarray:
        """ω by distance (paper Eq. 9)."""
        return window_weights(self.window, self.recipe.window_weights)

    @cached_property
    def alive(self) -> list[FramePlan]:
        """The frames that are changed."""
        return [frame for frame in self.frames if not frame.still]

    @property
    def groups(self) -> list[list[FramePlan]]:
        """The frames that follow each other's steps: with a window all of them, without each by itself."""
        return [self.alive] if self.window > 1 else [[frame] for frame in self.alive]


def plan_of(
    recipe: Recipe,
    names: Sequence[str],
    numbers: Sequence[int | None],
    step_scales: Sequence[float],
    shape: Shape,
    exposure: float,
    objective: Objective | None = None,
) -> Plan:
    """Plan a sequence.

    Args:
        recipe: what to stylize towards, and how.
        names: of the frames.
        numbers: of the frames, None where a frame has none.
        step_scales: factors of η, S_t / max_t S_t with the pixel sums S_t of the unstylized main views; a frame with 0
            is left unchanged.
        shape: (D, H, W) of the frames.
        exposure: factor from rendered images to the network's [0, 1].
        objective: what to minimise, in place of the recipe's terms.
    """
    recipes = [recipe.at(number) for number in numbers]
    # All frames have the same fields, also where λ goes from 0 to 1 over the sequence.
    lams = [at_frame.lam for at_frame in recipes]
    frames = tuple(
        FramePlan(
            index,
            name,
            index if number is None else number,
            at_frame,
            scale,
            DensityOffset()
            if recipe.parameterisation == "density"
            else Transport(at_frame.lam, recipe.steps, max(lams) > 0, min(lams) < 1),
            None if objective is not None else tuple(term_weights(at_frame)),
        )
        for index, (name, number, at_frame, scale) in enumerate(zip(names, numbers, recipes, step_scales, strict=True))
    )
    return Plan(recipe, frames, shape, exposure, objective or objective_of(recipe))
