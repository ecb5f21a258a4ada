"""Frames on disk: single files, numbered folders, and the layout of the paper's authors.

A file holds `density` (D, H, W) and may hold `velocity` (D, H, W, 3) in cells per frame and `obstacle`
(D, H, W). The authors' files hold one array `x` each: densities in a folder `d`, velocities in a folder `v`
beside it. Theirs are on the faces of the cells (MAC), in cells per time unit, with 0.5 time units per frame:
reading averages the two faces of each cell (the last cell has only one) and multiplies by 0.5.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import overload

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io.npz import read_arrays, read_headers, write_arrays

#: File name endings of the formats that can be read and written.
FORMATS = (".npz",)

#: Time units per frame in the authors' data.
AUTHORS_TIME_STEP = 0.5


class FrameFiles(Sequence[Frame]):
    """The frames of a file or folder, in the order of their numbers; each access reads the file anew."""

    def __init__(self, files: list[Path], velocities: Path | None = None) -> None:
        """Take the files of the frames, and in the authors' layout the folder of their velocities."""
        self.files = files
        self._velocities = velocities

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.files)

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> FrameFiles: ...
    def __getitem__(self, index: int | slice) -> Frame | FrameFiles:
        """Read one frame, or select several."""
        if isinstance(index, slice):
            return FrameFiles(self.files[index], self._velocities)
        return _read_frame(self.files[index], self._velocities)


def open_frames(path: str | Path, numbers: tuple[int, int] | None = None) -> FrameFiles:
    """List the frames of a file, a folder or the authors' layout (a folder with `d`) without reading them.

    The frames of a folder are the files whose names end in a number, in the order of the numbers; other files
    are left alone. A folder with one file needs no number.

    Args:
        path: the file or folder.
        numbers: the first and the last frame to take, both included; None takes all.

    Raises:
        InputError: nothing is there, the format is unknown, or numbers are missing or double.
    """
    path = Path(path)
    if path.is_dir():
        authors = (path / "d").is_dir()
        files = _numbered_files(path / "d" if authors else path, numbers)
        return FrameFiles(files, path / "v" if authors else None)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    _require_format(path)
    return FrameFiles(_selected([path], numbers))


def load_frames(path: str | Path) -> list[Frame]:
    """Read the frames of a file, a folder or the authors' layout; see `open_frames`.

    Raises:
        InputError: as `open_frames`; or a file cannot be used, or the frames differ in shape.
    """
    return list(checked_shapes(open_frames(path)))


def checked_shapes(frames: Iterable[Frame]) -> Iterable[Frame]:
    """Pass frames on as long as all have the same shape."""
    shape = None
    for frame in frames:
        shape = shape or frame.density.shape
        if frame.density.shape != shape:
            raise InputError(
                f"{frame.name}: density has shape {frame.density.shape}, expected {shape} like the first frame"
            )
        yield frame


def save_frames(path: str | Path, frames: Frame | Sequence[Frame]) -> None:
    """Write one frame to a file, or any number to a folder by their names.

    The path is that of a file if it ends like one (.npz) and is no folder. One frame by itself also takes any
    other extension for that of a file, and refuses it as unknown.

    Raises:
        InputError: the format is unknown, several frames are to go into one file, or they are no frames.
    """
    path = Path(path)
    several = not isinstance(frames, Frame)
    frames = frames if several else [frames]
    if not isinstance(frames, Sequence) or not all(isinstance(frame, Frame) for frame in frames):
        raise InputError(f"{path}: got a {type(frames).__name__} to write, expected one or more frames (tnst_mi.Frame)")
    if path.is_dir() or not path.suffix or (several and path.suffix.lower() not in FORMATS):
        for frame in frames:
            _write_frame(path / f"{frame.name}{FORMATS[0]}", frame)
        return
    _require_format(path)
    if len(frames) != 1:
        raise InputError(f"{path}: a file holds one frame and there are {len(frames)}; give a folder")
    _write_frame(path, frames[0])


def centred_velocity(faces: np.ndarray) -> np.ndarray:
    """Average a velocity on cell faces (component c at the lower face along its axis) to the cell centres.

    (D, H, W, 3) to the same shape. The last cell's upper face is not stored: it takes the lower one's value.
    """
    centres = faces.astype(np.float32)
    for component, axis in enumerate((2, 1, 0)):
        values = np.moveaxis(centres[..., component], axis, 0)
        values[:-1] = 0.5 * (values[:-1] + values[1:])
    return centres


def _number(file: Path) -> int | None:
    match = re.search(r"(\d+)$", file.stem)
    return int(match[1]) if match else None


def _require_format(path: Path) -> None:
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"{path}: unknown format {path.suffix!r}, expected one of {', '.join(FORMATS)}")


def _selected(files: list[Path], numbers: tuple[int, int] | None) -> list[Path]:
    """Those of the files, in the order of their numbers, that are numbered from the first to the last."""
    if numbers is None:
        return files
    wanted = "frames = '{}:{}'".format(*numbers)
    have = [_number(file) for file in files]
    if None in have:
        raise InputError(f"{wanted}: the name of {files[0]} does not end in a frame number; leave out the frames")
    chosen = [file for file, number in zip(files, have, strict=True) if numbers[0] <= number <= numbers[1]]
    if not chosen or (_number(chosen[0]), _number(chosen[-1])) != numbers:
        span = f"frame {have[0]}" if len(have) == 1 else f"frames {have[0]} to {have[-1]}"
        raise InputError(f"{wanted}: the input has the {span}, and both ends must be there")
    return chosen


def _numbered_files(folder: Path, selection: tuple[int, int] | None) -> list[Path]:
    # Hidden files are none of ours, or what a killed run was writing.
    visible = (file for file in folder.iterdir() if not file.name.startswith("."))
    files = sorted(file for file in visible if file.suffix.lower() in FORMATS and file.is_file())
    if not files:
        raise InputError(f"{folder}: no frames in this folder, expected files {', '.join(FORMATS)}")
    if len(files) == 1:
        return _selected(files, selection)
    files = sorted((file for file in files if _number(file) is not None), key=_number)
    if not files:
        raise InputError(f"{folder}: no file name ends in a frame number (such as frame_0012.npz)")
    files = _selected(files, selection)
    numbers = [_number(file) for file in files]
    if len(set(numbers)) < len(numbers):
        double = next(number for number in numbers if numbers.count(number) > 1)
        names = ", ".join(file.name for file in files if _number(file) == double)
        raise InputError(f"{folder}: frame {double} is there more than once: {names}")
    if numbers[-1] - numbers[0] >= len(numbers):
        missing = sorted(set(range(numbers[0], numbers[-1] + 1)[:100_000]) - set(numbers))
        shown = ", ".join(map(str, missing[:10])) + (", …" if len(missing) > 10 else "")
        raise InputError(f"{folder}: frames are missing between {numbers[0]} and {numbers[-1]}: {shown}")
    return files


def _read_frame(file: Path, velocities: Path | None) -> Frame:
    arrays = read_arrays(file, ("density", "velocity", "obstacle", "x"))
    density = arrays.get("density", arrays.get("x"))
    if density is None:
        found = ", ".join(read_headers(file)) or "none"
        raise InputError(f"{file}: no array 'density' (or 'x'), the arrays found are: {found}")
    velocity = arrays.get("velocity")
    if velocities is not None and (velocities / file.name).exists():
        faces = read_arrays(velocities / file.name, ("x",)).get("x")
        if faces is None or faces.ndim != 4 or faces.shape[-1] != 3:
            raise InputError(f"{velocities / file.name}: expected an array 'x' of shape (D, H, W, 3)")
        velocity = centred_velocity(faces) * np.float32(AUTHORS_TIME_STEP)
    try:
        return Frame(density, velocity, arrays.get("obstacle"), file.stem, _number(file))
    except InputError as error:
        raise InputError(f"{file}: {str(error).removeprefix(f'{file.stem}: ')}") from None


def _write_frame(path: Path, frame: Frame) -> None:
    arrays = {"density": frame.density, "velocity": frame.velocity, "obstacle": frame.obstacle}
    write_arrays(path, {key: array for key, array in arrays.items() if array is not None})
