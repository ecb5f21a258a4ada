"""The frames that have been found, with their velocities: what others read there, and the next frame starts from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.fields.advection import advect
from tnst_mi.frame import Frame
from tnst_mi.io.formats import write_frame
from tnst_mi.io.sequence import open_frames
from tnst_mi.reconstruction.preparation import Preparation

#: Densities above this part of the largest count as smoke.
_SMOKE = 0.05


class FoundFrames:
    """The files of the frames that are done.

    Args:
        prepared: what is reconstructed.
        out: folder of the results.
    """

    def __init__(self, prepared: Preparation, out: Path) -> None:
        self._prepared, self._out = prepared, out

    def extinction(self, record: Mapping[str, Any]) -> np.ndarray:
        """That of a frame, (D, H, W) float32 per cell."""
        return self._frame(record).density * np.float32(record["gamma"])

    def velocity(self, record: Mapping[str, Any]) -> np.ndarray | None:
        """That from a frame to the next, (D, H, W, 3) in cells per frame; None if it has none."""
        return self._frame(record).velocity

    def moved(self, record: Mapping[str, Any]) -> np.ndarray:
        """The extinction of a frame, moved by its velocity if it has one: where the next frame starts."""
        extinction, velocity = self.extinction(record), self.velocity(record)
        return extinction if velocity is None else advect(extinction, velocity, trace="flow")

    def add_velocity(self, record: Mapping[str, Any], velocity: np.ndarray) -> dict[str, float]:
        """Write a velocity (D, H, W, 3) into the file of a frame, and give what is to be said of it.

        Raises:
            OSError: it cannot be written.
        """
        frame, place = self._frame(record), self._prepared.place.placement
        write_frame(self._out / record["density"], frame.density, velocity, placement=place, others=frame.other_grids)
        speed, smoke = np.linalg.norm(velocity, axis=-1), frame.density > _SMOKE * frame.density.max()
        return {"largest": float(speed.max()), "mean_in_smoke": float(speed[smoke].mean()) if smoke.any() else 0.0}

    def _frame(self, record: Mapping[str, Any]) -> Frame:
        return open_frames(self._out / record["density"])[0]
