"""Runs Algorithm 1: skips what an earlier run has already done, stops on Ctrl-C, reports progress and history."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import replace

from tnst_mi.frame import Frame
from tnst_mi.machine.backend import torch_device
from tnst_mi.machine.interrupt import Interrupt, deferred_interrupt
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.algorithm import T, algorithm_1
from tnst_mi.optimisation.glimpse import Glimpses
from tnst_mi.optimisation.gradient import OctaveProblem, problem_of
from tnst_mi.optimisation.items.damage import DamagedItemError
from tnst_mi.optimisation.items.device_store import DeviceStore
from tnst_mi.optimisation.items.interface import Store
from tnst_mi.optimisation.items.mending import Mending
from tnst_mi.optimisation.items.state import Current, Items
from tnst_mi.optimisation.octave import reached
from tnst_mi.optimisation.plan import FramePlan, Plan
from tnst_mi.optimisation.result import Progress, Stylized
from tnst_mi.optimisation.results import history_of, note_missing, result_of

#: Bytes of device memory for items where the caller does not know how much is free.
CACHE_BYTES = 1 << 28


class SequenceOptimisation:
    """The optimisation of a sequence, carried out by `run`.

    Args:
        plan: the plan of the sequence.
        frames: the frames in order, read from this sequence when they are needed.
        network: the GoogLeNet that judges the images; it is moved to the device of the active variant.
        store: the working state, possibly that of an earlier run with the same arguments.
        cache_bytes: bytes of device memory for items of the store, so that a window is not read again for every frame.

    Attributes:
        interrupted: Ctrl-C ended the run.
    """

    def __init__(
        self, plan: Plan, frames: Sequence[Frame], network: GoogLeNet, store: Store, cache_bytes: int = CACHE_BYTES
    ) -> None:
        self._plan, self._frames, self._store, self._cache_bytes = plan, frames, store, cache_bytes
        self._network = network.to(torch_device())
        self._on_iteration: Callable[[Progress], None] | None = None
        self._on_octave: Callable[[Glimpses], None] | None = None
        self._finished: frozenset[int] = frozenset()
        self._interrupt = Interrupt()
        #: Of the frames that are changed, among these, by their index.
        self._position = {frame.index: position for position, frame in enumerate(plan.alive)}
        #: Items of the current octave.
        self._items: Items | None = None
        self.interrupted = False

    def run(
        self,
        on_iteration: Callable[[Progress], None] | None = None,
        finished: Collection[int] = (),
        on_octave: Callable[[Glimpses], None] | None = None,
    ) -> Generator[tuple[int, Stylized], None, None]:
        """Stylize the frames, and yield each with its index once it is done.

        Ctrl-C ends the run after the current step, a second one immediately. A single frame is then yielded in its
        current state; the frames of a sequence stay in the store, from which another run can resume.

        Args:
            on_iteration: called after every iteration of every frame.
            finished: indices of frames that need not be yielded any more.
            on_octave: called after every octave but the last, once all frames are through it.

        Raises:
            InputError: the network lacks a layer, channel or class, a picture cannot be used, a frame is damaged, or a
                loss is not finite.
            DamagedItemError: items of the store are damaged again after they were made anew.
            OSError: the store cannot be written.
        """
        plan, self._on_iteration, self._on_octave = self._plan, on_iteration, on_octave
        self._finished = frozenset(finished)
        self._items, self.interrupted = None, False
        wanted = [frame for frame in plan.frames if frame.index not in self._finished]
        if not wanted:
            return
        with (
            deferred_interrupt() as self._interrupt,
            closing(DeviceStore(self._store, self._cache_bytes)) as store,
        ):
            try:
                yield from self._results(wanted, store)
            except KeyboardInterrupt:
                self.interrupted = True
                if self._items is not None:
                    self._items.flush()
                    # Those whose losses had not been read; a callback that ended the run may do so again.
                    with suppress(KeyboardInterrupt):
                        self._report(self._items)
            if self.interrupted and len(plan.frames) == 1:
                yield 0, replace(self._as_far_as_it_got(plan.frames[0], store), interrupted=True)

    def _results(self, wanted: Sequence[FramePlan], store: DeviceStore) -> Iterator[tuple[int, Stylized]]:
        """The results of the wanted frames; where an item of the working state is damaged, what it takes is redone."""
        plan, mending = self._plan, Mending(self._plan, store)
        waiting = deque(wanted)
        while waiting:
            try:
                done = algorithm_1(plan, self._frames, self._network, store, self)
                while waiting:
                    self._stop_here()
                    frame = waiting[0]
                    items, problem = (None, None) if frame.still else next((i, p) for f, i, p in done if f is frame)
                    # The result may share memory with items that are being written.
                    store.finish()
                    result = self._result(frame, items, problem)
                    note_missing(plan, self._store, frame, len(result.history))
                    waiting.popleft()
                    self._finished |= {frame.index}
                    yield frame.index, result
            except DamagedItemError as damage:
                # What is only in memory follows from items that may have to go.
                self._items = None
                mending.mend(damage)

    # ---------------------------------------------------------------- turns

    def groups(self, items: Items) -> Sequence[Sequence[FramePlan]]:
        """The frames that follow each other's steps in an octave, without those that are no longer wanted."""
        if self._plan.window > 1 or items.octave is not self._plan.octaves[-1]:
            return self._plan.groups
        return [[frame] for frame in self._plan.alive if frame.index not in self._finished]

    def each(self, frames: Iterable[T]) -> Iterator[T]:
        """The given frames, one by one; the run may end in between."""
        for frame in frames:
            self._stop_here()
            yield frame

    def steps_due(self, group: Sequence[FramePlan], items: Items, k: int) -> Iterator[Current]:
        """The frames whose own step of iteration k is still to be computed."""
        self._items = items
        for now in self.each(items.current(f for f in group if not items.step_found(f, k))):
            yield now
            # With a window, a frame's own step is nearly all the work of an iteration.
            if self._plan.window > 1:
                self._report(items)
        if self._plan.window > 1:
            items.settle()
            self._report(items)

    def fields_due(self, group: Sequence[FramePlan], items: Items, k: int) -> Iterator[Current]:
        """The frames whose fields are still to be updated in iteration k."""
        due = items.current(f for f in group if items.iterations_done(f) <= k)
        if self._plan.window > 1:
            yield from self.each(due)
            return
        # Without a window the step is only in memory: the run ends after it has been applied.
        for now in due:
            yield now
            self._report(items)
            self._stop_here()

    def octave_done(self, items: Items) -> None:
        """All frames have done all iterations of an octave."""
        if self._on_octave is not None and items.octave is not self._plan.octaves[-1]:
            self._stop_here()
            self._on_octave(Glimpses(items, self._store.numbers(f"scales.{items.level}") or {}))

    def _stop_here(self) -> None:
        """End the run here if Ctrl-C was pressed."""
        if self._interrupt.requested:
            raise KeyboardInterrupt

    # ---------------------------------------------------------------- progress and results

    def _result(self, frame: FramePlan, items: Items | None, problem: OctaveProblem | None) -> Stylized:
        scales = {} if items is None else self._store.numbers(f"scales.{items.level}") or {}
        history = history_of(self._store, frame.name)
        return result_of(self._plan, frame, self._frames[frame.index], items, problem, history, scales)

    def _report(self, items: Items) -> None:
        """Report the iterations whose losses have been read."""
        plan, iterations = self._plan, self._plan.iterations(items.level)
        each = [plan.iterations(octave) for octave in range(len(plan.octaves))]
        for outcome in items.outcomes():
            if self._on_iteration is None:
                continue
            frame, k, count = outcome.frame, outcome.iteration, len(self._position)
            position = self._position[frame.index]
            within = k * count + position if plan.window > 1 else position * iterations + k
            done, total = count * sum(each[: items.level]) + within + 1, count * sum(each)
            self._on_iteration(
                Progress(frame.name, items.level, len(each), k, iterations, outcome.loss, outcome.terms, done, total)
            )

    def _as_far_as_it_got(self, frame: FramePlan, store: DeviceStore) -> Stylized:
        """The result of the only frame of an interrupted run."""
        plan, level = self._plan, reached(self._plan, store)
        problem, scales = None, self._store.numbers(f"scales.{len(plan.octaves) - 1}")
        if scales is not None:
            problem = problem_of(plan, plan.octaves[-1], self._network).scaled(scales)
        return self._result(frame, Items(plan, level, store), problem)
