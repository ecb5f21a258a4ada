"""What a frame has come to once its iterations are done: its stylized smoke, history, losses before and after."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tnst_mi.fields.density_unit import scaled
from tnst_mi.frame import Frame
from tnst_mi.machine.backend import release_memory
from tnst_mi.optimisation.finish import stylized_frame
from tnst_mi.optimisation.gradient import OctaveProblem
from tnst_mi.optimisation.items.interface import Store
from tnst_mi.optimisation.items.state import Items
from tnst_mi.optimisation.plan import FramePlan, Plan
from tnst_mi.optimisation.result import Stylized
from tnst_mi.optimisation.start import State


def result_of(
    plan: Plan,
    frame: FramePlan,
    source: Frame,
    items: Items | None,
    problem: OctaveProblem | None,
    history: list[dict[str, Any]],
    scales: Mapping[str, float],
) -> Stylized:
    """The result of a frame.

    Args:
        plan: of the sequence.
        frame: the plan of the frame.
        source: the frame.
        items: of the octave that was reached; None if there is none.
        problem: judges the losses before and after; None to leave them out.
        history: the iterations of the frame, see `history_of`.
        scales: of the terms of the loss in that octave, by name.

    Raises:
        InputError: the stylized density or velocity is not finite.
    """
    # Memory blocks of the iterations are no longer needed.
    release_memory()
    result = stylized_frame(items, frame, source)
    colour = None
    if plan.colours is not None:
        colour, result.colour_grid = plan.colours.unstylized(source), plan.colours.written
        # What has not changed is as it was in every bit, where it was in colour.
        if result.colour is None and plan.colours.grid(source) != result.colour_grid:
            result.colour = colour
    if items is not None and not frame.still and items.iterations_done(frame) >= 0:
        fields = {name: field.numpy() for name, field in items.fields(frame).items()}
        result.state = State(items.level, items.iterations_done(frame), fields, dict(scales))
    result.history = history
    for entry in result.history:
        name = f"octave {entry['octave']}"
        result.timings[name] = result.timings.get(name, 0.0) + entry["seconds"]
    if result.history:
        result.timings["total"] = sum(result.timings.values())
    if problem is not None and items is not None and (items.level > 0 or items.iterations_done(frame) > 0):
        before, after = (scaled(density, plan.density_scale) for density in (source.density, result.density))
        regions = () if plan.regions is None else plan.regions.masks(frame.index, source)
        result.loss_before, result.terms_before = problem.judge(frame, before, regions, colour)
        # A result without colours of its own has those with which it began.
        found = colour if result.colour is None else result.colour
        result.loss_after, result.terms_after = problem.judge(frame, after, regions, found)
    return result


def note_missing(plan: Plan, store: Store, frame: FramePlan, logged: int) -> None:
    """Say how many iterations of a finished frame its log does not have; its result does not depend on them."""
    count = plan.iterations_of(frame)
    missing = 0 if frame.still else count - logged
    if missing:
        store.note(
            f"metrics.jsonl was damaged; {missing} of {count} iterations of {frame.name} are left out of the "
            "losses and times of the run"
        )


def history_of(store: Store, name: str) -> list[dict[str, Any]]:
    """The log of a frame; an iteration that was logged by a killed run and then repeated counts once."""
    entries = {(entry["octave"], entry["iteration"]): entry for entry in store.entries(name)}
    return [{key: value for key, value in entries[at].items() if key != "frame"} for at in sorted(entries)]
