"""The items of an optimisation: what a `Store` holds for each frame on the grid of an octave o, as tensors.

inputs.o    density, mask and simulation velocity of a frame, and how far its cells may be moved; if targets have
            regions, the mask of each on this grid, the mask of their union, and a factor that keeps fields inside it
fields.o    the optimised fields; generation = iterations done
gain.o      normalises the average over the window to that over smoke, see `averaging_gain`
step.o      the step of one iteration along the frame's own gradient, or the gradient itself, and the change
            of the density that it starts from; generation = that of the fields that it leads to

So everything that an iteration reads is known by its number: where frames are stylized by several processes, some may
be an iteration ahead of others.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.optimisation.colouring import COLOUR
from tnst_mi.optimisation.items.device_store import DeviceStore, Request
from tnst_mi.optimisation.items.inputs import INSIDE, Inputs, input_names, inputs_of, octave_inputs
from tnst_mi.optimisation.items.own_step import Launched, Outcome, OwnStep
from tnst_mi.optimisation.items.store import DamagedItemError
from tnst_mi.optimisation.parameterisation import Fields, times
from tnst_mi.optimisation.plan import FramePlan, Plan
from tnst_mi.optimisation.temporal.alignment import averaging_gain, still_fields, transported_sums, unmasked
from tnst_mi.optimisation.temporal.window import reading_order, window_of

_GROUPS = ("inputs", "fields", "gain", "step")

#: Without a window, fields are kept in memory between iterations, and written to the store after this many seconds.
CHECKPOINT_SECONDS = 30.0


@dataclass(frozen=True)
class Current:
    """A frame as it stands in an octave, after `done` iterations: its inputs and its fields, tensors on the device."""

    frame: FramePlan
    inputs: Inputs
    fields: Fields
    done: int


class Items:
    """The items of one octave. Reading gives tensors; writing replaces the earlier generation.

    With a window, everything is written immediately, steps and changes in half precision, gradients in single. Without
    one, a frame goes through all its iterations alone: its fields are kept in memory, and written at intervals and by
    `flush`; its steps stay in memory.

    The loss of a step is read only when the next step is put or something is about to be written: a GPU then need not
    wait for the host in between. Nothing is written that follows from a loss that has not been found to be finite.

    Args:
        plan: of the sequence.
        level: which octave, from 0.
        store: where the items are kept.
        known: by frame, the iterations that are done, where other processes do some too; None to ask the store.
    """

    def __init__(self, plan: Plan, level: int, store: DeviceStore, known: Mapping[int, int] | None = None) -> None:
        self.plan, self.level, self.octave, self._store = plan, level, plan.octaves[level], store
        self._known = {} if known is None else dict(known)
        self._alone = plan.window == 1
        self._inputs: dict[int, Inputs] = {}
        #: By frame: iterations done, and the fields after them.
        self._fields: dict[int, tuple[int, Fields]] = {}
        #: By frame: iterations whose own step has been computed.
        self._found: dict[int, int] = {}
        #: Without a window, the latest step of the frame that goes through its iterations.
        self.own_step = Fields()
        self._launched: Launched | None = None
        self._outcomes: deque[Outcome] = deque()
        self._read = self._written = time.perf_counter()

    def _group(self, kind: str) -> str:
        return f"{kind}.{self.level}"

    # ---------------------------------------------------------------- progress

    def iterations_done(self, frame: FramePlan) -> int:
        """Number of iterations done on a frame; −1 if it has not entered the octave."""
        kept = self._fields.get(frame.index)
        return self._stored_iterations(frame) if kept is None else kept[0]

    def step_found(self, frame: FramePlan, k: int) -> bool:
        """Whether the own step of iteration k has been computed for a frame, and perhaps applied."""
        if k < max(self.iterations_done(frame), self._found.get(frame.index, 0)):
            return True
        return self._store.has(self._group("step"), frame.index, k + 1)

    def require_in_step(self) -> None:
        """Check that the steps that each frame of a window follows next are there, or can still be made.

        Raises:
            DamagedItemError: the fields of one have got lost, so that it would follow steps of later iterations.
        """
        done = {frame.index: self.iterations_done(frame) for frame in self.plan.alive}
        for frame in self.plan.alive:
            following = done[frame.index] + 1
            for i in self.plan.followed_by(frame.index) if following <= self.plan.iterations(self.level) else ():
                if done[i] >= following and not self._store.has(self._group("step"), i, following):
                    what, group = f"fields of {frame.name}", self._group("fields")
                    raise DamagedItemError(what, "they have got lost", group, frame.index, done[frame.index])

    def outcomes(self) -> Iterator[Outcome]:
        """The outcomes of own steps that have been read and not yet taken from here."""
        while self._outcomes:
            yield self._outcomes.popleft()

    # ---------------------------------------------------------------- entering the octave

    def enter_inputs(self, frame: FramePlan, source: Frame) -> None:
        """Write a frame's inputs for the octave; see `octave_inputs`."""
        group = self._group("inputs")
        if self._store.generation(group, frame.index) < 0:
            self._store.write(group, frame.index, 0, octave_inputs(self.plan, self.octave, frame, source))

    def _inside(self, frame: FramePlan, fields: Fields) -> Fields:
        """Fields that came from elsewhere, faded to 0 at the border of a frame's regions."""
        if self.plan.regions is None or not self.plan.regions.bounded:
            return fields
        inside = self._store.read(self._group("inputs"), frame.index, [INSIDE], 0)[INSIDE]
        return Fields({name: times(inside, field) for name, field in fields.items()})

    def enter_fields(self, frame: FramePlan, coarser: Items | None) -> None:
        """Carry a frame's fields over from the previous octave; in the first one they are 0, or an earlier run's."""
        if self.iterations_done(frame) >= 0:
            return
        parameterisation, start, done = frame.parameterisation, self.plan.start, 0
        if coarser is None and start is not None:
            done, stored = start.iterations[frame.name], start.fields(frame.name)
            fields = Fields({name: mi.TensorXf(stored[name]) for name in parameterisation.channels})
        elif coarser is None:
            fields = parameterisation.zeros(self.octave)
        else:
            fields = parameterisation.carried(coarser.fields(frame), coarser.octave, self.octave)
            fields = self._inside(frame, fields)
        self._write_fields(frame, done, fields)

    def enter_gain(self, frame: FramePlan) -> None:
        """Write the factor that turns the windowed sum of a frame into an average over smoke."""
        if self._store.generation(self._group("gain"), frame.index) >= 0:
            return
        weights = self.plan.window_weights
        total = self.windowed_sums(frame, "inputs", 0, ["mask"], weights)["mask"]
        mask = self._store.read(self._group("inputs"), frame.index, ["mask"], 0)["mask"]
        gain = mi.TensorXf16(averaging_gain(mask, total, weights[0]))
        self._store.write(self._group("gain"), frame.index, 0, {"gain": gain})

    def forget(self, keep_fields: bool) -> None:
        """Remove the items of this octave once it is done, or all but the fields, from which the next one began."""
        for kind in _GROUPS:
            if not (keep_fields and kind == "fields"):
                self._store.remove(self._group(kind))

    # ---------------------------------------------------------------- reading

    def current(self, frames: Iterable[FramePlan]) -> Iterator[Current]:
        """The frames one by one as they stand; the next one is read ahead."""
        waiting = list(frames)
        if self._alone and all(frame.index in self._inputs for frame in waiting):
            yield from (
                Current(frame, self._inputs[frame.index], self.fields(frame), self.iterations_done(frame))
                for frame in waiting
            )
            return
        requests = (
            [
                Request(self._group("inputs"), frame.index, input_names(self.plan, frame), 0),
                self._fields_request(frame, self.iterations_done(frame)),
            ]
            for frame in waiting
        )
        for frame, (inputs, fields) in zip(waiting, self._store.read_each(requests), strict=True):
            now = Current(frame, inputs_of(self.plan, inputs), Fields(fields), self.iterations_done(frame))
            if self._alone:
                self._inputs = {frame.index: now.inputs}
                self._fields = {frame.index: (now.done, now.fields)}
            yield now

    def fields(self, frame: FramePlan) -> Fields:
        """The current fields of a frame."""
        kept = self._fields.get(frame.index)
        if kept is not None:
            return kept[1]
        return Fields(self._store.read(*self._fields_request(frame, self._stored_iterations(frame))))

    def _fields_request(self, frame: FramePlan, done: int) -> Request:
        return Request(self._group("fields"), frame.index, tuple(frame.parameterisation.channels), done)

    def averaged_step(self, now: Current) -> Fields:
        """The steps, or gradients, of a frame's window, transported to it (paper Eq. 8) and averaged (Eq. 9).

        The average is that over smoke, times the frame's mask; or the plain one, with weights that sum to 1 over the
        frames that the window has.
        """
        frame, following = now.frame, now.done + 1
        names, weights = list(frame.parameterisation.channels), self.plan.window_weights
        if self.plan.recipe.window_average == "plain":
            window = window_of(frame.index, len(self.plan.frames), self.plan.window)
            present = sum(weights[abs(i - frame.index)] for i in window)
            sums = Fields(self.windowed_sums(frame, "step", following, names, weights / present))
            # Gradients are masked later, when a step is made of their average.
            return sums if self.plan.averages_gradients else self._inside(frame, sums)
        sums = self.windowed_sums(frame, "step", following, names, weights)
        gain = self._store.read(self._group("gain"), frame.index, ["gain"], 0)["gain"]
        average = Fields({name: times(gain, total) for name, total in sums.items() if name != COLOUR})
        if COLOUR in sums:
            average[COLOUR] = times(unmasked(gain, now.inputs.mask), sums[COLOUR])
        return average

    def windowed_sums(
        self, frame: FramePlan, kind: str, generation: int, names: Sequence[str], weights: np.ndarray
    ) -> dict[str, mi.TensorXf]:
        """Σ_i ω_|i−t| T_i^t(f_i) of the named arrays of a generation of one kind of item, with weights by distance."""
        self.settle()
        index = frame.index
        window = window_of(index, len(self.plan.frames), 2 * len(weights) - 1)
        order = reading_order(index, window)
        # Past frames are transported forwards by their own u_i, future ones backwards by u_{i−1}.
        velocities = [Request(self._group("inputs"), i if i < index else i - 1, ("velocity",), 0) for i in order]
        wanted = [
            [*self._requests(i, kind, generation, names), velocity]
            for i, velocity in zip(order, velocities, strict=True)
        ]
        results = self._store.read_each([self._requests(index, kind, generation, names), *wanted])
        own = self._filled(next(results), names, frame)
        neighbours = ((self._filled(fields, names, frame), velocity["velocity"]) for *fields, velocity in results)
        return transported_sums(own, weights, window, index, neighbours, self.octave.cell_size)

    def _requests(self, index: int, kind: str, generation: int, names: Sequence[str]) -> list[Request]:
        """For the named arrays of an item; nothing for a frame that stays unchanged."""
        return [] if self.plan.frames[index].still else [Request(self._group(kind), index, names, generation)]

    def _filled(self, read: list[dict[str, mi.TensorXf]], names: Sequence[str], frame: FramePlan) -> Fields:
        """What was read; zeros for a frame that stays unchanged, which counts as one without smoke."""
        return Fields(read[0] if read else still_fields(names, frame.parameterisation.channels, self.octave.shape))

    def _stored_iterations(self, frame: FramePlan) -> int:
        known = self._known.get(frame.index)
        return self._store.generation(self._group("fields"), frame.index) if known is None else known

    # ---------------------------------------------------------------- writing

    def put_step(self, frame: FramePlan, iteration: int, found: OwnStep) -> None:
        """Store a frame's own step of an iteration, and log it once its loss has been read.

        Raises:
            InputError: the loss of an earlier step was not finite, or that step exceeds the range of half precision.
        """
        self.settle()
        if self._alone:
            self.own_step = found.step
        self._found[frame.index] = iteration + 1
        self._launched = Launched(frame, iteration, found, stored=not self._alone)
        if self._launched.ready:
            self.settle()

    def settle(self) -> None:
        """Read the loss of the last own step, log the step, and write it.

        Raises:
            InputError: its loss is not finite, or it exceeds the range of half precision.
        """
        if self._launched is None:
            return
        step = self._launched
        try:
            found = step.outcome(self.level, self._read)
        except InputError:
            # What follows from it must not be written, whoever asks for it.
            self._launched, self._fields = None, {}
            raise
        frame = step.frame
        entry = {"frame": frame.name, "octave": self.level, "iteration": step.iteration, "loss": found.loss}
        self._store.backing.log(entry | {"terms": found.terms, "seconds": found.seconds})
        if step.arrays:
            self._store.write(self._group("step"), frame.index, step.iteration + 1, step.arrays)
        # Only now: where Ctrl-C interrupts the waiting above, `flush` has to settle the step.
        self._launched, self._read = None, time.perf_counter()
        self._outcomes.append(found)

    def put_fields(self, frame: FramePlan, done: int, fields: Fields) -> None:
        """Store the fields of a frame after `done` iterations."""
        if not self._alone:
            self._write_fields(frame, done, fields)
            return
        last = done == self.plan.iterations(self.level)
        # A step that has been applied is no longer needed.
        self._fields, self.own_step = {frame.index: (done, fields)}, Fields()
        if last or time.perf_counter() - self._written > CHECKPOINT_SECONDS:
            self._write_fields(frame, done, fields)
        if last:
            self._inputs, self._fields = {}, {}

    def flush(self) -> None:
        """Write what is only in memory, and wait until the store has everything."""
        self.settle()
        for index, (done, fields) in self._fields.items():
            frame = self.plan.frames[index]
            if done > self._stored_iterations(frame):
                self._write_fields(frame, done, fields)
        self._store.finish()

    def _write_fields(self, frame: FramePlan, done: int, fields: Fields) -> None:
        self.settle()
        # What an octave begins and ends with. In between, a window replaces its items too fast for a disk to follow.
        checkpoint = self._alone or done in (0, self.plan.iterations(self.level))
        self._store.write(self._group("fields"), frame.index, done, fields, checkpoint)
        self._written = time.perf_counter()
