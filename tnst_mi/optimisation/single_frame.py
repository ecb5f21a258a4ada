"""Stylizing a single frame (paper Eq. 4 and section 4): a sequence of one."""

from __future__ import annotations

from collections.abc import Callable

from tnst_mi.fields.density_unit import ReferenceDensity
from tnst_mi.frame import Frame
from tnst_mi.losses.objective import Objective
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.items.store import MemoryStore
from tnst_mi.optimisation.plan import plan_of
from tnst_mi.optimisation.result import Progress, Stylized
from tnst_mi.optimisation.runner import SequenceOptimisation
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.regions.regions import regions_of
from tnst_mi.rendering.cameras.shots import shot_views, with_shots
from tnst_mi.rendering.exposure import brightness
from tnst_mi.rendering.levels import by_frame, levels_seen
from tnst_mi.rendering.smoke_colour import colour_name


def optimise(
    frame: Frame,
    recipe: Recipe,
    network: GoogLeNet,
    exposure: float | None = None,
    on_iteration: Callable[[Progress], None] | None = None,
    step_scale: float = 1.0,
    objective: Objective | None = None,
) -> Stylized:
    """Stylize one frame.

    Ctrl-C ends the optimisation after the current iteration, a second one immediately.

    Args:
        frame: the frame; one that is empty or renders black is returned unchanged, with a note.
        recipe: what to stylize towards, and how.
        network: the GoogLeNet that judges the images; it is moved to the device of the active variant.
        exposure: factor from rendered images to the network's [0, 1]; None takes that of a run of this frame alone.
        on_iteration: called after every iteration.
        step_scale: factor of η for this frame, S_t / max_t S_t (the σ of paper Eq. 2; 1 for a single frame).
        objective: what to minimise instead of the recipe's terms; for terms that no recipe can name.

    Raises:
        InputError: the network lacks a layer, channel or class, a picture cannot be used, or the loss is not finite.
    """
    reference = ReferenceDensity()
    reference.add(frame.density)
    density_scale = reference.scale(recipe.density_scale)
    shape = frame.density.shape
    recipe = with_shots(recipe, shot_views(recipe, [frame], shape))
    (at_frame,) = by_frame(recipe, [frame.number], shape)
    (alone,) = brightness([frame], [at_frame], levels_seen(recipe, shape), density_scale)
    scales, exposures = [step_scale * alone.step_scale], [alone.exposure if exposure is None else exposure]
    regions = regions_of(recipe, [frame], [frame.number])
    plan = plan_of(
        recipe,
        [frame.name],
        [frame.number],
        scales,
        exposures,
        shape,
        density_scale,
        objective,
        regions,
        [colour_name(frame.grids)],
    )
    ((_, stylized),) = SequenceOptimisation(plan, [frame], network, MemoryStore()).run(on_iteration)
    return stylized
