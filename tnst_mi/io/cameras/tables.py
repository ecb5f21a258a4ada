"""Cameras in our own files, TOML or JSON: a table of keys for all frames, or one for each frame (docs/cameras.md)."""

from __future__ import annotations

import bisect
import difflib
import json
import math
import re
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.errors import InputError, naming
from tnst_mi.io.bounded_toml import toml_values
from tnst_mi.io.cameras.scene_camera import SceneCamera, looking, rigid

#: Longest files in bytes: Python's reader of TOML takes seconds for a megabyte, that of JSON takes none.
_LONGEST = {".toml": 1 << 20, ".json": 1 << 25}

#: How cameras stand, what their lenses show, and what else their tables have.
_POSES = ("matrix", "position", "target", "up")
_LENSES = ("fov", "focal_length", "sensor_height", "sensor_width", "height")
_OTHERS = ("aspect", "resolution", "shift")
KEYS = (*_POSES, *_LENSES, *_OTHERS)

#: What a file has beside cameras.
_OF_THE_FILE = ("up_axis", "frames")

#: Largest number in a table: beyond any scene, and far from overflow.
_LARGEST = 1e12

_FRAME = re.compile(r"-?\d{1,9}(\.\d{1,6})?")

#: Up in a scene, by the axis that is.
_UP = {"y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class TableCameras:
    """The cameras of a file.

    Attributes:
        name: of the file, for messages.
        up_axis: which axis of its scene is up, "y" or "z"; None for that of the smoke's files.
        by_frame: the table of each frame by its number, in order; empty if there is one camera for all.
        always: the table of the camera for all frames.
    """

    name: str
    up_axis: str | None
    by_frame: Mapping[int | float, Mapping[str, Any]]
    always: Mapping[str, Any]

    def at(self, number: int | float | None, up: str) -> SceneCamera:
        """The camera of a frame, in a scene with `up`, "y" or "z", upwards.

        Raises:
            InputError: the frame has none.
        """
        if not self.by_frame:
            with naming(Path(self.name)):
                return self._camera(self.always, up)
        if number is None:
            raise InputError(f"{self.name}: its cameras are of numbered frames, and the smoke's have no numbers")
        if number not in self.by_frame:
            raise InputError(f"{self.name}: has no camera for frame {number}; {nearest(list(self.by_frame), number)}")
        with naming(Path(f"{self.name}: frame {number}")):
            return self._camera(self.by_frame[number], up)

    def check(self) -> None:
        """Check all tables, but for what depends on the axis that is up.

        Raises:
            InputError: a table is none of a camera.
        """
        for number in self.by_frame or (None,):
            try:
                self.at(number, self.up_axis or "y")
            except InputError:
                # A camera that looks along one axis is fine where the other is up.
                if self.up_axis is not None:
                    raise
                self.at(number, "z")

    def _camera(self, table: Mapping[str, Any], up: str) -> SceneCamera:
        own_up = self.up_axis or up
        return camera_of(table, own_up).turned(own_up, up)


def read_tables(path: Path) -> TableCameras:
    """Read a file of cameras; everything in it is checked.

    Raises:
        InputError: it is too large or deep, or holds something else.
        ValueError: it is neither TOML nor JSON, whichever its extension says.
        OSError: it cannot be read.
    """
    longest = _LONGEST[path.suffix.lower()]
    if (size := path.stat().st_size) > longest:
        raise InputError(f"{path}: {size} bytes, expected a file of cameras of at most {longest}")
    text = path.read_bytes().decode("utf-8-sig")
    with naming(path):
        values = toml_values(text.replace("\r\n", "\n")) if path.suffix.lower() == ".toml" else json.loads(text)
        cameras = _cameras(str(path), values)
    cameras.check()
    return cameras


def nearest(numbers: list[int | float], number: int | float) -> str:
    """Which of the numbers, in rising order, are nearest to one that is not there, in words.

    Example:
        >>> nearest([49, 72], 57), nearest([49, 72], 80)
        ('the nearest are 49 and 72', 'the nearest is 72')
    """
    place = bisect.bisect(numbers, number)
    around = numbers[max(place - 1, 0) : place + 1]
    return f"the nearest {'is' if len(around) == 1 else 'are'} {' and '.join(map(str, around))}"


def camera_of(table: Mapping[str, Any], up: str) -> SceneCamera:
    """The camera of a table, in a scene with `up`, "y" or "z", upwards.

    Raises:
        InputError: a key is missing, unknown or contradicts another, or its value is none.
    """
    if unknown := [key for key in table if key not in KEYS]:
        near = difflib.get_close_matches(unknown[0], (*KEYS, *_OF_THE_FILE), 1, 0.7)
        remedy = f"did you mean {near[0]!r}?" if near else f"the keys of a camera are {', '.join(KEYS)}"
        raise InputError(
            f"unknown key {reprlib.repr(unknown[0])}; {remedy} (beside these, a file has {' and '.join(_OF_THE_FILE)})"
        )
    aspect = _aspect(table)
    perspective, field = _lens(table, aspect)
    x, y = _numbers("shift", table.get("shift", [0, 0]), 2)
    return SceneCamera(_pose(table, up), perspective, field, aspect, (float(x), float(y)))


def _cameras(name: str, values: Any) -> TableCameras:
    shared = dict(_table("the file", values))
    up_axis, frames = shared.pop("up_axis", None), shared.pop("frames", None)
    if up_axis not in (None, "y", "z"):
        raise InputError(f'up_axis = {reprlib.repr(up_axis)}: expected "y" or "z"')
    if frames is None:
        return TableCameras(name, up_axis, {}, shared)
    by_frame = {}
    for key, table in _table("frames", frames).items():
        if not _FRAME.fullmatch(key):
            raise InputError(f"frames: {reprlib.repr(key)} is no number of a frame, such as 49")
        number = float(key) if "." in key else int(key)
        if number in by_frame:
            raise InputError(f"frames: frame {number} is there twice")
        by_frame[number] = shared | _table(f"frame {number}", table)
    if not by_frame:
        raise InputError("frames: is empty, expected a table for each frame")
    return TableCameras(name, up_axis, dict(sorted(by_frame.items())), {})


def _table(what: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(f"{what}: is {reprlib.repr(value)}, expected a table of keys")
    return value


def _pose(table: Mapping[str, Any], up: str) -> np.ndarray:
    given = [key for key in _POSES if key in table]
    if given == ["matrix"]:
        rows = table["matrix"]
        if not isinstance(rows, list) or len(rows) != 4:
            raise InputError(f"matrix = {reprlib.repr(rows)}: expected 4 rows of 4 numbers")
        return rigid(np.array([_numbers("matrix: a row", row, 4) for row in rows]))
    if "matrix" in given or not {"position", "target"} <= set(given):
        found = " and ".join(given) or "none of these"
        raise InputError(f"has {found}, expected matrix, or position and target (and up)")
    position, target = (_numbers(key, table[key], 3) for key in ("position", "target"))
    return looking(position, target, _numbers("up", table.get("up", list(_UP[up])), 3))


def _aspect(table: Mapping[str, Any]) -> float:
    if ("aspect" in table) == ("resolution" in table):
        raise InputError("expected either aspect, the width of the picture over its height, or resolution, both")
    if "aspect" in table:
        return _number("aspect", table["aspect"], 0.01, 100.0)
    width, height = _numbers("resolution", table["resolution"], 2)
    if not (width >= 1 and height >= 1):
        raise InputError(f"resolution = {reprlib.repr(table['resolution'])}: expected two numbers of 1 or more")
    return _number("resolution: width over height", float(width / height), 0.01, 100.0)


def _lens(table: Mapping[str, Any], aspect: float) -> tuple[bool, float]:
    """Whether it is a perspective camera, and its field."""
    given = [key for key in _LENSES if key in table]
    if given == ["fov"]:
        return True, _number("fov", table["fov"], 0.01, 179.0)
    if given == ["height"]:
        return False, _number("height", table["height"], 1e-9, 1e9)
    if given not in (["focal_length", "sensor_height"], ["focal_length", "sensor_width"]):
        found = " and ".join(given) or "none of these"
        raise InputError(f"has {found}, expected fov, or focal_length and sensor_height or sensor_width, or height")
    focal, sensor = (_number(key, table[key], 1e-6, 1e6) for key in given)
    high = sensor if given[1] == "sensor_height" else sensor / aspect
    return True, math.degrees(2 * math.atan(high / (2 * focal)))


def _number(key: str, value: Any, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise InputError(f"{key} = {reprlib.repr(value)}: expected a number from {low:g} to {high:g}")
    return float(value)


def _numbers(key: str, value: Any, count: int) -> np.ndarray:
    """Checked numbers (count), float64."""
    if not isinstance(value, list) or len(value) != count:
        raise InputError(f"{key} = {reprlib.repr(value)}: expected {count} numbers")
    return np.array([_number(key, number, -_LARGEST, _LARGEST) for number in value])
