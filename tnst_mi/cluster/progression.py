"""Algorithm 1 as tasks: gives those that are due to a crew, octave by octave, and takes note of what is done."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import closing
from typing import Any

from tnst_mi.cluster.crew import Crew
from tnst_mi.cluster.exchange import Iterated
from tnst_mi.cluster.graph import Needs, TaskGraph, entering, iterating, measuring
from tnst_mi.cluster.parcels import AT_HOME, Parcel, needed, packed, unpacked
from tnst_mi.cluster.tasks import (
    AVERAGE,
    FIELDS,
    FINISH,
    GAIN,
    INPUTS,
    ITERATE,
    SCALES,
    STEP,
    Task,
    Told,
    Workplace,
    carry_out,
)
from tnst_mi.losses.evaluation import rms_scales
from tnst_mi.machine.interrupt import Interrupt
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.glimpse import Glimpses
from tnst_mi.optimisation.gradient import problem_of
from tnst_mi.optimisation.items.damage import DamagedItemError
from tnst_mi.optimisation.items.device_store import DeviceStore
from tnst_mi.optimisation.items.mending import Mending
from tnst_mi.optimisation.items.state import Items
from tnst_mi.optimisation.items.store import FolderStore
from tnst_mi.optimisation.octave import forget, known_scales, levels_left
from tnst_mi.optimisation.plan import Plan
from tnst_mi.optimisation.result import Progress
from tnst_mi.optimisation.results import history_of, note_missing

#: The index of a frame, its record, and its iterations.
Result = tuple[int, dict[str, Any], list[dict[str, Any]]]


class Progression:
    """The way of a run through its tasks.

    Args:
        plan: of the sequence.
        store: the working state, in the folder that all processes share, possibly that of an earlier run.
        network: judges the images.
        crew: has the tasks done.
        interrupt: whether the run is to end.
        on_iteration: called after every iteration of every frame.
        home: where this process does what others cannot, if they do not share the folder of the run; None if they do.
            It is given the store of items.
    """

    def __init__(
        self,
        plan: Plan,
        store: FolderStore,
        network: GoogLeNet,
        crew: Crew,
        interrupt: Interrupt,
        on_iteration: Callable[[Progress], None],
        home: Callable[[DeviceStore], Workplace] | None = None,
    ) -> None:
        self._begin_home = home
        self._home: Workplace | None = None
        self._plan, self._store, self._network, self._crew = plan, store, network, crew
        self._interrupt, self._on_iteration = interrupt, on_iteration
        self._level, self._scales = 0, dict[str, float]()
        #: By frame, the iterations that are done in the octave, and what it contributes to the scales of its loss.
        self._done: dict[int, int] = {}
        self._contributions: dict[int, dict[str, tuple[float, int]]] = {}
        #: The iterations of frames that are counted, and how many there were before the octave.
        self._counted: set[tuple[str, int, int]] = set()
        self._before = 0

    def results(
        self, finished: Collection[int] = (), on_octave: Callable[[Glimpses], None] | None = None
    ) -> Iterator[Result]:
        """Have the frames stylized, and yield each once its results are written; see `SequenceOptimisation.run`.

        Raises:
            KeyboardInterrupt: Ctrl-C has been pressed; what is done is in the store.
            InputError, StoppedError, OSError: see `Crew.answers`.
        """
        finished = set(finished)
        with closing(DeviceStore(self._store, 0)) as store:
            mending = Mending(self._plan, store)
            self._home = None if self._begin_home is None else self._begin_home(store)
            while len(finished) < len(self._plan.frames):
                try:
                    for result in self._octaves(store, finished, on_octave):
                        finished.add(result[0])
                        yield result
                except DamagedItemError as damage:
                    # Processes may have kept what has to go.
                    self._crew.begin_again()
                    mending.mend(damage)

    def _octaves(
        self, store: DeviceStore, finished: Collection[int], on_octave: Callable[[Glimpses], None] | None
    ) -> Iterator[Result]:
        plan, last = self._plan, len(self._plan.octaves) - 1
        for level in levels_left(plan, store) if plan.alive else [last]:
            self._level, items = level, Items(plan, level, store)
            earlier = [Items(plan, before, store) for before in range(plan.first_octave, level)]
            if plan.start is not None and level == plan.start.octave:
                for frame in plan.alive:
                    items.enter_fields(frame, None)
                store.finish()
            yield from self._all(entering(plan, level, self._has))
            if plan.window > 1 and plan.alive:
                items.require_in_step()
            forget(earlier)
            self._done = {frame.index: items.iterations_done(frame) for frame in plan.alive}
            self._scales = self._measured(items) if plan.alive else {}
            found = sum(self._has("step", frame, done + 1) for frame, done in self._done.items())
            before = len(plan.alive) * sum(map(plan.iterations, range(level)))
            self._before = before + sum(self._done.values()) + found
            self._counted = set()
            yield from self._all(iterating(plan, level, self._done, self._has, finished))
            if on_octave is not None and level < last:
                on_octave(Glimpses(items, self._store.numbers(f"scales.{level}") or {}))

    def _measured(self, items: Items) -> dict[str, float]:
        """The scales of the octave's loss; see `octave.calibrated`."""
        plan, network = self._plan, self._network
        scales = known_scales(plan, items, self._store, lambda: problem_of(plan, items.octave, network).scales)
        if scales is None:
            for _ in self._all(measuring(plan, items.level)):
                raise AssertionError("these tasks have no results")
            # In the order of the frames: sums of numbers depend on it.
            scales = rms_scales(self._contributions[frame.index] for frame in plan.alive)
            self._store.write_numbers(f"scales.{items.level}", scales)
        return scales

    def _has(self, kind: str, frame: int, generation: int) -> bool:
        return self._store.has(f"{kind}.{self._level}", frame, generation)

    # ---------------------------------------------------------------- tasks

    def _all(self, needs: Needs) -> Iterator[Result]:
        """Have tasks done, each once what it needs has been done."""
        graph, due = TaskGraph(needs), deque[Task]()
        self._give(graph.ready, due)
        while due or len(graph):
            while due:
                # What the others cannot do is done here, while they do theirs.
                yield from self._noted(task := due.popleft(), self._done_here(task))
                self._give(graph.done(task), due)
            for answer in self._crew.answers():
                if self._interrupt.requested:
                    raise KeyboardInterrupt
                if isinstance(answer, Iterated):
                    self._heard(answer.entry)
                elif answer is not None:
                    unpacked(self._store, answer.parcels)
                    yield from self._noted(answer.task, answer.result)
                    self._give(graph.done(answer.task), due)
                if due:
                    break
            assert due or not len(graph), "tasks are left that wait for nothing"

    def _give(self, tasks: Iterable[Task], due: deque[Task]) -> None:
        """Give tasks to the crew, and put those that are done here with those that are due."""
        at_home = [task for task in tasks if self._home is not None and task.kind in AT_HOME]
        due.extend(at_home)
        self._crew.give({task: self._told(task) for task in tasks if task not in at_home})

    def _done_here(self, task: Task) -> Any:
        assert self._home is not None
        if self._interrupt.requested:
            raise KeyboardInterrupt
        return carry_out(task, self._told(task), self._home, self._heard)

    def pack(self, task: Task) -> list[Parcel]:
        """The items that a task needs."""
        return packed(self._store, needed(self._plan, task, self._done.get(task.frame, 0)))

    def _told(self, task: Task) -> Told:
        """What whoever does a task has to be told."""
        done = self._done.get(task.frame, 0)
        if task.kind == FINISH:
            return Told(done, self._scales, tuple(history_of(self._store, self._plan.frames[task.frame].name)))
        return Told(done, self._scales) if task.kind in (STEP, ITERATE) else Told(done)

    def _noted(self, task: Task, result: Any) -> Iterator[Result]:
        """Take note of what a task has written; yields the results of a frame."""
        kind, level, t, k = task
        count = self._plan.iterations(level)
        if kind in (INPUTS, FIELDS, GAIN):
            self._store.told(f"{kind}.{level}", t, 0)
        elif kind == SCALES:
            self._contributions[t] = result
        elif kind == STEP:
            self._store.told(f"step.{level}", t, k + 1)
        elif kind == AVERAGE:
            self._advanced(t, k + 1)
            self._release_steps(t)
        elif kind == ITERATE:
            self._store.found(f"fields.{level}", t)
            self._advanced(t, count)
        elif kind == FINISH:
            frame = self._plan.frames[t]
            history = history_of(self._store, frame.name)
            note_missing(self._plan, self._store, frame, len(history))
            yield t, result, history

    def _advanced(self, frame: int, done: int) -> None:
        """The fields of a frame are those after so many iterations."""
        self._done[frame] = done
        self._store.told(f"fields.{self._level}", frame, done)
        self._store.release(f"fields.{self._level}", frame, done)

    def _release_steps(self, frame: int) -> None:
        """Remove the steps that all frames have followed, of the window of a frame that has just followed some."""
        for i in self._plan.followed_by(frame):
            followed = min(self._done[j] for j in self._plan.followed_by(i))
            self._store.release(f"step.{self._level}", i, followed + 1)

    def _heard(self, entry: dict[str, Any]) -> None:
        """Take note of an iteration, once: whoever did it may have been killed, and another did it again."""
        at = entry["frame"], entry["octave"], entry["iteration"]
        if at in self._counted:
            return
        self._counted.add(at)
        self._store.heard(entry)
        plan = self._plan
        each = [plan.iterations(octave) for octave in range(len(plan.octaves))]
        self._on_iteration(
            Progress(
                entry["frame"],
                entry["octave"],
                len(each),
                entry["iteration"],
                each[entry["octave"]],
                entry["loss"],
                entry["terms"],
                self._before + len(self._counted),
                len(plan.alive) * sum(each),
                self._crew.members,
            )
        )
