"""Reading the cameras of a shot: FILE, or FILE#NAME for one of several in it."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from tnst_mi.errors import InputError
from tnst_mi.io.cameras.scene_camera import SceneCamera
from tnst_mi.io.cameras.tables import read_tables
from tnst_mi.io.cameras.usd import read_stage
from tnst_mi.machine.gate import opening

_TABLES, _STAGES = (".toml", ".json"), (".usd", ".usda", ".usdc", ".usdz")

#: What other programs' files are to be turned into, by extension.
_ELSEWHERE = {
    ".abc": "export the camera as USD",
    ".fbx": "export the camera as USD",
    ".hip": "export the camera as USD",
    ".blend": "scripts/export_camera.py exports its camera",
}


class Cameras(Protocol):
    """The cameras of a shot."""

    def at(self, number: int | float | None, up: str) -> SceneCamera:
        """The camera of a frame by its number, None if it has none, in a scene with `up`, "y" or "z", upwards.

        Raises:
            InputError: the frame has no camera.
        """
        ...


def file_and_name(text: str) -> tuple[Path, str | None]:
    """The file of cameras that a text means, and the name of one of them; None if it names none.

    What exists is a file, also if it has # in its name.
    """
    file, mark, name = text.rpartition("#")
    return (Path(text), None) if not mark or not name or not file or Path(text).exists() else (Path(file), name)


def read_cameras(text: str) -> Cameras:
    """Read a file of cameras, given as FILE or FILE#NAME.

    Raises:
        InputError: it cannot be read or has no such camera, or its format needs a library that is not installed.
    """
    path, name = file_and_name(text)
    suffix = path.suffix.lower()
    if suffix in _STAGES:
        with opening(path, "a stage of USD"):
            return read_stage(path, name)
    if suffix not in _TABLES:
        remedy = f"; {_ELSEWHERE[suffix]}" if suffix in _ELSEWHERE else ""
        raise InputError(f"{path}: expected a file of cameras, {', '.join((*_TABLES, *_STAGES))}{remedy}")
    if name is not None:
        raise InputError(f"{text}: cameras of {suffix} files have no names; leave out #{name}")
    with opening(path, "a file of cameras"):
        return read_tables(path)
