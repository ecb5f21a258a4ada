"""What a tab of the page wants to see: of which frame, how, from where, and how large."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tnst_mi.choices import LOOKS
from tnst_mi.errors import InputError
from tnst_mi.machine.terminal import one_line
from tnst_mi.rendering.cameras.camera import Camera
from tnst_mi.rendering.cameras.views import camera_frame
from tnst_mi.studio.view.opened import AFTER, BEFORE

#: What is shown: one side of a frame, how they differ, or v* in colours, in the picture or towards the eye.
MODES = (BEFORE, AFTER, "difference", "movement", "depth")

#: As the network sees the smoke, or as thick as in one of the looks.
AS_SEEN = "network"

#: Vertical field of view of the perspective camera, in degrees.
FIELD = 30.0

#: Edges of pictures in pixels.
_SMALLEST, _LARGEST = 8, 2160

#: Distance of the orthographic camera, in cells.
_BEFORE_ALL = 2048.0

#: Index of a target, at most.
_MOST_TARGETS = 999

#: Heights of pictures in cells.
_NEAREST, _FARTHEST = 1.0, 1e5


@dataclass(frozen=True)
class Sight:
    """A picture that is asked for.

    Attributes:
        frame: index in what is opened.
        mode: one of `MODES`.
        look: `AS_SEEN` or one of `tnst_mi.choices.LOOKS`.
        lit: rendered in the studio of the look, rather than by emission and absorption.
        azimuth, elevation: of the camera around the grid's centre, in degrees.
        height: of the picture, in cells; in perspective of what is at the distance of the centre.
        pan: by how much the camera is moved to its right and upwards, in cells.
        perspective: whether it is a pinhole camera rather than the network's parallel one.
        rows, columns: of the picture, in pixels.
        coloured: in the colours that the smoke has, rather than in grey.
        coarse: of a coarser grid if this one is large, since it is seen only in passing.
        mask: index of the target whose mask colours the smoke, or None.
        cut: None, or the axis "x", "y" or "z" across which the grid is cut, and where, from 0 to 1.
    """

    frame: int = 0
    mode: str = AFTER
    look: str = AS_SEEN
    lit: bool = False
    azimuth: float = 0.0
    elevation: float = 0.0
    height: float = 100.0
    pan: tuple[float, float] = (0.0, 0.0)
    perspective: bool = False
    rows: int = 96
    columns: int = 96
    coloured: bool = True
    coarse: bool = False
    mask: int | None = None
    cut: tuple[str, float] | None = None

    @classmethod
    def of_query(cls, query: Mapping[str, str], frames: int) -> Sight:
        """The sight that the query of a URL describes.

        Args:
            query: texts by name.
            frames: number of frames that are opened.

        Raises:
            InputError: a value is not as it should be.
        """
        masked = query.get("mask", "none") != "none"
        axis = _word(query, "cut", "none", ("none", "x", "y", "z"))
        return cls(
            frame=int(_number(query, "frame", 0, 0, frames - 1, whole=True)),
            mode=_word(query, "mode", AFTER, MODES),
            look=_word(query, "look", AS_SEEN, (AS_SEEN, *LOOKS)),
            lit=_word(query, "lit", "0", ("0", "1")) == "1",
            azimuth=_number(query, "azimuth", 0, -1e6, 1e6) % 360.0,
            elevation=_number(query, "elevation", 0, -90, 90),
            height=_number(query, "height", 100, _NEAREST, _FARTHEST),
            pan=(_number(query, "right", 0, -_FARTHEST, _FARTHEST), _number(query, "up", 0, -_FARTHEST, _FARTHEST)),
            perspective=_word(query, "perspective", "0", ("0", "1")) == "1",
            rows=int(_number(query, "rows", 96, _SMALLEST, _LARGEST, whole=True)),
            columns=int(_number(query, "columns", 96, _SMALLEST, _LARGEST, whole=True)),
            coloured=_word(query, "coloured", "1", ("0", "1")) == "1",
            coarse=_word(query, "coarse", "0", ("0", "1")) == "1",
            mask=int(_number(query, "mask", 0, 0, _MOST_TARGETS, whole=True)) if masked else None,
            cut=None if axis == "none" else (axis, _number(query, "at", 0.5, 0, 1)),
        )

    @property
    def camera(self) -> Camera:
        """The camera, in full-resolution cells around the grid's centre."""
        right, up, towards = camera_frame(self.azimuth, self.elevation)
        # Parallel rays start before all smoke, and above the ground of the studio.
        slope = math.tan(math.radians(FIELD) / 2)
        distance = self.height / 2 / slope if self.perspective else max(_BEFORE_ALL, 4 * self.height)
        to_world = np.eye(4)
        to_world[:3, :3] = np.stack([right, up, towards], axis=1)
        to_world[:3, 3] = distance * towards + self.pan[0] * right + self.pan[1] * up
        field = FIELD if self.perspective else self.height
        return Camera(to_world, self.perspective, field, self.columns / self.rows)


def _number(query: Mapping[str, str], name: str, default: float, low: float, high: float, whole: bool = False) -> float:
    text = query.get(name)
    if text is None:
        return default
    try:
        value = float(int(text) if whole else text)
    except (ValueError, OverflowError):
        value = math.nan
    if not low <= value <= high:
        kind = "a whole number" if whole else "a number"
        raise InputError(one_line(f"view: {name} = {text!r}: expected {kind} from {low:g} to {high:g}"))
    return value


def _word(query: Mapping[str, str], name: str, default: str, words: tuple[str, ...]) -> str:
    text = query.get(name, default)
    if text not in words:
        raise InputError(one_line(f"view: {name} = {text!r}: expected one of {', '.join(words)}"))
    return text
