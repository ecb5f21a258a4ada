"""Flicker: how far the change made by a stylization fails to follow the smoke from one frame to the next.

    flicker_t = ‖SL(d*_t − d_t, u_t) − (d*_{t+1} − d_{t+1})‖₂ / ‖d*_{t+1} − d_{t+1}‖₂

SL is one semi-Lagrangian step, clamped at the edge. 0 means that the change moves with the smoke; about √2 means that
the changes of the two frames, if of equal size, are unrelated; if the first is r times as large, that is √(1 + r²). The
size of the changes does not enter otherwise: the value says little without it (`relative_change`) and without the
reduction of the loss.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tnst_mi.fields.advection import advect


def flicker(change: np.ndarray, next_change: np.ndarray, velocity: np.ndarray) -> float | None:
    """Flicker of a pair of frames.

    Args:
        change: d* − d of a frame, (D, H, W); or of something of several components, (D, H, W, C), all of which count.
        next_change: the same of the next frame.
        velocity: the first frame's simulation velocity, (D, H, W, 3) in cells per frame.

    Returns:
        The flicker, ≥ 0; None if the next frame is unchanged.

    Raises:
        InputError: the velocity and the change are on different grids.
    """
    channels = [change] if change.ndim == 3 else list(np.ascontiguousarray(np.moveaxis(change, -1, 0)))
    each = [advect(one, velocity, method="semi_lagrangian", outside="edge") for one in channels]
    carried = each[0] if change.ndim == 3 else np.stack(each, axis=-1)
    return _ratio(_norm(carried - next_change), _norm(next_change))


def relative_change(before: np.ndarray, after: np.ndarray) -> float | None:
    """Size of a change, ‖d* − d‖₂ / ‖d‖₂, of two densities (D, H, W); None if the first is empty."""
    return _ratio(_norm(after - before), _norm(before))


class FlickerMeter:
    """Flicker of a sequence whose frames are added in order; only the last frame is kept.

    Attributes:
        pairs: one dict {"from": name, "to": name, "flicker": number or None} for each pair of adjacent frames
            of which the first has a velocity.
    """

    def __init__(self) -> None:
        self.pairs: list[dict[str, Any]] = []
        self._last: tuple[str, np.ndarray, np.ndarray | None] | None = None

    def add(self, name: str, before: np.ndarray, after: np.ndarray, velocity: np.ndarray | None) -> None:
        """Add the next frame.

        Args:
            name: its name in `pairs`.
            before: d, (D, H, W), or (D, H, W, C).
            after: d*, likewise.
            velocity: the simulation velocity, (D, H, W, 3) in cells per frame; without one, this frame and the
                next form no pair.

        Raises:
            InputError: the previous frame and its velocity are on different grids.
        """
        change = after - before
        if self._last is not None:
            last_name, last_change, last_velocity = self._last
            if last_velocity is not None:
                figure = flicker(last_change, change, last_velocity)
                self.pairs.append({"from": last_name, "to": name, "flicker": figure})
        self._last = (name, change, velocity)

    @property
    def mean(self) -> float | None:
        """Mean over the pairs that have a value; None if none has."""
        figures = [pair["flicker"] for pair in self.pairs if pair["flicker"] is not None]
        return sum(figures) / len(figures) if figures else None


def _norm(field: np.ndarray) -> float:
    """‖field‖₂, summed in float64."""
    return float(np.sqrt(np.square(field, dtype=np.float64).sum()))


def _ratio(part: float, whole: float) -> float | None:
    return part / whole if whole > 0.0 else None
