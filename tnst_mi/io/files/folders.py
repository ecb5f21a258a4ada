"""Folders that programs make: where in them the frames are.

| folder | its frames are in |
|---|---|
| of the paper's authors | `d/`, the velocities in `v/` |
| of a run of ours | `density/` |
| cache of Blender | `noise/` where that has any, else `data/` |
| of PhiFlow, with one simulation in it | `sim_000000/` |
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.machine.terminal import some_of


@dataclass(frozen=True)
class FrameFolder:
    """The folder with the densities of a sequence.

    Attributes:
        path: the folder.
        velocities: in the layout of the paper's authors, that of the velocities.
        notes: what was decided, to be said.
    """

    path: Path
    velocities: Path | None = None
    notes: tuple[str, ...] = ()


def frame_folder(path: Path, suffixes: Sequence[str]) -> FrameFolder:
    """Find the folder that is meant: the given one if it has files with the extensions of frames, or one below it.

    Raises:
        InputError: there are no frames, or several folders with frames; the message names those that may be meant.
    """
    if (path / "d").is_dir():
        return FrameFolder(path / "d", path / "v")
    if frame_files(path, suffixes):
        return FrameFolder(path)
    below = {folder.name: folder for folder in sorted(path.iterdir()) if folder.is_dir()}
    with_frames = {name: folder for name, folder in below.items() if frame_files(folder, suffixes)}
    if _is_run(path) and "density" in below:
        if "density" not in with_frames:
            raise InputError(f"{path}: is the folder of a run that has not finished a frame, so its density/ is empty")
        return _led_to(with_frames["density"], path, "the folder of a run")
    if "noise" in with_frames and "data" in below:
        return _led_to(with_frames["noise"], path, "the folder of a cache with noise, whose velocities are in data/")
    if "data" in with_frames:
        return _led_to(with_frames["data"], path, "the folder of a cache")
    scenes = [folder for name, folder in with_frames.items() if re.fullmatch(r"sim_\d+", name)]
    if len(scenes) == 1:
        return _led_to(scenes[0], path, "the folder of one simulation")
    expected = f"expected files {', '.join(suffixes)}"
    raise InputError(f"{path}: no frames in this folder, {expected}{_meant(path, with_frames)}")


def densities_of_run(velocity: Path) -> Path | None:
    """The folder with the densities of the run that has written a file, if that holds its velocity v*; else None."""
    folder = velocity.absolute().parent
    return folder.parent / "density" if folder.name == "velocity" and _is_run(folder.parent) else None


def frame_files(folder: Path, suffixes: Sequence[str]) -> list[Path]:
    """The visible files of a folder with some extensions, sorted; hidden ones are not ours, or left unfinished."""
    visible = (file for file in folder.iterdir() if not file.name.startswith("."))
    return sorted(file for file in visible if file.suffix.lower() in suffixes and file.is_file())


def _led_to(folder: Path, given: Path, what: str) -> FrameFolder:
    return FrameFolder(folder, notes=(f"{given}: is {what}; the frames are read from {folder}",))


def _is_run(path: Path) -> bool:
    return (path / "run.json").is_file() and (path / "recipe.toml").is_file()


def _meant(path: Path, with_frames: dict[str, Path]) -> str:
    """The folders nearby that may be meant, as the end of a message."""
    if _is_run(path.resolve().parent):
        return f"; it belongs to a run, whose frames are in {path.parent / 'density'}"
    return f"; those below it that have some are {some_of(list(with_frames))}: give one" if with_frames else ""
