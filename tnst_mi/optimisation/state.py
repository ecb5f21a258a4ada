"""The state of a sequence that is being stylized: the items of a `Store`, as tensors on the grid of an octave o.

inputs.o    density, mask and simulation velocity of a frame
fields.o    what is optimised; generation = iterations done
gain.o      normalises the average over the window, see `averaging_gain`
step.o      what one iteration would change by the frame's own gradient, and the change of the density that it
            starts from; generation = iterations done
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Octave, octaves
from tnst_mi.fields.resampling import resample_density, resample_mask, resample_velocity
from tnst_mi.frame import Frame
from tnst_mi.optimisation.alignment import averaging_gain, transported_sums
from tnst_mi.optimisation.goals import term_weights
from tnst_mi.optimisation.mask import soft_mask
from tnst_mi.optimisation.parameterisation import DensityOffset, Parameterisation, Transport, times
from tnst_mi.optimisation.store import Arrays, Store, read_ahead
from tnst_mi.optimisation.window import reading_order, window_of, window_weights
from tnst_mi.recipe.recipe import Recipe

_GROUPS = ("inputs", "fields", "gain", "step")


@dataclass(frozen=True)
class Shot:
    """What is planned for a frame: its recipe, the number that seeds its views, the factor S_t / max_t S_t of η."""

    name: str
    recipe: Recipe
    number: int
    step_scale: float

    @property
    def eta(self) -> float:
        """The step size η_t."""
        return self.recipe.eta * self.step_scale

    @property
    def still(self) -> bool:
        """Nothing is seen of the frame, so nothing of it is changed."""
        return self.step_scale == 0.0

    @property
    def weights(self) -> list[float]:
        """Weights of the recipe's terms."""
        return term_weights(self.recipe)


@dataclass(frozen=True)
class Current:
    """A frame as it stands on the grid of an octave."""

    index: int
    density: mi.TensorXf
    mask: mi.TensorXf
    parameters: Parameterisation


class SequenceState:
    """The frames, what is planned for each, and what a store holds of them.

    Args:
        frames: the frames in their order; they are read from this sequence when they are needed.
        shots: what is planned for each.
        recipe: of the sequence.
        store: the items.
    """

    def __init__(self, frames: Sequence[Frame], shots: Sequence[Shot], recipe: Recipe, store: Store) -> None:
        self.frames, self.shots, self.store, self._recipe = frames, shots, store, recipe
        #: Indices of the frames that are changed.
        self.alive = [index for index, shot in enumerate(shots) if not shot.still]
        self.window = recipe.window if len(shots) > 1 else 1
        self._weights = window_weights(self.window, recipe.window_weights)

    @cached_property
    def levels(self) -> list[Octave]:
        """The octaves from coarse to fine."""
        return octaves(self.frames[0].density.shape, self._recipe.octaves, self._recipe.scale_factor)

    @property
    def rows(self) -> int:
        """H of the full grid."""
        return self.levels[-1].shape[1]

    def reached(self) -> int:
        """The octave that the run has reached: the last that all frames have entered."""
        for octave in reversed(range(len(self.levels))):
            if all(self.done(octave, index) >= 0 for index in self.alive):
                return octave
        return 0

    def done(self, octave: int, index: int) -> int:
        """Number of iterations that a frame has had in an octave; −1 where it has not entered it."""
        return self.store.generation(f"fields.{octave}", index)

    def forget(self, octave: int) -> None:
        """Remove the items of an octave that is done."""
        for group in _GROUPS:
            self.store.remove(f"{group}.{octave}")

    # ---------------------------------------------------------------- from items to items

    def enter_inputs(self, octave: int, index: int) -> None:
        """Write what an octave needs of a frame. Half precision is ample for a mask in [0, 1] and for velocities."""
        group, grid = f"inputs.{octave}", self.levels[octave]
        if self.store.generation(group, index) >= 0:
            return
        frame = self.frames[index]
        mask = soft_mask(frame.density, frame.obstacle, self._recipe.mask_strength)
        arrays = {
            "density": resample_density(frame.density, 1.0, grid.shape, grid.cell_size),
            "mask": resample_mask(mask, 1.0, grid.shape, grid.cell_size).astype(np.float16),
        }
        if self.window > 1 and index + 1 < len(self.shots):
            if frame.velocity is None:
                raise InputError(f"{frame.name}: has no velocity, which a window of {self.window} frames needs")
            velocity = resample_velocity(frame.velocity, 1.0, grid.shape, grid.cell_size)
            arrays["velocity"] = velocity.astype(np.float16)
        self.store.write(group, index, 0, arrays)

    def enter_fields(self, octave: int, index: int) -> None:
        """Carry the fields of a frame over from the octave before; in the first one they are 0."""
        if self.done(octave, index) >= 0:
            return
        parameters = self.parameters(index) if octave == 0 else self.restored(octave - 1, index)
        parameters.enter(self.levels[octave])
        self.write_fields(octave, index, 0, parameters)

    def write_fields(self, octave: int, index: int, done: int, parameters: Parameterisation) -> None:
        """Write the fields of a frame after so many iterations."""
        self.store.write(f"fields.{octave}", index, done, parameters.arrays())

    def enter_gain(self, octave: int, index: int) -> None:
        """Write what makes the windowed sum of a frame an average over smoke."""
        if self.store.generation(f"gain.{octave}", index) >= 0:
            return
        group = f"inputs.{octave}"
        total = self.windowed_sums(octave, index, group, ["mask"], self._weights)["mask"]
        mask = mi.TensorXf(self.store.read(group, index, ["mask"])["mask"])
        gain = averaging_gain(mask, total, self._weights[0]).numpy().astype(np.float16)
        self.store.write(f"gain.{octave}", index, 0, {"gain": gain})

    def stepped(self, octave: int, index: int) -> int:
        """Generation of a frame's own step."""
        return self.store.generation(f"step.{octave}", index)

    def write_step(self, octave: int, index: int, done: int, step: dict[str, mi.TensorXf]) -> None:
        """Write a frame's own step, and the change that it starts from, in half precision."""
        with np.errstate(over="ignore"):
            half = {name: tensor.numpy().astype(np.float16) for name, tensor in step.items()}
        if not all(np.isfinite(array).all() for array in half.values()):
            raise InputError(
                f"{self.shots[index].name}: steps or changes of the density exceed {np.finfo(np.float16).max:g}; "
                "scale the density to about 1 and gamma accordingly"
            )
        self.store.write(f"step.{octave}", index, done, half)

    # ---------------------------------------------------------------- from items to tensors

    def parameters(self, index: int) -> Parameterisation:
        """Parameters of a frame, without fields yet."""
        if self._recipe.parameterisation == "density":
            return DensityOffset()
        least, largest = self._lams
        return Transport(self.shots[index].recipe.lam, self._recipe.steps, largest > 0, least < 1)

    @cached_property
    def _lams(self) -> tuple[float, float]:
        """The range of λ: all frames have the same fields, also where it goes from 0 to 1 over the sequence."""
        lams = [shot.recipe.lam for shot in self.shots]
        return min(lams), max(lams)

    def restored(self, octave: int, index: int) -> Parameterisation:
        """Parameters of a frame with the fields that it has in an octave."""
        parameters = self.parameters(index)
        parameters.restore(self.store.read(f"fields.{octave}", index), self.levels[octave])
        return parameters

    def current(self, octave: int, indices: Sequence[int]) -> Iterator[Current]:
        """Some frames as they stand, read ahead."""

        def read(index: int) -> tuple[int, Arrays, Arrays]:
            inputs = self.store.read(f"inputs.{octave}", index, ["density", "mask"])
            return index, inputs, self.store.read(f"fields.{octave}", index)

        for index, inputs, fields in read_ahead(partial(read, index) for index in indices):
            parameters = self.parameters(index)
            parameters.restore(fields, self.levels[octave])
            yield Current(index, mi.TensorXf(inputs["density"]), mi.TensorXf(inputs["mask"]), parameters)

    def averaged_steps(self, octave: int, index: int, names: Sequence[str]) -> dict[str, mi.TensorXf]:
        """The steps of a frame's window, transported to it (paper Eq. 8) and averaged over smoke (Eq. 9)."""
        sums = self.windowed_sums(octave, index, f"step.{octave}", names, self._weights)
        gain = mi.TensorXf(self.store.read(f"gain.{octave}", index)["gain"])
        return {name: times(gain, total) for name, total in sums.items()}

    def windowed_sums(
        self, octave: int, index: int, group: str, names: Sequence[str], weights: np.ndarray
    ) -> dict[str, mi.TensorXf]:
        """Σ_i ω_|i−t| T_i^t(f_i) of the named arrays of a group's items, with weights by distance."""
        window = window_of(index, len(self.shots), 2 * len(weights) - 1)
        # Towards a frame from its past goes u_i, back from its future what led there.
        links = [(i, i if i < index else i - 1) for i in reading_order(index, window)]

        def read(i: int, link: int) -> tuple[Arrays, np.ndarray]:
            velocity = self.store.read(f"inputs.{octave}", link, ["velocity"])["velocity"]
            return self._arrays(octave, i, group, names), velocity

        neighbours = (
            (_tensors(fields), mi.TensorXf(velocity))
            for fields, velocity in read_ahead(partial(read, *link) for link in links)
        )
        own = _tensors(self._arrays(octave, index, group, names))
        return transported_sums(own, weights, window, index, neighbours, self.levels[octave].cell_size)

    def _arrays(self, octave: int, index: int, group: str, names: Sequence[str]) -> Arrays:
        """Some arrays of an item; 0 for a frame that is left unchanged, which counts as one without smoke."""
        if not self.shots[index].still:
            return self.store.read(group, index, names)
        shape, channels = self.levels[octave].shape, self.parameters(index).channels
        return {name: np.zeros((*shape, 3) if channels.get(name) == 3 else shape, np.float32) for name in names}

    # ---------------------------------------------------------------- the log

    def history(self, name: str) -> list[dict]:
        """The log of a frame; what a killed run had logged and then did again counts once."""
        entries = {(e["octave"], e["iteration"]): e for e in self.store.entries() if e["frame"] == name}
        return [{key: value for key, value in entries[at].items() if key != "frame"} for at in sorted(entries)]


def _tensors(arrays: Arrays) -> dict[str, mi.TensorXf]:
    return {name: mi.TensorXf(array) for name, array in arrays.items()}
