"""The items of an optimisation: what a `Store` holds for each frame on the grid of an octave o, as tensors.

inputs.o    density, mask and simulation velocity of a frame
fields.o    the optimised fields; generation = iterations done
gain.o      normalises the average over the window, see `averaging_gain`
step.o      the step of one iteration along the frame's own gradient, and the change of the density that it
            starts from; generation = iterations done
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.resampling import resample_density, resample_mask, resample_velocity
from tnst_mi.frame import Frame
from tnst_mi.optimisation.alignment import averaging_gain, transported_sums
from tnst_mi.optimisation.mask import soft_mask
from tnst_mi.optimisation.parameterisation import Fields, times
from tnst_mi.optimisation.plan import FramePlan, Plan
from tnst_mi.optimisation.store import Arrays, Store, read_ahead
from tnst_mi.optimisation.window import reading_order, window_of

_GROUPS = ("inputs", "fields", "gain", "step")

#: Without a window, fields are kept in memory between iterations, and written to the store after this many seconds.
CHECKPOINT_SECONDS = 30.0


@dataclass(frozen=True)
class Inputs:
    """Density and mask (D, H, W) of an unstylized frame on the grid of an octave."""

    density: mi.TensorXf
    mask: mi.TensorXf


@dataclass(frozen=True)
class Current:
    """A frame as it stands in an octave: its plan, its inputs, and its fields, all tensors in memory."""

    frame: FramePlan
    inputs: Inputs
    fields: Fields


@dataclass(frozen=True)
class OwnStep:
    """A frame's own step, computed from its own gradient.

    Attributes:
        step: what to subtract from the fields.
        change: d* − d, (D, H, W), of the fields that it starts from; None if nothing uses it.
        loss, terms: of the same fields.
        seconds: time that it took.
    """

    step: Fields
    change: mi.TensorXf | None
    loss: float
    terms: dict[str, float]
    seconds: float


class Items:
    """The items of one octave. Reading gives tensors; writing replaces the earlier generation.

    With a window, everything is written immediately, steps and changes in half precision. Without one, a frame goes
    through all its iterations alone: its fields are kept in memory, and written at intervals and by `flush`; its steps
    stay in memory.

    Args:
        plan: of the sequence.
        level: which octave, from 0.
        store: where the items are kept.
    """

    def __init__(self, plan: Plan, level: int, store: Store) -> None:
        self.plan, self.level, self.octave, self._store = plan, level, plan.octaves[level], store
        self._alone = plan.window == 1
        self._inputs: dict[int, Inputs] = {}
        #: By frame: iterations done, and the fields after them.
        self._fields: dict[int, tuple[int, Fields]] = {}
        self._steps: dict[int, tuple[int, OwnStep]] = {}
        self._written = time.perf_counter()

    def _group(self, kind: str) -> str:
        return f"{kind}.{self.level}"

    # ---------------------------------------------------------------- progress

    def iterations_done(self, frame: FramePlan) -> int:
        """Number of iterations done on a frame; −1 if it has not entered the octave."""
        kept = self._fields.get(frame.index)
        return self._store.generation(self._group("fields"), frame.index) if kept is None else kept[0]

    def steps_found(self, frame: FramePlan) -> int:
        """Number of iterations whose own step has been computed for a frame, including those already applied."""
        kept = self._steps.get(frame.index)
        found = self._store.generation(self._group("step"), frame.index) if kept is None else kept[0]
        return max(found, self.iterations_done(frame))

    # ---------------------------------------------------------------- entering the octave

    def enter_inputs(self, frame: FramePlan, source: Frame) -> None:
        """Write a frame's inputs for the octave. Half precision suffices for a mask in [0, 1] and for velocities."""
        group, grid = self._group("inputs"), self.octave
        if self._store.generation(group, frame.index) >= 0:
            return
        mask = soft_mask(source.density, source.obstacle, self.plan.recipe.mask_strength)
        arrays = {
            "density": resample_density(source.density, 1.0, grid.shape, grid.cell_size),
            "mask": resample_mask(mask, 1.0, grid.shape, grid.cell_size).astype(np.float16),
        }
        if self.plan.window > 1 and frame.index + 1 < len(self.plan.frames):
            if source.velocity is None:
                raise InputError(f"{frame.name}: has no velocity, which a window of {self.plan.window} frames needs")
            velocity = resample_velocity(source.velocity, 1.0, grid.shape, grid.cell_size)
            arrays["velocity"] = velocity.astype(np.float16)
        self._store.write(group, frame.index, 0, arrays)

    def enter_fields(self, frame: FramePlan, coarser: Items | None) -> None:
        """Carry the fields of a frame over from the previous octave; in the first one they are 0."""
        if self.iterations_done(frame) >= 0:
            return
        parameterisation = frame.parameterisation
        if coarser is None:
            fields = parameterisation.zeros(self.octave)
        else:
            fields = parameterisation.carried(coarser.fields(frame), coarser.octave, self.octave)
        self._write_fields(frame, 0, fields)

    def enter_gain(self, frame: FramePlan) -> None:
        """Write the factor that turns the windowed sum of a frame into an average over smoke."""
        if self._store.generation(self._group("gain"), frame.index) >= 0:
            return
        weights = self.plan.window_weights
        total = self.windowed_sums(frame, "inputs", ["mask"], weights)["mask"]
        mask = mi.TensorXf(self._store.read(self._group("inputs"), frame.index, ["mask"])["mask"])
        gain = averaging_gain(mask, total, weights[0]).numpy().astype(np.float16)
        self._store.write(self._group("gain"), frame.index, 0, {"gain": gain})

    def forget(self) -> None:
        """Remove the items of this octave once it is done."""
        for kind in _GROUPS:
            self._store.remove(self._group(kind))

    # ---------------------------------------------------------------- reading

    def current(self, frames: Iterable[FramePlan]) -> Iterator[Current]:
        """The frames one by one as they stand; the next one is read ahead."""

        def read(frame: FramePlan) -> tuple[FramePlan, Arrays, Arrays]:
            inputs = self._store.read(self._group("inputs"), frame.index, ["density", "mask"])
            return frame, inputs, self._store.read(self._group("fields"), frame.index)

        waiting = list(frames)
        if self._alone and all(frame.index in self._inputs for frame in waiting):
            yield from (Current(frame, self._inputs[frame.index], self.fields(frame)) for frame in waiting)
            return
        for frame, arrays, fields in read_ahead(partial(read, frame) for frame in waiting):
            now = Current(frame, Inputs(mi.TensorXf(arrays["density"]), mi.TensorXf(arrays["mask"])), _tensors(fields))
            if self._alone:
                self._inputs = {frame.index: now.inputs}
                self._fields = {frame.index: (self._stored_iterations(frame), now.fields)}
            yield now

    def fields(self, frame: FramePlan) -> Fields:
        """The current fields of a frame."""
        kept = self._fields.get(frame.index)
        return _tensors(self._store.read(self._group("fields"), frame.index)) if kept is None else kept[1]

    def own_step(self, frame: FramePlan) -> OwnStep:
        """A frame's latest own step; with a window, its arrays are only in the store."""
        return self._steps[frame.index][1]

    def averaged_step(self, frame: FramePlan) -> Fields:
        """The steps of a frame's window, transported to it (paper Eq. 8) and averaged over smoke (Eq. 9)."""
        names = list(frame.parameterisation.channels)
        sums = self.windowed_sums(frame, "step", names, self.plan.window_weights)
        gain = mi.TensorXf(self._store.read(self._group("gain"), frame.index)["gain"])
        return Fields({name: times(gain, total) for name, total in sums.items()})

    def windowed_sums(
        self, frame: FramePlan, kind: str, names: Sequence[str], weights: np.ndarray
    ) -> dict[str, mi.TensorXf]:
        """Σ_i ω_|i−t| T_i^t(f_i) of the named arrays of one kind of item, with weights by distance."""
        index = frame.index
        window = window_of(index, len(self.plan.frames), 2 * len(weights) - 1)
        # Past frames are transported forwards by their own u_i, future ones backwards by u_{i−1}.
        links = [(i, i if i < index else i - 1) for i in reading_order(index, window)]

        def read(i: int, link: int) -> tuple[Arrays, np.ndarray]:
            velocity = self._store.read(self._group("inputs"), link, ["velocity"])["velocity"]
            return self._arrays(i, kind, names), velocity

        neighbours = (
            (_tensors(fields), mi.TensorXf(velocity))
            for fields, velocity in read_ahead(partial(read, *link) for link in links)
        )
        own = _tensors(self._arrays(index, kind, names))
        return transported_sums(own, weights, window, index, neighbours, self.octave.cell_size)

    def _arrays(self, index: int, kind: str, names: Sequence[str]) -> Arrays:
        """The named arrays of an item; zeros for a frame that stays unchanged, which counts as one without smoke."""
        frame = self.plan.frames[index]
        if not frame.still:
            return self._store.read(self._group(kind), index, names)
        shape, channels = self.octave.shape, frame.parameterisation.channels
        return {name: np.zeros((*shape, 3) if channels.get(name) == 3 else shape, np.float32) for name in names}

    def _stored_iterations(self, frame: FramePlan) -> int:
        return self._store.generation(self._group("fields"), frame.index)

    # ---------------------------------------------------------------- writing

    def put_step(self, frame: FramePlan, iteration: int, found: OwnStep) -> None:
        """Store a frame's own step of an iteration, and log it.

        Raises:
            InputError: it exceeds the range of half precision.
        """
        entry = {"frame": frame.name, "octave": self.level, "iteration": iteration, "loss": found.loss}
        self._store.log(entry | {"terms": found.terms, "seconds": found.seconds})
        if self._alone:
            self._steps = {frame.index: (iteration + 1, found)}
            return
        self._steps = {frame.index: (iteration + 1, replace(found, step=Fields(), change=None))}
        arrays = found.step if found.change is None else {**found.step, "change": found.change}
        with np.errstate(over="ignore"):
            half = {name: tensor.numpy().astype(np.float16) for name, tensor in arrays.items()}
        if not all(np.isfinite(array).all() for array in half.values()):
            raise InputError(
                f"{frame.name}: steps or changes of the density exceed {np.finfo(np.float16).max:g}; "
                "scale the density to about 1 and gamma accordingly"
            )
        self._store.write(self._group("step"), frame.index, iteration + 1, half)

    def put_fields(self, frame: FramePlan, done: int, fields: Fields) -> None:
        """Store the fields of a frame after `done` iterations."""
        if not self._alone:
            self._write_fields(frame, done, fields)
            return
        last = done == self.plan.recipe.iterations
        self._fields = {frame.index: (done, fields)}
        # A step that has been applied is no longer needed.
        self._steps = {frame.index: (done, replace(self._steps[frame.index][1], step=Fields(), change=None))}
        if last or time.perf_counter() - self._written > CHECKPOINT_SECONDS:
            self._write_fields(frame, done, fields)
        if last:
            self._inputs, self._fields = {}, {}

    def flush(self) -> None:
        """Write the fields that are only in memory."""
        for index, (done, fields) in self._fields.items():
            frame = self.plan.frames[index]
            if done > self._stored_iterations(frame):
                self._write_fields(frame, done, fields)

    def _write_fields(self, frame: FramePlan, done: int, fields: Fields) -> None:
        arrays = {name: tensor.numpy() for name, tensor in fields.items()}
        self._store.write(self._group("fields"), frame.index, done, arrays)
        self._written = time.perf_counter()


def _tensors(arrays: Arrays) -> Fields:
    return Fields({name: mi.TensorXf(array) for name, array in arrays.items()})
