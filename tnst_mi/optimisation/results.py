"""What a frame has come to once its iterations are done: its stylized smoke, history, losses before and after."""

from __future__ import annotations

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
    plan: Plan, store: Store, frame: FramePlan, source: Frame, items: Items | None, problem: OctaveProblem | None
) -> Stylized:
    """The result of a frame.

    Args:
        plan: of the sequence.
        store: what the iterations have written.
        frame: the plan of the frame.
        source: the frame.
        items: of the octave that was reached; None if there is none.
        problem: judges the losses before and after; None to leave them out.

    Raises:
        InputError: the stylized density or velocity is not finite.
    """
    # Memory blocks of the iterations are no longer needed.
    release_memory()
    result = stylized_frame(items, frame, source)
    if items is not None and not frame.still and items.iterations_done(frame) >= 0:
        scales = store.numbers(f"scales.{items.level}") or {}
        fields = {name: field.numpy() for name, field in items.fields(frame).items()}
        result.state = State(items.level, items.iterations_done(frame), fields, scales)
    result.history = _history(store, frame.name)
    for entry in result.history:
        name = f"octave {entry['octave']}"
        result.timings[name] = result.timings.get(name, 0.0) + entry["seconds"]
    if result.history:
        result.timings["total"] = sum(result.timings.values())
    if problem is not None and items is not None and (items.level > 0 or items.iterations_done(frame) > 0):
        before, after = (scaled(density, plan.density_scale) for density in (source.density, result.density))
        regions = () if plan.regions is None else plan.regions.masks(frame.index, source)
        result.loss_before, result.terms_before = problem.judge(frame, before, regions)
        result.loss_after, result.terms_after = problem.judge(frame, after, regions)
    return result


def note_missing(plan: Plan, store: Store, frame: FramePlan, result: Stylized) -> None:
    """Say how many iterations of a finished frame its log does not have; its result does not depend on them."""
    count = plan.iterations_of(frame)
    missing = 0 if frame.still else count - len(result.history)
    if missing:
        store.note(
            f"metrics.jsonl was damaged; {missing} of {count} iterations of {frame.name} are left out of the "
            "losses and times of the run"
        )


def _history(store: Store, name: str) -> list[dict]:
    """The log of a frame; an iteration that was logged by a killed run and then repeated counts once."""
    entries = {(entry["octave"], entry["iteration"]): entry for entry in store.entries(name)}
    return [{key: value for key, value in entries[at].items() if key != "frame"} for at in sorted(entries)]
