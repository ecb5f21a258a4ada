"""A frame's own step, and the numbers that it yields, on their way to the host."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
import torch

from tnst_mi.errors import InputError
from tnst_mi.machine.host_copy import HostCopy
from tnst_mi.optimisation.parameterisation import Fields
from tnst_mi.optimisation.plan import FramePlan


@dataclass(frozen=True)
class OwnStep:
    """A frame's own step, computed from its own gradient.

    Attributes:
        step: what to subtract from the fields; or, if `raw`, the gradient of the loss, of which no step has been made.
        change: d* − d, (D, H, W), of the fields that it starts from; None if nothing uses it.
        loss, terms: of the same fields, numbers on the device.
        since: when its computation began, on the clock of `time.perf_counter`.
        raw: see `step`.
    """

    step: Fields
    change: mi.TensorXf | None
    loss: torch.Tensor
    terms: Mapping[str, torch.Tensor]
    since: float
    raw: bool = False


@dataclass(frozen=True)
class Outcome:
    """What an own step has shown: the loss and its terms, and the time that it took."""

    frame: FramePlan
    iteration: int
    loss: float
    terms: dict[str, float]
    seconds: float


class Launched:
    """An own step whose numbers are being copied to the host.

    Args:
        frame: the plan of the frame.
        iteration: of the octave.
        found: the step.
        stored: whether it is to be stored: steps and changes in half precision, gradients, which have any magnitude,
            in single precision.

    Attributes:
        frame, iteration: as given.
        arrays: what is to be stored.
    """

    def __init__(self, frame: FramePlan, iteration: int, found: OwnStep, stored: bool) -> None:
        self.frame, self.iteration = frame, iteration
        # Not the step itself, whose memory is needed.
        self._terms, self._since, self._raw = list(found.terms), found.since, found.raw
        self.arrays: dict[str, mi.TensorXf | mi.TensorXf16] = {}
        numbers = [found.loss, *found.terms.values()]
        if stored:
            self.arrays = {name: step if found.raw else mi.TensorXf16(step) for name, step in found.step.items()}
            if found.change is not None:
                self.arrays["change"] = mi.TensorXf16(found.change)
            exceeding = sum(dr.count(~dr.isfinite(array.array)) for array in self.arrays.values())
            dr.eval(self.arrays, exceeding)
            numbers.append(mi.Float(exceeding).torch()[0])
        self._numbers = HostCopy(torch.stack(numbers))

    @property
    def ready(self) -> bool:
        """Whether the outcome is known without waiting."""
        return self._numbers.ready

    def outcome(self, octave: int, earliest: float) -> Outcome:
        """The outcome, once the device has computed it.

        Args:
            octave: number of the octave, from 0.
            earliest: when the previous step was done; time before that is not this one's.

        Raises:
            InputError: the loss is not finite, or the step exceeds the range of the precision in which it is stored.
        """
        frame = self.frame
        loss, *others = self._numbers.numpy().tolist()
        if not math.isfinite(loss):
            raise InputError(
                f"{frame.name}, iteration {self.iteration + 1} of octave {octave + 1}: the loss is {loss}, expected a "
                f"finite number; try a smaller eta ({frame.recipe.eta:g}) or gamma"
            )
        if any(others[len(self._terms) :]):
            found = "a gradient is not finite, or changes" if self._raw else "steps or changes"
            raise InputError(
                f"{frame.name}: {found} of the density exceed {np.finfo(np.float16).max:g}; "
                'take density_scale = "auto" or a smaller eta'
            )
        terms = dict(zip(self._terms, others, strict=False))
        return Outcome(frame, self.iteration, loss, terms, time.perf_counter() - max(self._since, earliest))
