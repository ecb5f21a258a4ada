"""Entering an octave: its items, computed from those of the previous octave, and the scales of its loss."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

from tnst_mi.frame import Frame
from tnst_mi.losses.evaluation import rms_scales
from tnst_mi.machine.backend import release_memory
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.gradient import OctaveProblem, problem_of
from tnst_mi.optimisation.items.device_store import DeviceStore
from tnst_mi.optimisation.items.state import Items
from tnst_mi.optimisation.items.store import DamagedItemError
from tnst_mi.optimisation.plan import FramePlan, Plan

#: Yields the given frames one by one; a run may end in between.
Each = Callable[[Iterable[FramePlan]], Iterator[FramePlan]]


def reached(plan: Plan, store: DeviceStore) -> int:
    """The octave that a run has reached: the last one that all frames have entered."""
    for level in reversed(range(plan.first_octave, len(plan.octaves))):
        items = Items(plan, level, store)
        if all(items.iterations_done(frame) >= 0 for frame in plan.alive):
            return level
    return plan.first_octave


def levels_left(plan: Plan, store: DeviceStore) -> range:
    """The octaves that a run still has to process; none if no frame is changed."""
    return range(reached(plan, store) if plan.alive else len(plan.octaves), len(plan.octaves))


def entered(plan: Plan, level: int, frames: Sequence[Frame], store: DeviceStore, each: Each) -> Items:
    """The items of an octave, once every frame has entered it; those of earlier octaves are removed, but
    for the fields of the last one."""
    # Memory blocks of the previous octave are too small for this one.
    release_memory()
    items, windowed = Items(plan, level, store), plan.window > 1
    earlier = [Items(plan, before, store) for before in range(plan.first_octave, level)]
    # Neighbours are transported through unchanged frames too.
    for frame in each(plan.frames if windowed else plan.alive):
        items.enter_inputs(frame, frames[frame.index])
    for frame in each(plan.alive):
        items.enter_fields(frame, earlier[-1] if earlier else None)
    if windowed and plan.alive:
        items.require_in_step()
    for octave in earlier:
        # Should an item of this octave be damaged, it can be begun again: see `items.mending`.
        octave.forget(keep_fields=octave is earlier[-1])
    for frame in each(plan.alive if windowed and plan.recipe.window_average == "smoke" else ()):
        items.enter_gain(frame)
    return items


def calibrated(plan: Plan, items: Items, network: GoogLeNet, store: DeviceStore, each: Each) -> OctaveProblem:
    """The problem of an octave, its terms scaled by the RMS of their image gradients, pooled over the sequence.

    Without loss scaling, all scales are 1.

    Raises:
        DamagedItemError: the scales with which the octave began have got lost.
    """
    problem, name = problem_of(plan, items.octave, network), f"scales.{items.level}"
    scales = store.backing.numbers(name)
    if scales is None and plan.start is not None and items.level == plan.start.octave and plan.start.scales:
        scales = dict(plan.start.scales)
        store.backing.write_numbers(name, scales)
    if scales is None and any(items.iterations_done(frame) > 0 for frame in plan.alive):
        raise DamagedItemError(name, "they have got lost")
    if scales is None and plan.recipe.loss_scaling == "none":
        scales = problem.scales
        store.backing.write_numbers(name, scales)
    elif scales is None:
        scales = rms_scales(
            problem.gradient_square_sum(
                now.frame, now.fields, now.inputs.density, now.frame.seed(items.level, 0), now.inputs.regions
            )
            for now in items.current(each(plan.alive))
        )
        store.backing.write_numbers(name, scales)
    return problem.scaled(scales)
