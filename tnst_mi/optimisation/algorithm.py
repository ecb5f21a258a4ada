"""Algorithm 1 of the paper: multi-view, time-coherent stylization, coarse to fine.

Its two steps are functions of items (see `state`), so they can be computed wherever the items are. The `Turns` decide
which frame is processed when, skip what an earlier run has already done, and handle interruption.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol, TypeVar

from tnst_mi.frame import Frame
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.gradient import OctaveProblem
from tnst_mi.optimisation.items.device_store import DeviceStore
from tnst_mi.optimisation.items.own_step import OwnStep
from tnst_mi.optimisation.items.state import Current, Items
from tnst_mi.optimisation.octave import calibrated, entered, levels_left
from tnst_mi.optimisation.parameterisation import Fields
from tnst_mi.optimisation.plan import FramePlan, Plan
from tnst_mi.optimisation.temporal.coherence import coherence_step

T = TypeVar("T")


class Turns(Protocol):
    """Schedules the frames."""

    def groups(self, items: Items) -> Sequence[Sequence[FramePlan]]:
        """The frames that follow each other's steps in an octave, without those that are no longer wanted."""
        ...

    def each(self, frames: Iterable[T]) -> Iterator[T]:
        """The given frames, one by one."""
        ...

    def steps_due(self, group: Sequence[FramePlan], items: Items, k: int) -> Iterator[Current]:
        """The frames whose own step of iteration k is still to be computed."""
        ...

    def octave_done(self, items: Items) -> None:
        """All frames have done all iterations of an octave."""
        ...

    def fields_due(self, group: Sequence[FramePlan], items: Items, k: int) -> Iterator[Current]:
        """The frames whose fields are still to be updated in iteration k."""
        ...


def algorithm_1(
    plan: Plan, frames: Sequence[Frame], network: GoogLeNet, store: DeviceStore, turns: Turns
) -> Iterator[tuple[FramePlan, Items, OctaveProblem]]:
    """Optimise the fields of all frames; yield each, with the finest items and problem, once its fields are final."""
    for level in levels_left(plan, store):
        items = entered(plan, level, frames, store, turns.each)
        yield from iterated(plan, items, calibrated(plan, items, network, store, turns.each), turns)
        turns.octave_done(items)


def iterated(
    plan: Plan, items: Items, problem: OctaveProblem, turns: Turns
) -> Iterator[tuple[FramePlan, Items, OctaveProblem]]:
    """The iterations of one octave; if it is the finest, yields each frame after its last."""
    for group in turns.groups(items):
        for k in range(plan.iterations(items.level)):
            for f in turns.steps_due(group, items, k):
                items.put_step(f.frame, k, own_step(plan, f, items.level, problem, k))
            for f in turns.fields_due(group, items, k):
                items.put_fields(f.frame, k + 1, fields_after(plan, f, items))
        if items.octave is plan.octaves[-1]:
            yield from ((f, items, problem) for f in group)


def own_step(plan: Plan, now: Current, level: int, problem: OctaveProblem, k: int) -> OwnStep:
    """What a frame finds by itself: views → loss → ∇Φ, ∇Ψ, and the step along them (paper Eq. 4)."""
    since, frame, of = time.perf_counter(), now.frame, now.inputs
    found = problem.gradient(frame, now.fields, of.density, frame.seed(level, k), of.regions, of.colour)
    raw = plan.averages_gradients
    step = found.gradients[0] if raw else step_along(found.gradients, plan, now, problem.octave.cell_size)
    change = found.density - of.density if plan.recipe.coherence > 0 and plan.window > 1 else None
    return OwnStep(step, change, found.loss, found.terms, since, raw)


def step_along(gradients: Sequence[Fields], plan: Plan, now: Current, h: float) -> Fields:
    """η · mask · N(g), summed over the targets: the step to subtract from a frame's fields; gradients are consumed."""
    frame, inputs, levels = now.frame, now.inputs, now.frame.recipe.pyramid_levels
    steps = (
        frame.colour_step(gradient, mask if plan.averages_smoke else region, share)
        | frame.parameterisation.step(gradient, mask, frame.eta * share, plan.rows, h, levels)
        for gradient, mask, region, share in zip(
            gradients, inputs.target_masks(), inputs.target_regions(), frame.shares, strict=True
        )
    )
    return functools.reduce(Fields.__add__, map(Fields, steps))


def fields_after(plan: Plan, now: Current, items: Items) -> Fields:
    """A frame's fields after the iteration whose own steps have been found."""
    fields = now.fields - window_average(plan, now, items)
    h = items.octave.cell_size
    return now.frame.in_gamut(now.frame.within_reach(fields, h, now.inputs.allowed), now.inputs.colour, h)


def window_average(plan: Plan, now: Current, items: Items) -> Fields:
    """What to subtract from a frame's fields: its window's steps, transported to it and averaged (paper Eq. 8, 9).

    Where gradients are averaged, it is the step along their average, as in the paper's Algorithm 1.
    """
    if plan.window == 1:
        return items.own_step
    average = items.averaged_step(now)
    if plan.averages_gradients:
        average = step_along([average], plan, now, items.octave.cell_size)
    return average + coherence_step(plan, now, items) if plan.recipe.coherence > 0 else average
