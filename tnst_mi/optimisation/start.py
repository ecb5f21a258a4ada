"""Where the fields of a run begin: at 0 in the first octave, or where an earlier run of the same recipe has got to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class State:
    """How far a frame has got.

    Attributes:
        octave: which one, from 0.
        iterations: done in it.
        fields: what is optimised, on the grid of the octave, by name.
        scales: of the terms of the loss in the octave, by name; empty if it has not been begun.
    """

    octave: int
    iterations: int
    fields: Mapping[str, np.ndarray]
    scales: Mapping[str, float]


@dataclass(frozen=True)
class Start:
    """The states of an earlier run, from which the frames of another one begin: all of them in the same octave.

    Attributes:
        octave: which one, from 0.
        iterations: by the name of each frame, those done in the octave.
        scales: of the terms of the loss in the octave, by name; empty if it has not been begun.
        fields: reads what is optimised of the frame of a name.
    """

    octave: int
    iterations: Mapping[str, int]
    scales: Mapping[str, float]
    fields: Callable[[str], Mapping[str, np.ndarray]]
