"""Stylizing a sequence: all frames together, coarse to fine, their gradients aligned in time (paper Alg. 1).

Every step here takes items of the `SequenceState` and makes others, one frame at a time. So a run goes on where it was
killed, and only one frame, and its neighbours one after the other, need be in memory.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Sequence

import drjit as dr
import mitsuba as mi

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import opaque
from tnst_mi.frame import Frame
from tnst_mi.losses.objective import Objective, rms_scales
from tnst_mi.machine.backend import torch_device
from tnst_mi.machine.interrupt import Interrupt, deferred_interrupt
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation import coherence
from tnst_mi.optimisation.finish import stylized_frame
from tnst_mi.optimisation.goals import objective_of
from tnst_mi.optimisation.gradient import OctaveProblem
from tnst_mi.optimisation.result import Progress, Stylized
from tnst_mi.optimisation.state import Current, SequenceState, Shot
from tnst_mi.optimisation.store import Store
from tnst_mi.optimisation.window import window_of, window_weights
from tnst_mi.recipe.recipe import Recipe

#: Frames without a window, which keep their fields in memory between iterations, write them after this many seconds.
CHECKPOINT_SECONDS = 30.0


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
        self._recipe, self._exposure = recipe, exposure
        self._network = network.to(torch_device())
        self._objective, self._weighed = objective or objective_of(recipe), objective is None
        shots = [
            Shot(name, recipe.at(number), index if number is None else number, scale)
            for index, (name, number, scale) in enumerate(zip(names, numbers, step_scales, strict=True))
        ]
        self._state = SequenceState(frames, shots, recipe, store)
        self._problem: tuple[int, OctaveProblem] | None = None
        self._on_iteration: Callable[[Progress], None] | None = None
        self._interrupt = Interrupt()
        self.interrupted = False

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
        state, last = self._state, self._recipe.octaves - 1
        wanted = [index for index in range(len(state.shots)) if index not in finished]
        if not wanted:
            return
        with deferred_interrupt() as self._interrupt:
            try:
                for octave in range(state.reached() if state.alive else last + 1, last + 1):
                    self._enter(octave)
                    self._calibrate(octave)
                    if state.window > 1:
                        self._iterate_together(octave)
                    elif octave < last:
                        for index in state.alive:
                            self._iterate_alone(octave, index)
                for index in wanted:
                    self._stop_here()
                    if state.window == 1 and index in state.alive:
                        self._iterate_alone(last, index)
                    yield index, self._finish(index)
            except KeyboardInterrupt:
                self.interrupted = True
            if self.interrupted and len(state.shots) == 1:
                result = self._finish(0)
                result.interrupted = True
                yield 0, result

    def _stop_here(self) -> None:
        """Points at which a run may end."""
        if self._interrupt.requested:
            raise KeyboardInterrupt

    def _enter(self, octave: int) -> None:
        """Bring every frame to an octave, and forget the ones before."""
        state = self._state
        # Dr.Jit keeps the blocks of the octave before, which are too small for this one.
        dr.flush_malloc_cache()
        # Neighbours are transported through unchanged frames too.
        for index in range(len(state.shots)) if state.window > 1 else state.alive:
            self._stop_here()
            state.enter_inputs(octave, index)
        for index in state.alive:
            self._stop_here()
            state.enter_fields(octave, index)
        for earlier in range(octave):
            state.forget(earlier)
        for index in state.alive if state.window > 1 else ():
            self._stop_here()
            state.enter_gain(octave, index)

    def _calibrate(self, octave: int) -> None:
        """Scale the terms of the loss by the RMS of their image gradients, pooled over the sequence."""
        state, problem = self._state, self._octave_problem(octave)
        if state.store.numbers(f"scales.{octave}") is None:
            sums = []
            for current in state.current(octave, state.alive):
                self._stop_here()
                seed, recipe = self._seed(current.index, octave, 0), state.shots[current.index].recipe
                sums.append(problem.gradient_square_sum(current.parameters, current.density, recipe, seed))
            scales = rms_scales(sums)
            state.store.write_numbers(f"scales.{octave}", scales)
            problem.loss.set_scales(scales)

    # ---------------------------------------------------------------- iterations

    def _iterate_alone(self, octave: int, index: int) -> None:
        """All iterations of one frame, which has nothing to do with the others."""
        state, iterations = self._state, self._recipe.iterations
        done = state.done(octave, index)
        if done >= iterations:
            return
        self._stop_here()
        (current,) = state.current(octave, [index])
        written = time.perf_counter()
        for iteration in range(done, iterations):
            entry, _ = self._find_step(octave, iteration, current)
            current.parameters.descend()
            state.store.log(entry)
            try:
                self._report(entry)
                self._stop_here()
            except KeyboardInterrupt:
                # Only here are fields and count in step; a second Ctrl-C comes anywhere, and leaves what was written.
                state.write_fields(octave, index, iteration + 1, current.parameters)
                raise
            if iteration + 1 == iterations or time.perf_counter() - written > CHECKPOINT_SECONDS:
                state.write_fields(octave, index, iteration + 1, current.parameters)
                written = time.perf_counter()

    def _iterate_together(self, octave: int) -> None:
        """Iterations of all frames: first every frame's own step, then every frame's average over its window."""
        state = self._state
        for iteration in range(self._recipe.iterations):
            done = iteration + 1
            due = [index for index in state.alive if state.done(octave, index) < done]
            for current in state.current(octave, [index for index in due if state.stepped(octave, index) < done]):
                self._stop_here()
                entry, stylized = self._find_step(octave, iteration, current)
                change = {"change": stylized - current.density} if self._recipe.coherence > 0 else {}
                state.store.log(entry)
                state.write_step(octave, current.index, done, current.parameters.steps | change)
                self._report(entry)
            for current in state.current(octave, due):
                self._stop_here()
                parameters = current.parameters
                steps = state.averaged_steps(octave, current.index, list(parameters.channels))
                if self._recipe.coherence > 0:
                    coherent = self._coherence_steps(octave, current)
                    steps = {name: step + coherent[name] for name, step in steps.items()}
                parameters.steps = steps
                parameters.descend()
                state.write_fields(octave, current.index, done, parameters)

    def _find_step(self, octave: int, iteration: int, current: Current) -> tuple[dict, mi.TensorXf]:
        """Find a frame's own step, left in the parameters; what the log says of it, and the density it starts from."""
        since = time.perf_counter()
        shot, problem = self._state.shots[current.index], self._octave_problem(octave)
        seed = self._seed(current.index, octave, iteration)
        self._weigh(problem, shot)
        try:
            found = problem.gradient(current.parameters, current.density, shot.recipe, seed)
        except InputError as error:
            where = f"iteration {iteration + 1} of octave {octave + 1}"
            raise InputError(f"{shot.name}, {where}: {error}") from error
        current.parameters.find_steps(current.mask, shot.eta, self._state.rows, shot.recipe.pyramid_levels)
        entry = {
            "frame": shot.name,
            "octave": octave,
            "iteration": iteration,
            "loss": found.loss,
            "terms": found.terms,
            "seconds": time.perf_counter() - since,
        }
        return entry, found.density

    def _coherence_steps(self, octave: int, current: Current) -> dict[str, mi.TensorXf]:
        """Steps towards the average of the changes of the density around a frame."""
        state, index, weights = self._state, current.index, window_weights(coherence.WINDOW)
        shot = state.shots[index]
        total = state.windowed_sums(octave, index, f"step.{octave}", ["change"], weights)["change"]
        # Frames that are left unchanged have no change to follow.
        window = set(window_of(index, len(state.shots), coherence.WINDOW)) & set(state.alive)
        present = sum(weights[abs(i - index)] for i in window)
        return coherence.coherence_steps(
            current.parameters,
            current.density,
            current.mask,
            total * opaque(1 / present),
            shot.recipe.coherence * shot.eta,
            state.rows,
            shot.recipe.pyramid_levels,
        )

    # ---------------------------------------------------------------- results

    def _finish(self, index: int) -> Stylized:
        """The result of a frame as far as it got, with its losses before and after."""
        state, last = self._state, self._recipe.octaves - 1
        frame, shot = state.frames[index], state.shots[index]
        # The blocks that Dr.Jit keeps for the iterations are not needed any more.
        dr.flush_malloc_cache()
        result = stylized_frame(state, index, frame)
        if result.history and state.store.numbers(f"scales.{last}") is not None:
            problem = self._octave_problem(last)
            self._weigh(problem, shot)
            result.loss_before, result.terms_before = problem.judge(frame.density, shot.recipe)
            result.loss_after, result.terms_after = problem.judge(result.density, shot.recipe)
        return result

    # ---------------------------------------------------------------- parts

    def _octave_problem(self, octave: int) -> OctaveProblem:
        if self._problem is None or self._problem[0] != octave:
            problem = OctaveProblem(self._objective, self._network, self._state.levels[octave], self._exposure)
            scales = self._state.store.numbers(f"scales.{octave}")
            if scales is not None:
                problem.loss.set_scales(scales)
            self._problem = octave, problem
        return self._problem[1]

    def _weigh(self, problem: OctaveProblem, shot: Shot) -> None:
        """Give the terms the weights that they have in a frame; an objective that was given keeps its own."""
        if self._weighed:
            problem.loss.weigh(shot.weights)

    def _seed(self, index: int, octave: int, iteration: int) -> tuple[int, ...]:
        return self._recipe.seed, self._state.shots[index].number, octave, iteration

    def _report(self, entry: dict) -> None:
        """Tell that an iteration of a frame has been done."""
        if self._on_iteration is None:
            return
        state, iterations = self._state, self._recipe.iterations
        names = [state.shots[index].name for index in state.alive]
        octave, iteration, position = entry["octave"], entry["iteration"], names.index(entry["frame"])
        within = iteration * len(names) + position if state.window > 1 else position * iterations + iteration
        self._on_iteration(
            Progress(
                entry["frame"],
                octave,
                self._recipe.octaves,
                iteration,
                iterations,
                entry["loss"],
                entry["terms"],
                octave * len(names) * iterations + within + 1,
                self._recipe.octaves * len(names) * iterations,
            )
        )
