"""Stylizing a sequence: all frames together, coarse to fine, their gradients aligned in time (paper Alg. 1).

The state of the run is in a `Store`, and everything here takes items of it and makes others:

    inputs.o    density, mask, simulation velocity of a frame on the grid of octave o
    fields.o    what is optimised; generation = number of iterations done
    gain.o      normalises the average over the window, see `averaging_gain`
    step.o      what one iteration would change by the frame's own gradient, and the change of the density that it
                starts from; generation = iterations done

so that a run goes on where it was killed, and only the frames of a window need be in memory.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi import coherence
from tnst_mi.alignment import averaging_gain, transported_sums
from tnst_mi.backend import torch_device
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.frame_gradient import OctaveProblem
from tnst_mi.goals import objective_of, term_weights
from tnst_mi.googlenet import GoogLeNet
from tnst_mi.grid import Octave, octaves, opaque
from tnst_mi.interrupt import Interrupt, deferred_interrupt
from tnst_mi.mask import soft_mask
from tnst_mi.objective import Objective, rms_scales
from tnst_mi.parameterisation import DensityOffset, Parameterisation, Transport, times
from tnst_mi.recipe import Recipe
from tnst_mi.resample import resample_density, resample_velocity
from tnst_mi.store import Arrays, Store, read_ahead
from tnst_mi.window import reading_order, window_of, window_weights

#: Single frames, which keep their fields in memory between iterations, write them after this many seconds.
CHECKPOINT_SECONDS = 30.0


@dataclass(frozen=True)
class Progress:
    """Where a run stands, reported after every iteration of every frame; `done` of `total` of them."""

    frame: str
    octave: int
    octaves: int
    iteration: int
    iterations: int
    loss: float
    terms: dict[str, float]
    done: int
    total: int


@dataclass
class Stylized:
    """Result of stylizing one frame.

    Attributes:
        density: d*, blended as the recipe says, (D, H, W) float32, full resolution.
        velocity: v*, (D, H, W, 3) float32, full-resolution cells per frame; 0 for the density parameterisation.
        potential: (Φ, Ψ) at full resolution, None for an absent one.
        history: one dictionary per iteration: octave, iteration, loss, terms, seconds.
        interrupted: Ctrl-C ended the optimisation early; the result is what was reached.
        note: a remark for the user, such as for an empty frame.
        timings: seconds of each octave ("octave 0", ...) and in total.
        loss_before, loss_after: loss of the unstylized and the stylized density, seen from the same three views; None
            where nothing was stylized.
    """

    density: np.ndarray
    velocity: np.ndarray
    potential: tuple[np.ndarray | None, np.ndarray | None] = (None, None)
    history: list[dict] = field(default_factory=list)
    interrupted: bool = False
    note: str | None = None
    timings: dict[str, float] = field(default_factory=dict)
    loss_before: float | None = None
    loss_after: float | None = None


@dataclass(frozen=True)
class _Shot:
    """One frame's part of the plan: its recipe, the number that seeds its views, its step size, its weights."""

    name: str
    recipe: Recipe
    number: int
    step_scale: float
    weights: list[float] | None

    @property
    def eta(self) -> float:
        """The step size η_t."""
        return self.recipe.eta * self.step_scale

    @property
    def still(self) -> bool:
        """Nothing is seen of the frame, so nothing of it is changed."""
        return self.step_scale == 0.0


class SequenceOptimisation:
    """The optimisation of a sequence; `run` does it.

    Attributes:
        interrupted: Ctrl-C ended the run.
    """

    def __init__(
        self,
        frames: Sequence[Frame],
        names: Sequence[str],
        numbers: Sequence[int | None],
        recipe: Recipe,
        network: GoogLeNet,
        store: Store,
        exposure: float,
        step_scales: Sequence[float],
        objective: Objective | None = None,
    ) -> None:
        """Prepare the optimisation.

        Args:
            frames: the frames in their order; they are read from this sequence when they are needed.
            names: of the frames.
            numbers: of the frames, None where a frame has none.
            recipe: what to stylize towards, and how.
            network: the GoogLeNet that judges the images; it is moved to the device of the active variant.
            store: the state, which may be that of an earlier run with the same arguments.
            exposure: factor from rendered images to the network's [0, 1].
            step_scales: factors of η, S_t / max_t S_t with the pixel sums S_t of the unstylized main views (the σ of
                paper Eq. 2); a frame with 0 is left unchanged.
            objective: what to minimise, in place of the recipe's terms.
        """
        self._frames, self._recipe, self._store = frames, recipe, store
        self._network = network.to(torch_device())
        self._objective = objective or objective_of(recipe)
        self._exposure = exposure
        self._shots = []
        for index, (name, number, scale) in enumerate(zip(names, numbers, step_scales, strict=True)):
            of_frame = recipe.at(number)
            weights = term_weights(of_frame) if objective is None else None
            self._shots.append(_Shot(name, of_frame, index if number is None else number, scale, weights))
        self._alive = [index for index, shot in enumerate(self._shots) if not shot.still]
        self._window = recipe.window if len(self._shots) > 1 else 1
        self._window_weights = window_weights(self._window, recipe.window_weights)
        self._levels: list[Octave] = []
        self._problem: tuple[int, OctaveProblem] | None = None
        self._on_iteration: Callable[[Progress], None] | None = None
        self._interrupt = Interrupt()
        self.interrupted = False

    # ---------------------------------------------------------------- the run

    def run(
        self, on_iteration: Callable[[Progress], None] | None = None, finished: Collection[int] = ()
    ) -> Iterator[tuple[int, Stylized]]:
        """Stylize the frames, and give each with its index once it is done.

        Ctrl-C ends the run after the current step; a second one at once. A single frame is given as far as it got;
        frames of a sequence stay in the store, from which another run goes on.

        Args:
            on_iteration: called after every iteration of every frame.
            finished: indices of frames that are not wanted any more.

        Raises:
            InputError: the network lacks a layer, channel or class, a picture cannot be used, a frame or the store is
                damaged, or a loss is not finite.
        """
        self._on_iteration = on_iteration
        self._levels = octaves(self._frames[0].density.shape, self._recipe.octaves, self._recipe.scale_factor)
        wanted = [index for index in range(len(self._shots)) if index not in finished]
        with deferred_interrupt() as self._interrupt:
            try:
                last = len(self._levels) - 1
                for octave in range(self._first_octave() if self._alive else last + 1, last + 1):
                    self._enter(octave)
                    self._calibrate(octave)
                    if self._window > 1:
                        self._iterate_together(octave)
                    elif octave < last:
                        for index in self._alive:
                            self._iterate_alone(octave, index)
                for index in wanted:
                    self._stop_here()
                    if self._window == 1 and index in self._alive:
                        self._iterate_alone(last, index)
                    yield index, self._finish(index)
            except KeyboardInterrupt:
                self.interrupted = True
            if self.interrupted and len(self._shots) == 1:
                result = self._finish(0)
                result.interrupted = True
                yield 0, result

    def _stop_here(self) -> None:
        """Points at which a run may end."""
        if self._interrupt.requested:
            raise KeyboardInterrupt

    def _first_octave(self) -> int:
        """The octave that an earlier run reached: the last that all frames have entered."""
        for octave in reversed(range(len(self._levels))):
            if all(self._store.generation(f"fields.{octave}", index) >= 0 for index in self._alive):
                return octave
        return 0

    def _enter(self, octave: int) -> None:
        """Bring every frame to an octave: its inputs, its fields, and what normalises its average."""
        store, grid = self._store, self._levels[octave]
        # Neighbours are transported through unchanged frames too.
        for index in range(len(self._shots)) if self._window > 1 else self._alive:
            self._stop_here()
            if store.generation(f"inputs.{octave}", index) < 0:
                store.write(f"inputs.{octave}", index, 0, self._inputs(index, grid))
        for index in self._alive:
            self._stop_here()
            if store.generation(f"fields.{octave}", index) < 0:
                parameters = self._parameters(index)
                if octave > 0:
                    parameters.restore(store.read(f"fields.{octave - 1}", index), self._levels[octave - 1])
                parameters.enter(grid)
                store.write(f"fields.{octave}", index, 0, parameters.arrays())
        for earlier in range(octave):
            for group in ("inputs", "fields", "gain", "step"):
                store.remove(f"{group}.{earlier}")
        if self._window > 1:
            for index in self._alive:
                self._stop_here()
                if store.generation(f"gain.{octave}", index) < 0:
                    store.write(f"gain.{octave}", index, 0, self._gain(octave, index))

    def _inputs(self, index: int, grid: Octave) -> Arrays:
        """What an octave needs of a frame. Half precision is ample for a mask in [0, 1] and for velocities."""
        frame = self._frames[index]
        mask = soft_mask(frame.density, frame.obstacle)
        arrays = {
            "density": resample_density(frame.density, 1.0, grid.shape, grid.cell_size),
            "mask": resample_density(mask, 1.0, grid.shape, grid.cell_size).astype(np.float16),
        }
        if self._window > 1 and index + 1 < len(self._shots):
            if frame.velocity is None:
                raise InputError(f"{frame.name}: has no velocity, which a window of {self._window} frames needs")
            velocity = resample_velocity(frame.velocity, 1.0, grid.shape, grid.cell_size)
            arrays["velocity"] = velocity.astype(np.float16)
        return arrays

    def _calibrate(self, octave: int) -> None:
        """Scale the terms of the loss by the RMS of their image gradients, pooled over the sequence."""
        problem = self._octave_problem(octave)
        if self._store.numbers(f"scales.{octave}") is None:
            sums = []
            for index, density, _, parameters in self._states(octave, self._alive):
                self._stop_here()
                seed = self._seed(index, octave, 0)
                sums.append(problem.gradient_square_sum(parameters, density, self._shots[index].recipe, seed))
            scales = rms_scales(sums)
            self._store.write_numbers(f"scales.{octave}", scales)
            problem.loss.set_scales(scales)

    # ---------------------------------------------------------------- iterations

    def _iterate_alone(self, octave: int, index: int) -> None:
        """All iterations of one frame, which has nothing to do with the others."""
        store, iterations = self._store, self._recipe.iterations
        group = f"fields.{octave}"
        begin = store.generation(group, index)
        if begin >= iterations:
            return
        ((_, density, mask, parameters),) = self._states(octave, [index])
        done, written = begin, time.perf_counter()
        try:
            for iteration in range(begin, iterations):
                self._stop_here()
                entry, _ = self._gradient_step(octave, index, iteration, parameters, density, mask)
                parameters.descend()
                store.log(entry)
                done = iteration + 1
                self._report(entry)
                if done == iterations or time.perf_counter() - written > CHECKPOINT_SECONDS:
                    store.write(group, index, done, parameters.arrays())
                    written = time.perf_counter()
        except KeyboardInterrupt:
            if store.generation(group, index) < done:
                store.write(group, index, done, parameters.arrays())
            raise

    def _iterate_together(self, octave: int) -> None:
        """Iterations of all frames: first every frame's own step, then every frame's average over its window."""
        store = self._store
        fields, steps = f"fields.{octave}", f"step.{octave}"
        for iteration in range(self._recipe.iterations):
            done = iteration + 1
            due = [i for i in self._alive if store.generation(steps, i) < done and store.generation(fields, i) < done]
            for index, density, mask, parameters in self._states(octave, due):
                self._stop_here()
                entry, stylized = self._gradient_step(octave, index, iteration, parameters, density, mask)
                store.log(entry)
                step = parameters.steps | ({"change": stylized - density} if self._recipe.coherence > 0 else {})
                store.write(
                    steps, index, done, {name: array.numpy().astype(np.float16) for name, array in step.items()}
                )
                self._report(entry)
            due = [index for index in self._alive if store.generation(fields, index) < done]
            for index, density, mask, parameters in self._states(octave, due):
                self._stop_here()
                gain = mi.TensorXf(store.read(f"gain.{octave}", index)["gain"])
                names = list(parameters.channels)
                sums = self._windowed_sums(octave, index, steps, names, self._window_weights)
                total = {name: times(gain, sums[name]) for name in names}
                if self._recipe.coherence > 0:
                    coherent = self._coherence_steps(octave, index, parameters, density, mask)
                    total = {name: total[name] + coherent[name] for name in names}
                parameters.steps = total
                parameters.descend()
                store.write(fields, index, done, parameters.arrays())

    def _gradient_step(
        self,
        octave: int,
        index: int,
        iteration: int,
        parameters: Parameterisation,
        density: mi.TensorXf,
        mask: mi.TensorXf,
    ) -> tuple[dict, mi.TensorXf]:
        """Find a frame's own step, left in the parameters; what the log says of it, and the density it starts from."""
        since = time.perf_counter()
        shot, problem = self._shots[index], self._octave_problem(octave)
        if shot.weights is not None:
            problem.loss.weigh(shot.weights)
        try:
            found = problem.gradient(parameters, density, shot.recipe, self._seed(index, octave, iteration))
        except InputError as error:
            where = f"iteration {iteration + 1} of octave {octave + 1}"
            raise InputError(f"{shot.name}, {where}: {error}") from error
        parameters.find_steps(mask, shot.eta, self._levels[-1].shape[1], shot.recipe.pyramid_levels)
        entry = {
            "frame": shot.name,
            "octave": octave,
            "iteration": iteration,
            "loss": found.loss,
            "terms": found.terms,
            "seconds": time.perf_counter() - since,
        }
        return entry, found.density

    def _coherence_steps(
        self, octave: int, index: int, parameters: Parameterisation, density: mi.TensorXf, mask: mi.TensorXf
    ) -> dict[str, mi.TensorXf]:
        """Steps towards the average of the changes of the density around a frame."""
        shot, weights = self._shots[index], window_weights(coherence.WINDOW)
        total = self._windowed_sums(octave, index, f"step.{octave}", ["change"], weights)["change"]
        present = sum(weights[abs(i - index)] for i in window_of(index, len(self._shots), coherence.WINDOW))
        eta, rows = shot.recipe.coherence * shot.eta, self._levels[-1].shape[1]
        target = total * opaque(1 / present)
        return coherence.coherence_steps(parameters, density, mask, target, eta, rows, shot.recipe.pyramid_levels)

    def _windowed_sums(
        self, octave: int, index: int, group: str, names: Sequence[str], weights: np.ndarray
    ) -> dict[str, mi.TensorXf]:
        """Σ_i ω_|i−t| T_i^t(f_i) of the named arrays of a group's items, with weights by distance."""
        window = window_of(index, len(self._shots), 2 * len(weights) - 1)
        # Towards a frame from its past goes u_i, back from its future what led there.
        links = [(i, i if i < index else i - 1) for i in reading_order(index, window)]
        own = self._masked(octave, index, group, names)
        h = self._levels[octave].cell_size
        reads = (partial(self._neighbour, octave, i, link, group, names) for i, link in links)
        neighbours = ((_tensors(fields), mi.TensorXf(velocity)) for fields, velocity in read_ahead(reads))
        return transported_sums(_tensors(own), weights, window, index, neighbours, h)

    def _neighbour(
        self, octave: int, index: int, link: int, group: str, names: Sequence[str]
    ) -> tuple[Arrays, np.ndarray]:
        """Arrays of a neighbour, and the velocity on its way to the frame that is averaged."""
        velocity = self._store.read(f"inputs.{octave}", link)["velocity"]
        return self._masked(octave, index, group, names), velocity

    def _masked(self, octave: int, index: int, group: str, names: Sequence[str]) -> Arrays:
        """Some arrays of an item; 0 for a frame that is left unchanged, which counts as one without smoke."""
        if self._shots[index].still:
            shape = self._levels[octave].shape
            channels = self._parameters(index).channels
            return {name: np.zeros((*shape, 3) if channels.get(name, 1) == 3 else shape, np.float32) for name in names}
        item = self._store.read(group, index)
        return {name: item[name] for name in names}

    def _gain(self, octave: int, index: int) -> Arrays:
        group = f"inputs.{octave}"
        total = self._windowed_sums(octave, index, group, ["mask"], self._window_weights)["mask"]
        mask = mi.TensorXf(self._store.read(group, index)["mask"])
        return {"gain": averaging_gain(mask, total, self._window_weights[0]).numpy().astype(np.float16)}

    # ---------------------------------------------------------------- results

    def _finish(self, index: int) -> Stylized:
        """Apply the fields that were reached to the unstylized frame at full resolution."""
        frame, shot, full = self._frames[index], self._shots[index], self._levels[-1]
        octave = self._first_octave()
        if shot.still or self._store.generation(f"fields.{octave}", index) < 0:
            seen = f"renders black at gamma {shot.recipe.gamma:g}" if frame.density.any() else "is empty"
            note = f"{frame.name} {seen}: nothing to stylize, left unchanged" if shot.still else None
            return Stylized(frame.density.copy(), np.zeros((*frame.density.shape, 3), np.float32), note=note)
        parameters = self._parameters(index)
        parameters.restore(self._store.read(f"fields.{octave}", index), self._levels[octave])
        parameters.enter(full)
        with dr.suspend_grad():
            density = np.maximum(parameters.density(mi.TensorXf(frame.density)).numpy(), 0)
            if isinstance(parameters, Transport):
                velocity, fields = parameters.velocity().numpy(), parameters.arrays()
            else:
                velocity, fields = np.zeros((*frame.density.shape, 3), np.float32), {}
        blend = shot.recipe.blend
        result = Stylized(np.float32((1.0 - blend) * frame.density + blend * density), velocity)
        result.potential = fields.get("phi"), fields.get("psi")
        result.history = self._history(shot.name)
        for entry in result.history:
            name = f"octave {entry['octave']}"
            result.timings[name] = result.timings.get(name, 0.0) + entry["seconds"]
        result.timings["total"] = sum(result.timings.values())
        if self._store.numbers(f"scales.{len(self._levels) - 1}") is not None:
            problem = self._octave_problem(len(self._levels) - 1)
            if shot.weights is not None:
                problem.loss.weigh(shot.weights)
            result.loss_before = problem.judge(frame.density, shot.recipe)
            result.loss_after = problem.judge(result.density, shot.recipe)
        return result

    def _history(self, name: str) -> list[dict]:
        """The log of a frame; what a killed run had logged and then did again counts once."""
        entries = {(e["octave"], e["iteration"]): e for e in self._store.entries() if e["frame"] == name}
        return [{key: value for key, value in entries[at].items() if key != "frame"} for at in sorted(entries)]

    # ---------------------------------------------------------------- parts

    def _parameters(self, index: int) -> Parameterisation:
        if self._recipe.parameterisation == "density":
            return DensityOffset()
        # All frames have the same fields, also where λ goes from 0 to 1 over the sequence.
        lams = [shot.recipe.lam for shot in self._shots]
        return Transport(self._shots[index].recipe.lam, self._recipe.steps, max(lams) > 0, min(lams) < 1)

    def _octave_problem(self, octave: int) -> OctaveProblem:
        if self._problem is None or self._problem[0] != octave:
            problem = OctaveProblem(self._objective, self._network, self._levels[octave], self._exposure)
            scales = self._store.numbers(f"scales.{octave}")
            if scales is not None:
                problem.loss.set_scales(scales)
            self._problem = octave, problem
        return self._problem[1]

    def _states(
        self, octave: int, indices: Sequence[int]
    ) -> Iterator[tuple[int, mi.TensorXf, mi.TensorXf, Parameterisation]]:
        """Index, density, mask and parameters of some frames on the grid of an octave, read ahead."""

        def read(index: int) -> tuple[int, Arrays, Arrays]:
            return index, self._store.read(f"inputs.{octave}", index), self._store.read(f"fields.{octave}", index)

        for index, inputs, fields in read_ahead(partial(read, index) for index in indices):
            parameters = self._parameters(index)
            parameters.restore(fields, self._levels[octave])
            yield index, mi.TensorXf(inputs["density"]), mi.TensorXf(inputs["mask"]), parameters

    def _seed(self, index: int, octave: int, iteration: int) -> tuple[int, ...]:
        return self._recipe.seed, self._shots[index].number, octave, iteration

    def _report(self, entry: dict) -> None:
        """Tell that an iteration of a frame has been done."""
        if self._on_iteration is None:
            return
        names = [self._shots[index].name for index in self._alive]
        octave, iteration, position = entry["octave"], entry["iteration"], names.index(entry["frame"])
        iterations, count = self._recipe.iterations, len(names)
        within = iteration * count + position if self._window > 1 else position * iterations + iteration
        self._on_iteration(
            Progress(
                entry["frame"],
                octave,
                len(self._levels),
                iteration,
                iterations,
                entry["loss"],
                entry["terms"],
                octave * count * iterations + within + 1,
                len(self._levels) * count * iterations,
            )
        )


def _tensors(arrays: Arrays) -> dict[str, mi.TensorXf]:
    return {name: mi.TensorXf(array) for name, array in arrays.items()}
