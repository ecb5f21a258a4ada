"""The plan, made before anything is computed: the octaves, and the recipe and step size of each frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Octave, Shape, octaves
from tnst_mi.losses.objective import Objective
from tnst_mi.optimisation.goals import objective_of, term_weights
from tnst_mi.optimisation.parameterisation import DensityOffset, Parameterisation, Transport
from tnst_mi.optimisation.temporal.window import window_weights
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.targets import Target, targets_of
from tnst_mi.regions.regions import Regions
from tnst_mi.rendering.driving import image_size


@dataclass(frozen=True)
class FramePlan:
    """The plan of one frame.

    Attributes:
        index: its position in the sequence, from 0.
        name: its name in files and in the log.
        number: the number that seeds its views, 0 or more.
        recipe: the recipe at this frame.
        step_scale: the factor of η, the σ of paper Eq. 2: S_t / max_t S_t, or 1 where σ is part of the loss; 0 for a
            frame that is left unchanged.
        exposure: factor from the frame's rendered images to the network's [0, 1].
        parameterisation: what is optimised, and how a density follows from it.
        weights: for each target, those of the terms of its loss; None if the objective has its own.
        shares: for each target, the factor of its steps.
    """

    index: int
    name: str
    number: int
    recipe: Recipe
    step_scale: float
    exposure: float
    parameterisation: Parameterisation
    weights: tuple[tuple[float, ...], ...] | None
    shares: tuple[float, ...] = (1.0,)

    @property
    def eta(self) -> float:
        """The step size η_t."""
        return self.recipe.eta * self.step_scale

    @property
    def still(self) -> bool:
        """Whether the frame is invisible and therefore stays unchanged."""
        return self.step_scale == 0.0

    def seed(self, octave: int, iteration: int) -> tuple[int, ...]:
        """The seed of the views of an iteration, and of the renderer where it is random."""
        return self.recipe.seed, self.number, octave, iteration


@dataclass(frozen=True)
class Plan:
    """The plan of a sequence.

    Attributes:
        recipe: of the sequence.
        frames: the plans of the frames, in their order.
        shape: (D, H, W) of the frames.
        density_scale: factor of the frames' densities, see `fields.density_unit`.
        objectives: what to minimise, for each target.
        regions: the masks of the targets; None if there is one target, which applies everywhere.
    """

    recipe: Recipe
    frames: tuple[FramePlan, ...]
    shape: Shape
    density_scale: float
    objectives: tuple[Objective, ...]
    regions: Regions | None = None

    @cached_property
    def octaves(self) -> list[Octave]:
        """The octaves, from coarse to fine."""
        return octaves(self.shape, self.recipe.octaves, self.recipe.scale_factor)

    def image_size(self, octave: Octave) -> tuple[int, int]:
        """Rows and columns of the images of an octave."""
        return image_size(self.recipe, octave.shape)

    @property
    def rows(self) -> int:
        """H of the full grid."""
        return self.shape[1]

    @property
    def window(self) -> int:
        """Number of frames in a window; 1 for a single frame."""
        return self.recipe.window if len(self.frames) > 1 else 1

    @property
    def averages_gradients(self) -> bool:
        """Whether a window averages gradients, of which a step is then made, rather than steps (paper Alg. 1)."""
        return self.window > 1 and self.recipe.step_order == "align_first"

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
        """Groups of changed frames that share their steps: all of them with a window, single frames without."""
        return [self.alive] if self.window > 1 else [[frame] for frame in self.alive]


def plan_of(
    recipe: Recipe,
    names: Sequence[str],
    numbers: Sequence[int | float | None],
    step_scales: Sequence[float],
    exposures: Sequence[float],
    shape: Shape,
    density_scale: float = 1.0,
    objective: Objective | None = None,
    regions: Regions | None = None,
) -> Plan:
    """Plan a sequence.

    Args:
        recipe: what to stylize towards, and how.
        names: of the frames.
        numbers: of the frames, None where a frame has none.
        step_scales: S_t / max_t S_t with the pixel sums S_t of the unstylized main views: factors of η, unless σ is
            part of the loss; a frame with 0 is left unchanged.
        exposures: factors from rendered images to the network's [0, 1].
        shape: (D, H, W) of the frames.
        density_scale: factor of the frames' densities.
        objective: what to minimise instead of the recipe's terms.
        regions: the masks of its targets, see `regions_of`.

    Raises:
        InputError: the recipe's window cannot be averaged as it says, its keys of the transport do not belong together,
            or an objective of its terms cannot be made.
    """
    require_averageable(recipe)
    require_one_transport(recipe)
    targets = targets_of(recipe)
    recipes = [recipe.at(number) for number in numbers]
    # All frames have the same fields, even if λ goes from 0 to 1 over the sequence.
    lams = [at_frame.lam for at_frame in recipes]
    frames = tuple(
        FramePlan(
            index,
            name,
            _seed_number(index, number),
            at_frame,
            float(scale > 0) if recipe.sigma == "loss" else scale,
            exposure,
            DensityOffset()
            if recipe.parameterisation == "density"
            else Transport(
                at_frame.lam,
                recipe.steps,
                max(lams) > 0,
                min(lams) < 1,
                recipe.transport,
                recipe.stages,
                recipe.conservative,
            ),
            None if objective is not None else tuple(_weights(target, number) for target in targets),
            tuple(target.weight(number) for target in targets),
        )
        for index, (name, number, at_frame, scale, exposure) in enumerate(
            zip(names, numbers, recipes, step_scales, exposures, strict=True)
        )
    )
    objectives = (objective,) if objective is not None else tuple(objective_of(target.recipe) for target in targets)
    return Plan(recipe, frames, shape, density_scale, objectives, regions)


def _weights(target: Target, number: int | float | None) -> tuple[float, ...]:
    """The weights of the terms of a target in a frame."""
    return tuple(term_weights(target.recipe.at(number)))


def _seed_number(index: int, number: int | float | None) -> int:
    """What seeds the views of a frame: its number, or its position if it has none.

    Numbers that are no seeds, negative ones and those of sub-frames, are moved beyond all that are.
    """
    if number is None:
        return index
    if number >= 0 and number == int(number):
        return int(number)
    return (1 << 60) + round(number * 1_000_000)


def require_averageable(recipe: Recipe) -> None:
    """Check that a window can be averaged as a recipe says.

    Raises:
        InputError: an average over smoke is wanted of gradients, which no mask has weighted, or gradients of several
            targets are to be averaged.
    """
    if recipe.window > 1 and recipe.step_order == "align_first" and recipe.window_average == "smoke":
        raise InputError(
            "step_order = 'align_first' averages gradients before the mask, so that window_average = 'smoke' has "
            "nothing to count smoke by; expected window_average = 'plain'"
        )
    if recipe.window > 1 and recipe.step_order == "align_first" and len(recipe.target) > 1:
        raise InputError(
            f"step_order = 'align_first' averages the gradients of one target, and there are {len(recipe.target)}; "
            "expected step_order = 'normalise_first'"
        )


def require_one_transport(recipe: Recipe) -> None:
    """Check that the keys of one kind of transport do not come with the other.

    Raises:
        InputError: they do.
    """
    if recipe.transport == "flow":
        other, foreign = "step", {"steps": recipe.steps != 1}
    else:
        other, foreign = "flow", {"stages": recipe.stages != "auto", "conservative": recipe.conservative}
    for name, given in foreign.items():
        if given:
            raise InputError(
                f"{name} = {getattr(recipe, name)!r} belongs to transport = {other!r}, and transport is "
                f"{recipe.transport!r}; expected one of them to be otherwise"
            )
