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
    """A mask that is carried along from frame to frame, as the smoke is: forwards in time by u, backwards by −u.

    Frames may be asked for in any order; each next one, in either direction, takes a single step. Frames need neither
    ascend nor be equally far apart: u is in cells per frame, and a step takes it times the difference of their numbers.

    Args:
        start: the mask (D, H, W) of the frame that it starts from.
        first: the place of that frame in the sequence.
        frames: the sequence, with velocities in cells per frame.
        numbers: of the frames; those without one are one apart.
    """

    def __init__(
        self, start: np.ndarray, first: int, frames: Sequence[Frame], numbers: Sequence[int | float | None]
    ) -> None:
        self._first, self._frames, self._numbers = first, frames, numbers
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
        towards = 1 if index > self._place else -1
        while self._place != index:
            displacement = mi.TensorXf(self._displacement(self._place, self._place + towards))
            self._field = step(self._field, displacement, "maccormack", 1.0, "zero")
            self._place += towards
        mask = self._field.numpy()
        return mask if index == self._first else np.where(mask < _LEAST, np.float32(0), mask)

    def _displacement(self, place: int, following: int) -> np.ndarray:
        """(D, H, W, 3), in cells, from a frame to one beside it in the sequence."""
        number, other = self._numbers[place], self._numbers[following]
        frames_between = following - place if number is None or other is None else other - number
        # u of a frame leads from it to later ones, so that of the earlier of both counts, in time.
        frame = self._frames[place if frames_between >= 0 else following]
        if frame.velocity is None:
            raise InputError(f"{frame.name}: has no velocity, which a mask that follows the smoke needs")
        return frame.velocity * np.float32(frames_between)
