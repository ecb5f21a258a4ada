"""The tasks of a run on several processes: the steps of Algorithm 1, of one frame each, and what each does.

What a task reads has been written by others before it begins, and what it writes depends on nothing else. So a task
that is done twice, since its process was killed, leaves the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from tnst_mi.frame import Frame
from tnst_mi.machine.backend import release_memory
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.algorithm import fields_after, own_step
from tnst_mi.optimisation.gradient import OctaveProblem, problem_of
from tnst_mi.optimisation.items.device_store import DeviceStore
from tnst_mi.optimisation.items.state import Current, Items
from tnst_mi.optimisation.items.store import FolderStore
from tnst_mi.optimisation.octave import calibration
from tnst_mi.optimisation.plan import FramePlan, Plan
from tnst_mi.optimisation.results import result_of
from tnst_mi.run.folder import RunFolder
from tnst_mi.run.results import write_results
from tnst_mi.run.work import Work

#: Kinds of tasks: a frame enters an octave, with its inputs and its fields; the gain of its window; what it contributes
#: to the scales of the loss; its own step; the average over its window; all iterations, without a window; its results.
INPUTS, FIELDS, GAIN, SCALES, STEP, AVERAGE, ITERATE, FINISH = (
    *("inputs", "fields", "gain", "scales"),
    *("step", "average", "iterate", "finish"),
)


class Task(NamedTuple):
    """A task: its kind, the octave, the index of the frame, and the iteration of a step or an average."""

    kind: str
    level: int
    frame: int
    iteration: int = 0

    def described(self, plan: Plan) -> str:
        """In words."""
        where = f"octave {self.level + 1}"
        if self.kind in (STEP, AVERAGE):
            where = f"iteration {self.iteration + 1} of {where}"
        return f"{plan.frames[self.frame].name}, {self.kind} in {where}"


@dataclass
class Workplace:
    """What a process needs for the tasks of a run.

    Attributes:
        work: of the run.
        network: judges the images.
        store: the run's items.
        folder: of its results.
        problem: of the octave that this process works on; None before the first.
    """

    work: Work
    network: GoogLeNet
    store: DeviceStore
    folder: RunFolder
    problem: OctaveProblem | None = None

    @property
    def plan(self) -> Plan:
        """Of the run."""
        return self.work.plan

    @property
    def backing(self) -> FolderStore:
        """Where items are written."""
        assert isinstance(self.store.backing, FolderStore)
        return self.store.backing

    def items(self, level: int, frame: int, done: int) -> Items:
        """The items of an octave, in which a frame has done so many iterations."""
        return Items(self.plan, level, self.store, {frame: done})

    def source(self, frame: int) -> Frame:
        """A frame of the input, whose velocity leads to the next one."""
        return self.work.moving[frame]

    def octave_problem(self, level: int, scales: Mapping[str, float] | None = None) -> OctaveProblem:
        """The problem of an octave, with scales of the terms of its loss; that of the previous octave is forgotten."""
        octave = self.plan.octaves[level]
        if self.problem is None or self.problem.octave is not octave:
            self.problem = None
            release_memory()
            self.problem = problem_of(self.plan, octave, self.network)
        if scales is not None and dict(scales) != self.problem.scales:
            self.problem = self.problem.scaled(scales)
        return self.problem


@dataclass(frozen=True)
class Told:
    """What is told to whoever does a task, since others found it out.

    Attributes:
        done: iterations of the frame that are done in the octave, where a task needs them.
        scales: of the octave's loss, likewise.
        history: the iterations of the frame, for its results.
    """

    done: int = 0
    scales: Mapping[str, float] | None = None
    history: tuple[dict[str, Any], ...] = ()


#: Is given the entry of an iteration for the log.
Report = Callable[[dict[str, Any]], None]


def carry_out(task: Task, told: Told, place: Workplace, report: Report) -> Any:
    """Do a task; what it writes is in the store once it returns.

    Args:
        task: what to do.
        told: what it needs besides items.
        place: where.
        report: is called after each iteration of a frame.

    Returns:
        Of `SCALES`, the frame's contribution; of `FINISH`, its record; else nothing.

    Raises:
        InputError: the frame cannot be stylized.
        DamagedItemError: an item is not what was written.
        OSError: the disk is full, or cannot be read.
    """
    frame = place.plan.frames[task.frame]
    result = _DO[task.kind](task, told, place, frame, report)
    place.store.finish()
    return result


def _inputs(task: Task, told: Told, place: Workplace, frame: FramePlan, report: Report) -> None:
    place.items(task.level, task.frame, -1).enter_inputs(frame, place.source(task.frame))


def _fields(task: Task, told: Told, place: Workplace, frame: FramePlan, report: Report) -> None:
    coarser = None
    if task.level > place.plan.first_octave:
        before = task.level - 1
        coarser = place.items(before, task.frame, place.plan.iterations(before))
    place.items(task.level, task.frame, -1).enter_fields(frame, coarser)


def _gain(task: Task, told: Told, place: Workplace, frame: FramePlan, report: Report) -> None:
    place.items(task.level, task.frame, 0).enter_gain(frame)


def _scales(task: Task, told: Told, place: Workplace, frame: FramePlan, report: Report) -> dict[str, tuple[float, int]]:
    now = _current(place.items(task.level, task.frame, told.done), frame)
    return calibration(place.octave_problem(task.level), now, task.level)


def _step(task: Task, told: Told, place: Workplace, frame: FramePlan, report: Report) -> None:
    items = place.items(task.level, task.frame, task.iteration)
    problem = place.octave_problem(task.level, told.scales)
    found = own_step(place.plan, _current(items, frame), task.level, problem, task.iteration)
    items.put_step(frame, task.iteration, found)
    items.settle()
    _tell(items, report)


def _average(task: Task, told: Told, place: Workplace, frame: FramePlan, report: Report) -> None:
    items = place.items(task.level, task.frame, task.iteration)
    items.put_fields(frame, task.iteration + 1, fields_after(place.plan, _current(items, frame), items))


def _iterate(task: Task, told: Told, place: Workplace, frame: FramePlan, report: Report) -> None:
    """All iterations of a frame that does not depend on others, from where a process that was killed has got to."""
    found = place.backing.found(f"fields.{task.level}", task.frame)
    items = place.items(task.level, task.frame, max(told.done, found))
    problem = place.octave_problem(task.level, told.scales)
    for k in range(items.iterations_done(frame), place.plan.iterations(task.level)):
        now = _current(items, frame)
        items.put_step(frame, k, own_step(place.plan, now, task.level, problem, k))
        items.put_fields(frame, k + 1, fields_after(place.plan, now, items))
        _tell(items, report)
    items.flush()
    _tell(items, report)


def _finish(task: Task, told: Told, place: Workplace, frame: FramePlan, report: Report) -> dict[str, Any]:
    items = problem = None
    if not frame.still:
        items = place.items(task.level, task.frame, told.done)
        problem = place.octave_problem(task.level, told.scales)
    stylized = result_of(
        place.plan, frame, place.source(task.frame), items, problem, list(told.history), told.scales or {}
    )
    source = place.work.unchanged[task.frame]
    return write_results(place.work, place.folder, task.frame, source, stylized)[0]


_DO: dict[str, Callable[[Task, Told, Workplace, FramePlan, Report], Any]] = {
    INPUTS: _inputs,
    FIELDS: _fields,
    GAIN: _gain,
    SCALES: _scales,
    STEP: _step,
    AVERAGE: _average,
    ITERATE: _iterate,
    FINISH: _finish,
}


def _current(items: Items, frame: FramePlan) -> Current:
    (now,) = items.current([frame])
    return now


def _tell(items: Items, report: Report) -> None:
    for outcome in items.outcomes():
        entry = {"frame": outcome.frame.name, "octave": items.level, "iteration": outcome.iteration}
        report(entry | {"loss": outcome.loss, "terms": outcome.terms, "seconds": outcome.seconds})
