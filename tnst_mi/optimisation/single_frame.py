"""Stylizing a single frame (paper Eq. 4 and section 4): a sequence of one."""

from __future__ import annotations

from collections.abc import Callable

from tnst_mi.frame import Frame
from tnst_mi.losses.objective import Objective
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.items.store import MemoryStore
from tnst_mi.optimisation.plan import plan_of
from tnst_mi.optimisation.result import Progress, Stylized
from tnst_mi.optimisation.runner import SequenceOptimisation
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.driving import exposure_for, main_view


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
        exposure: factor from rendered images to the network's [0, 1]; None takes 1 / max of this frame's main view.
        on_iteration: called after every iteration.
        step_scale: factor of η for this frame, S_t / max_t S_t (the σ of paper Eq. 2; 1 for a single frame).
        objective: what to minimise instead of the recipe's terms; for terms that no recipe can name, such as
            `losses.terms.Match`.

    Raises:
        InputError: the network lacks a layer, channel or class, a picture cannot be used, or the loss is not finite.
    """
    brightest = float(main_view(frame.density, recipe.at(frame.number)).max())
    if exposure is None:
        exposure = exposure_for(brightest)
    scales = [step_scale if brightest > 0 else 0.0]
    plan = plan_of(recipe, [frame.name], [frame.number], scales, frame.density.shape, exposure, objective)
    ((_, stylized),) = SequenceOptimisation(plan, [frame], network, MemoryStore()).run(on_iteration)
    return stylized
