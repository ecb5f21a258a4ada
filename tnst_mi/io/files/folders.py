"""Folders that programs make: where in them the frames are.

| folder | its frames are in |
|---|---|
| of the paper's authors | `d/`, the velocities in `v/` |
| of a run of ours | `density/` |
| cache of Blender | `noise/` where that has any, else `data/` |
| of PhiFlow, with one simulation in it | `sim_000000/` |
"""

from __future__ import annotations

import itertools
import os
import re
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.machine.terminal import some_of

#: How far below a folder without frames those are looked for that may be meant: a batch's runs are that deep in the
#: results of an artist's object (markers_final/01_close/smoke).
_LEVELS = 3

#: How many folders are looked into for that at most.
_VISITED = 500


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
    if os.path.isdir(path / "d"):
        return FrameFolder(path / "d", path / "v")
    if frame_files(path, suffixes):
        return FrameFolder(path)
    below = {folder.name: folder for folder in _listed(path) if os.path.isdir(folder)}
    with_frames = {name: folder for name, folder in below.items() if _has_frames(folder, suffixes)}
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
    raise InputError(f"{path}: no frames in this folder, {expected}{_meant(path, suffixes)}")


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
    return os.path.isfile(path / "run.json") and os.path.isfile(path / "recipe.toml")


def _listed(folder: Path) -> list[Path]:
    """What is in a folder, sorted; nothing where it may not be read, as a private one of someone else.

    `os.path` says likewise that nothing is there, where the methods of paths raise.
    """
    try:
        return sorted(folder.iterdir())
    except PermissionError:
        return []


def _has_frames(folder: Path, suffixes: Sequence[str]) -> bool:
    try:
        return bool(frame_files(folder, suffixes))
    except PermissionError:
        return False


def _meant(path: Path, suffixes: Sequence[str]) -> str:
    """The folders nearby that may be meant, as the end of a message."""
    if _is_run(path.resolve().parent):
        return f"; it belongs to a run, whose frames are in {path.parent / 'density'}"
    names = [str(folder.relative_to(path)) for folder in _inputs_below(path, suffixes)]
    return f"; those below it that have some are {some_of(names)}: give one" if names else ""


def _inputs_below(path: Path, suffixes: Sequence[str]) -> list[Path]:
    """The folders below one that can be given as inputs, the nearest first: the runs, or what else has frames."""
    found: list[Path] = []
    for folder in itertools.islice(_folders_below(path), _VISITED):
        if any(outer in folder.parents for outer in found):
            continue
        frames = folder / "density" if _is_run(folder) else folder
        if os.path.isdir(frames) and _has_frames(frames, suffixes):
            found.append(folder)
    # The masks of a run lie beside it.
    return list(filter(_is_run, found)) or found


def _folders_below(path: Path) -> Iterator[Path]:
    """The visible folders below one, level by level, as far as they can be read."""
    waiting = deque([(path, 0)])
    while waiting:
        parent, level = waiting.popleft()
        if level == _LEVELS:
            continue
        for folder in _listed(parent):
            if os.path.isdir(folder) and not folder.name.startswith("."):
                yield folder
                waiting.append((folder, level + 1))
