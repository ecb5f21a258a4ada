"""Flicker: how badly the change that a stylization makes follows the smoke from one frame to the next.

    flicker_t = ‖SL(d*_t − d_t, u_t) − (d*_{t+1} − d_{t+1})‖₂ / ‖d*_{t+1} − d_{t+1}‖₂

SL is one semi-Lagrangian step, clamped at the edge. 0 means that the change moves with the smoke, about √2 that the
changes of the two frames, if of one size, have nothing to do with each other. How large they are does not enter: the
figure says little without that (`relative_change`) and the loss that was gained.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tnst_mi.fields.advection import advect


def flicker(change: np.ndarray, next_change: np.ndarray, velocity: np.ndarray) -> float | None:
    """Flicker of a pair of frames.

    Args:
        change: d* − d of a frame, (D, H, W).
        next_change: the same of the next frame.
        velocity: the first frame's simulation velocity, (D, H, W, 3) in cells per frame.

    Returns:
        The figure, ≥ 0; None where the next frame is not changed.

    Raises:
        InputError: the velocity is of another grid than the change.
    """
    carried = advect(change, velocity, method="semi_lagrangian", outside="edge")
    return _ratio(_norm(carried - next_change), _norm(next_change))


def relative_change(before: np.ndarray, after: np.ndarray) -> float | None:
    """Size of a change, ‖d* − d‖₂ / ‖d‖₂, of two densities (D, H, W); None where the first is empty."""
    return _ratio(_norm(after - before), _norm(before))


class FlickerMeter:
    """Flicker of a sequence whose frames are added in order; only the last frame is kept.

    Attributes:
        pairs: one dict {"from": name, "to": name, "flicker": number or None} for each pair of adjacent frames, as far
            as the first of them has a velocity.
    """

    def __init__(self) -> None:
        self.pairs: list[dict[str, Any]] = []
        self._last: tuple[str, np.ndarray, np.ndarray | None] | None = None

    def add(self, name: str, before: np.ndarray, after: np.ndarray, velocity: np.ndarray | None) -> None:
        """Take the next frame.

        Args:
            name: what `pairs` calls it.
            before: d, (D, H, W).
            after: d*, likewise.
            velocity: the simulation velocity, (D, H, W, 3) in cells per frame; without one there is no pair of this
                frame with the next.

        Raises:
            InputError: the frame before was of another grid than its velocity.
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
        """Mean over the pairs that have a figure; None where none has."""
        figures = [pair["flicker"] for pair in self.pairs if pair["flicker"] is not None]
        return sum(figures) / len(figures) if figures else None


def _norm(field: np.ndarray) -> float:
    """‖field‖₂, summed in float64."""
    return float(np.sqrt(np.square(field, dtype=np.float64).sum()))


def _ratio(part: float, whole: float) -> float | None:
    return part / whole if whole > 0.0 else None
