"""The plan, made before anything is computed: the octaves, and the recipe and step size of each frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.density_unit import scaled
from tnst_mi.fields.grid import Octave, Shape
from tnst_mi.fields.resampling import resample_mask
from tnst_mi.frame import Frame
from tnst_mi.losses.objective import Objective
from tnst_mi.optimisation.colouring import COLOUR, Coloured, ColourPullback, Colours, colour_step, mean_colour
from tnst_mi.optimisation.goals import objective_of, term_weights
from tnst_mi.optimisation.parameterisation import DensityOffset, Fields, Parameterisation, Transport
from tnst_mi.optimisation.silhouette import displacement_allowed
from tnst_mi.optimisation.start import Start
from tnst_mi.optimisation.temporal.window import window_of, window_weights
from tnst_mi.recipe.combinations import require_averageable, require_one_transport
from tnst_mi.recipe.lengths import in_cells
from tnst_mi.recipe.quality import iterations_run
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.targets import Target, targets_of
from tnst_mi.regions.regions import Regions
from tnst_mi.rendering.levels import Level, by_frame, full_level, levels_of


@dataclass(frozen=True)
class FramePlan:
    """The plan of one frame.

    Attributes:
        index: its position in the sequence, from 0.
        name: its name in files and in the log.
        number: the number that seeds its views, 0 or more.
        recipe: the recipe at this frame, with γ per full-resolution cell.
        step_scale: the factor of η, the σ of paper Eq. 2: S_t / max_t S_t, or 1 where σ is part of the loss; 0 for a
            frame that is left unchanged.
        exposure: factor from the frame's rendered images to the network's [0, 1].
        parameterisation: what is optimised, and how a density follows from it.
        weights: for each target, those of the terms of its loss; None if the objective has its own.
        reach: how far its smoke may be moved, in full-resolution cells; None for any distance.
        keep_silhouette: how far its outline in the main view may move, likewise.
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
    reach: float | None
    keep_silhouette: float | None
    shares: tuple[float, ...] = (1.0,)

    @property
    def eta(self) -> float:
        """The step size η_t."""
        return self.recipe.eta * self.step_scale

    def colour_step(self, gradient: Fields, region: mi.TensorXf | None, share: float) -> Fields:
        """The step of colours for their part of a target's gradient, which is taken out of it; nothing without one."""
        of_colour = gradient.pop(COLOUR, None)
        if of_colour is None:
            return Fields()
        size = self.recipe.colour_eta * self.step_scale * share
        return Fields({COLOUR: colour_step(of_colour, region, size, self.recipe.colour_smoothness)})

    def coloured(
        self, fields: Fields, start: mi.TensorXf | None, h: float, followed: bool = True
    ) -> tuple[mi.TensorXf | None, ColourPullback]:
        """`Coloured.colour_with_pullback` for the fields of an octave; no colours without a start."""
        if start is None or not isinstance(self.parameterisation, Coloured):
            return None, ColourPullback(None, None)
        return self.parameterisation.colour_with_pullback(fields, start, h, followed)

    def in_gamut(self, fields: Fields, start: mi.TensorXf | None, h: float) -> Fields:
        """The fields, with colours that are some."""
        if start is None or not isinstance(self.parameterisation, Coloured):
            return fields
        return self.parameterisation.in_gamut(fields, start, h)

    @property
    def still(self) -> bool:
        """Whether the frame is invisible and therefore stays unchanged."""
        return self.step_scale == 0.0

    @property
    def keeps_silhouette(self) -> bool:
        """Whether how far a cell may be moved depends on where it is."""
        return self.keep_silhouette is not None and isinstance(self.parameterisation.of_density, Transport)

    def within_reach(self, fields: Fields, h: float, allowed: mi.TensorXf | None = None) -> Fields:
        """The fields of the frame, on cells of size h, scaled down to how far its smoke may be moved.

        `allowed` says so of each cell, see `Plan.allowed`; without it, it is the same for all.
        """
        reach = self.reach if allowed is None else allowed
        return fields if reach is None else self.parameterisation.within(fields, reach, h)

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
        start: where the fields begin; None if that is at 0 in the first octave.
        colours: those with which the smoke begins; None if they are not optimised.
    """

    recipe: Recipe
    frames: tuple[FramePlan, ...]
    shape: Shape
    density_scale: float
    objectives: tuple[Objective, ...]
    regions: Regions | None = None
    start: Start | None = None
    colours: Colours | None = None

    @cached_property
    def octaves(self) -> list[Level]:
        """The octaves, from coarse to fine."""
        return levels_of(self.recipe, self.shape)

    def iterations(self, octave: int) -> int:
        """How many iterations an octave has, counted from 0."""
        return iterations_run(self.recipe, octave)

    @property
    def first_octave(self) -> int:
        """The octave in which the fields begin."""
        return 0 if self.start is None else self.start.octave

    def iterations_of(self, frame: FramePlan) -> int:
        """How many iterations a run has for a frame, without those that an earlier run has done for it."""
        each = sum(self.iterations(octave) for octave in range(self.first_octave, len(self.octaves)))
        return each if self.start is None else each - self.start.iterations[frame.name]

    @property
    def full(self) -> Level:
        """The frames' own grid."""
        return full_level(self.recipe, self.shape)

    def allowed(self, frame: FramePlan, source: Frame, grid: Octave) -> mi.TensorXf | None:
        """How far each cell of a grid may be moved, in full-resolution cells; None if it is the same for all.

        Args:
            frame: the plan of a frame.
            source: the frame.
            grid: an octave, or the full grid.
        """
        if frame.keep_silhouette is None or not frame.keeps_silhouette:
            return None
        density = scaled(source.density, self.density_scale)
        allowed = displacement_allowed(density, frame.recipe, self.full.size, frame.keep_silhouette)
        if frame.reach is not None:
            allowed = np.minimum(allowed, frame.reach)
        resampled = resample_mask(mi.TensorXf(allowed), 1.0, grid.shape, grid.cell_size)
        # Next to the border of a coarser grid, means count what is outside as 0.
        return dr.maximum(resampled, float(allowed.min()))

    @property
    def rows(self) -> int:
        """H of the full grid."""
        return self.shape[1]

    @property
    def window(self) -> int:
        """Number of frames in a window; 1 for a single frame."""
        return self.recipe.window if len(self.frames) > 1 else 1

    @property
    def averages_smoke(self) -> bool:
        """Whether a window's average is that over smoke."""
        return self.window > 1 and self.recipe.window_average == "smoke"

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

    def followed_by(self, index: int) -> list[int]:
        """The frames, among those that are changed, whose steps a frame follows: those of its window."""
        window = window_of(index, len(self.frames), self.window)
        return [i for i in window if not self.frames[i].still]

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
    colour_names: Sequence[str | None] = (),
    colour_written: str = "Cd",
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
        colour_names: where colours are optimised, the grid of those with which each frame begins, None if it has none.
        colour_written: the grid in which they are written.

    Raises:
        InputError: the recipe's window cannot be averaged as it says, its keys of the transport do not belong together,
            or an objective of its terms cannot be made.
    """
    require_averageable(recipe)
    require_one_transport(recipe)
    targets = targets_of(recipe)
    recipes = by_frame(recipe, numbers, shape)
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
            _parameterisation(at_frame, max(lams) > 0, min(lams) < 1, own is not None),
            None if objective is not None else tuple(_weights(target, number) for target in targets),
            in_cells(recipe.reach, shape[1]),
            in_cells(recipe.keep_silhouette, shape[1]),
            tuple(target.weight(number) for target in targets),
        )
        for index, (name, number, at_frame, scale, exposure, own) in enumerate(
            zip(names, numbers, recipes, step_scales, exposures, colour_names or [None] * len(names), strict=True)
        )
    )
    objectives = (objective,) if objective is not None else tuple(objective_of(target.recipe) for target in targets)
    colours = None
    if recipe.colour == "style":
        size, unweighted = full_level(recipe, shape).size, (None,) * len(objectives)
        means = tuple(
            tuple(mean_colour(*pair, size) for pair in zip(objectives, frame.weights or unweighted, strict=True))
            for frame in frames
        )
        colours = Colours(frozenset(name for name in colour_names if name is not None), colour_written, means)
    return Plan(recipe, frames, shape, density_scale, objectives, regions, colours=colours)


def _parameterisation(recipe: Recipe, scalar: bool, vector: bool, coloured: bool) -> Parameterisation:
    """That of the recipe of a frame.

    `scalar`, `vector`: whether frames of the sequence have a Φ, a Ψ; `coloured`: whether this one has its own colours.
    """
    if recipe.parameterisation == "density":
        of_density: Parameterisation = DensityOffset()
    else:
        of_density = Transport(
            recipe.lam, recipe.steps, scalar, vector, recipe.transport, recipe.stages, recipe.conservative
        )
    if recipe.colour != "style":
        return of_density
    return Coloured(of_density, coloured)


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
