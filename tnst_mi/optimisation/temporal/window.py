"""The window of frames around a frame, and the weight of each in it (the ω of paper Eq. 9)."""

from __future__ import annotations

import numpy as np


def window_weights(window: int, kind: str = "uniform") -> np.ndarray:
    """Weights ω by the distance |i − t| from 0 to (window − 1)/2; those of a whole window sum to 1.

    Args:
        window: odd number of frames, 2w + 1.
        kind: "uniform", as in the paper's code; "triangle", falling to 0 at the first frame outside; or "gaussian"
            with a standard deviation of w/4.
    """
    reach = window // 2
    distance = np.arange(reach + 1)
    weights = {
        "uniform": np.ones(reach + 1),
        "triangle": 1 - distance / (reach + 1),
        "gaussian": np.exp(-0.5 * (4 * distance / max(reach, 1)) ** 2),
    }[kind]
    return weights / (weights[0] + 2 * weights[1:].sum())


def window_of(frame: int, count: int, window: int) -> range:
    """The frames of the window around one of `count` frames; truncated at both ends of the sequence."""
    reach = window // 2
    return range(max(0, frame - reach), min(count, frame + reach + 1))


def reading_order(frame: int, window: range) -> list[int]:
    """The neighbours of a frame in the order in which `transported_sums` consumes their fields."""
    return [*range(window.start, frame), *range(window.stop - 1, frame, -1)]
