"""Masks that move with the smoke: the mask of one frame, transported by the velocities of the simulation."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.advection import step
from tnst_mi.frame import Frame

#: What is less than this counts as 0: interpolation spreads a mask by a cell per frame, ever more thinly.
_LEAST = 1 / 256


class FollowingMask:
    """A mask that is carried along from frame to frame, as the smoke is: forwards by u, backwards by −u.

    Frames may be asked for in any order; each next one, in either direction, takes a single step.

    Args:
        start: the mask (D, H, W) of the frame that it starts from.
        first: the place of that frame in the sequence.
        frames: the sequence, whose velocities lead from each frame to the next.
    """

    def __init__(self, start: np.ndarray, first: int, frames: Sequence[Frame]) -> None:
        self._first, self._frames = first, frames
        self._start = mi.TensorXf(start)
        #: The last frame that was asked for, and its mask.
        self._place, self._field = first, self._start

    def at(self, index: int) -> np.ndarray:
        """The mask (D, H, W) of a frame.

        Raises:
            InputError: a frame on the way has no velocity.
        """
        beyond = self._place > index > self._first or self._place < index < self._first
        if beyond or (index - self._first) * (self._place - self._first) < 0 or index == self._first:
            self._place, self._field = self._first, self._start
        forwards = index > self._place
        while self._place != index:
            # u of a frame leads to the next one.
            frame = self._frames[self._place if forwards else self._place - 1]
            if frame.velocity is None:
                raise InputError(f"{frame.name}: has no velocity, which a mask that follows the smoke needs")
            displacement = mi.TensorXf(frame.velocity if forwards else -frame.velocity)
            self._field = step(self._field, displacement, "maccormack", 1.0, "zero")
            self._place += 1 if forwards else -1
        mask = self._field.numpy()
        return mask if index == self._first else np.where(mask < _LEAST, np.float32(0), mask)
