"""Entering an octave: its items, computed from those of the previous octave, and the scales of its loss."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

from tnst_mi.frame import Frame
from tnst_mi.losses.scales import rms_scales
from tnst_mi.machine.backend import release_memory
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.gradient import OctaveProblem, problem_of
from tnst_mi.optimisation.items.damage import DamagedItemError
from tnst_mi.optimisation.items.device_store import DeviceStore
from tnst_mi.optimisation.items.interface import Store
from tnst_mi.optimisation.items.state import Current, Items
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
    forget(earlier)
    for frame in each(plan.alive if windowed and plan.recipe.window_average == "smoke" else ()):
        items.enter_gain(frame)
    return items


def forget(earlier: Sequence[Items]) -> None:
    """Remove the items of octaves that are done, but for the fields of the last one.

    Should an item of the octave that begins with these be damaged, it can be begun again: see `items.mending`.
    """
    for octave in earlier:
        octave.forget(keep_fields=octave is earlier[-1])


def calibrated(plan: Plan, items: Items, network: GoogLeNet, store: DeviceStore, each: Each) -> OctaveProblem:
    """The problem of an octave, its terms scaled by the RMS of their image gradients, pooled over the sequence.

    Without loss scaling, all scales are 1.

    Raises:
        DamagedItemError: the scales with which the octave began have got lost.
    """
    problem, name = problem_of(plan, items.octave, network), f"scales.{items.level}"
    scales = known_scales(plan, items, store.backing, lambda: problem.scales)
    if scales is None:
        scales = rms_scales(calibration(problem, now, items.level) for now in items.current(each(plan.alive)))
        store.backing.write_numbers(name, scales)
    return problem.scaled(scales)


def known_scales(
    plan: Plan, items: Items, store: Store, ones: Callable[[], dict[str, float]]
) -> dict[str, float] | None:
    """The scales of an octave's loss where they need not be measured; None if they have to be.

    Args:
        plan: of the sequence.
        items: of the octave.
        store: has them if they were measured before.
        ones: gives the scales of a loss that is not scaled.

    Raises:
        DamagedItemError: the scales with which the octave began have got lost.
    """
    name = f"scales.{items.level}"
    if (scales := store.numbers(name)) is not None:
        return scales
    if plan.start is not None and items.level == plan.start.octave and plan.start.scales:
        scales = dict(plan.start.scales)
    elif any(items.iterations_done(frame) > begun(plan, items.level, frame) for frame in plan.alive):
        raise DamagedItemError(name, "they have got lost")
    elif plan.recipe.loss_scaling == "none":
        scales = ones()
    else:
        return None
    store.write_numbers(name, scales)
    return scales


def begun(plan: Plan, level: int, frame: FramePlan) -> int:
    """With how many iterations of an octave a run begins for a frame: those of what it goes on from."""
    return 0 if plan.start is None or plan.start.octave != level else plan.start.iterations[frame.name]


def calibration(problem: OctaveProblem, now: Current, level: int) -> dict[str, tuple[float, int]]:
    """What a frame contributes to the scales of an octave's loss, see `gradient_square_sum`."""
    seed, inputs = now.frame.seed(level, 0), now.inputs
    return problem.gradient_square_sum(now.frame, now.fields, inputs.density, seed, inputs.regions, inputs.colour)
