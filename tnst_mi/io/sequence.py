"""Frames on disk: single files, numbered folders, and the layout of the paper's authors.

An npz file holds `density` (D, H, W) and may hold `velocity` (D, H, W, 3) in cells per frame and `obstacle`
(D, H, W); docs/formats.md describes the other formats. The authors' files hold one array `x` each: densities in a
folder `d`, velocities in a folder `v` beside it. Their velocities are on the cell faces (MAC), in cells per time unit,
with 0.5 time units per frame: reading averages the two faces of each cell (the last cell has only one) and multiplies
by 0.5.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, overload

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io.companions import densities
from tnst_mi.io.conventions import Conventions, StoredFrame
from tnst_mi.io.formats import (
    FORMATS,
    GRID_FORMATS,
    files_around,
    read_stored,
    require_format,
    sequence_context,
    write_frame,
)


class FrameFiles(Sequence[Frame]):
    """The frames of a file or folder, in the order of their numbers; each access reads the file anew."""

    def __init__(
        self,
        files: list[Path],
        velocities: Path | None = None,
        given: Conventions | None = None,
        context: Callable[[], Any] = lambda: None,
    ) -> None:
        """Set the files of the frames, and how to read them.

        Args:
            files: the density files.
            velocities: in the authors' layout, the folder of the velocities.
            given: the user's overrides, see `tnst_mi.io.conventions.Conventions`.
            context: returns what reading one frame needs from all files, see `tnst_mi.io.formats.sequence_context`.
        """
        self.files = files
        self._velocities, self._given, self._context = velocities, given or Conventions(), context

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
            return FrameFiles(self.files[index], self._velocities, self._given, self._context)
        return self.frame_of(index, self.stored(index))

    @property
    def suffix(self) -> str:
        """The extension of the files, which identifies their format."""
        return self.files[0].suffix.lower()

    def sources(self, index: int) -> list[Path]:
        """The files that one frame is read from, or would be if they existed."""
        file = self.files[index]
        return [*files_around(file), *([] if self._velocities is None else [self._velocities / file.name])]

    def stored(self, index: int) -> StoredFrame:
        """Read one frame as it is stored, which may have no density.

        Raises:
            InputError: a file cannot be used.
        """
        return read_stored(self.files[index], self._velocities, self._context())

    def frame_of(self, index: int, stored: StoredFrame) -> Frame:
        """The frame made from what `stored` has read.

        Raises:
            InputError: it has no density, or its arrays cannot be used.
        """
        file = self.files[index]
        try:
            return stored.frame(self._given, file.stem, _number(file))
        except InputError as error:
            raise InputError(f"{file}: {str(error).removeprefix(f'{file.stem}: ')}") from None


def open_frames(
    path: str | Path, numbers: tuple[int, int] | None = None, given: Conventions | None = None
) -> FrameFiles:
    """List the frames of a file, a folder or the authors' layout (a folder with `d`) without reading them.

    The frames of a folder are the files whose names end in a number, in the order of the numbers; other files
    are ignored. A folder with one file needs no number.

    Args:
        path: the file or folder.
        numbers: the first and the last frame to take, both included; None takes all.
        given: the user's overrides for what the files declare or their format implies.

    Raises:
        InputError: nothing is there, the format is unknown, or numbers are missing or duplicated.
    """
    path = Path(path)
    if path.is_dir():
        authors = (path / "d").is_dir()
        folder = path / "d" if authors else path
        files = _frame_files(folder)
        chosen = _selected(files, numbers)
        _require_complete(folder, chosen)
        # From all files, so that a frame is read the same whichever frames are selected.
        context = functools.cache(lambda: sequence_context(files))
        return FrameFiles(chosen, path / "v" if authors else None, given, context)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    require_format(path)
    return FrameFiles(_selected([path], numbers), given=given)


def load_frames(path: str | Path) -> list[Frame]:
    """Read all frames of a file, a folder or the layout of the paper's authors.

    Formats are npz, .vdb, .uni and .vol. The frames of a folder are the files whose names end in a number, in the order
    of the numbers; a folder with one file needs none.

    Args:
        path: the file or folder.

    Returns:
        One `Frame` for each: densities (D, H, W), velocities (D, H, W, 3) in cells per frame, at the cell centres.

    Raises:
        InputError: nothing is there, the format is unknown, numbers are missing or duplicated, a file cannot be used,
            or the frames differ in shape.

    Example:
        >>> import tempfile
        >>> import numpy as np
        >>> import tnst_mi
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     for number in (8, 9):
        ...         np.savez(f"{folder}/smoke_{number:04d}.npz", density=np.ones((2, 3, 4)))
        ...     frames = tnst_mi.load_frames(folder)
        >>> [(frame.name, frame.number, frame.density.shape) for frame in frames]
        [('smoke_0008', 8, (2, 3, 4)), ('smoke_0009', 9, (2, 3, 4))]
    """
    return list(checked_shapes(open_frames(path)))


def checked_shapes(frames: Iterable[Frame]) -> Iterable[Frame]:
    """Yield the frames, checking that all have the same shape."""
    shape = None
    for frame in frames:
        shape = shape or frame.density.shape
        if frame.density.shape != shape:
            raise InputError(
                f"{frame.name}: density has shape {frame.density.shape}, expected {shape} like the first frame"
            )
        yield frame


def save_frames(path: str | Path, frames: Frame | Sequence[Frame], format: str = "npz") -> None:
    """Write one frame to a file, or any number to a folder, in files named after them.

    The path is taken as a file if it has a known extension (.npz, .vol, .uni, .vdb) and is not an existing folder. For
    a single `Frame`, any other extension also denotes a file, and is rejected as unknown.

    Args:
        path: the file or folder.
        frames: what to write.
        format: format of the files in a folder: npz, vol, uni or vdb.

    Raises:
        InputError: the format is unknown, several frames are given for one file, or they are not frames.

    Example:
        >>> import os
        >>> import tempfile
        >>> import numpy as np
        >>> import tnst_mi
        >>> frames = [tnst_mi.Frame(np.ones((2, 3, 4)), name=f"smoke_{number:04d}") for number in (8, 9)]
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     tnst_mi.save_frames(folder, frames, format="vdb")
        ...     sorted(os.listdir(folder))
        ['smoke_0008.vdb', 'smoke_0009.vdb']
    """
    path = Path(path)
    several = not isinstance(frames, Frame)
    frames = frames if several else [frames]
    if not isinstance(frames, Sequence) or not all(isinstance(frame, Frame) for frame in frames):
        raise InputError(f"{path}: got a {type(frames).__name__} to write, expected one or more frames (tnst_mi.Frame)")
    if path.is_dir() or not path.suffix or (several and path.suffix.lower() not in FORMATS):
        for frame in frames:
            save_frame(path / f"{frame.name}.{format}", frame)
        return
    require_format(path)
    if len(frames) != 1:
        raise InputError(f"{path}: a file holds one frame and there are {len(frames)}; give a folder")
    save_frame(path, frames[0])


def save_frame(path: Path, frame: Frame) -> None:
    """Write one frame; the extension of the path selects the format.

    Raises:
        InputError: the format is unknown.
    """
    write_frame(path, frame.density, frame.velocity, frame.obstacle, frame.placement)


def _number(file: Path) -> int | None:
    match = re.search(r"(\d+)$", file.stem)
    return int(match[1]) if match else None


def _numbers(files: list[Path]) -> list[int]:
    """The numbers of the files that have one."""
    return [number for file in files if (number := _number(file)) is not None]


def _selected(files: list[Path], numbers: tuple[int, int] | None) -> list[Path]:
    """The files, sorted by number, whose numbers lie between the given first and last."""
    if numbers is None:
        return files
    wanted = "frames = '{}:{}'".format(*numbers)
    have = _numbers(files)
    if len(have) < len(files):
        raise InputError(f"{wanted}: the name of {files[0]} does not end in a frame number; leave out the frames")
    chosen = [file for file, number in zip(files, have, strict=True) if numbers[0] <= number <= numbers[1]]
    if not chosen or (_number(chosen[0]), _number(chosen[-1])) != numbers:
        span = f"frame {have[0]}" if len(have) == 1 else f"frames {have[0]} to {have[-1]}"
        raise InputError(f"{wanted}: the input has the {span}, and both ends must be there")
    return chosen


def _frame_files(folder: Path) -> list[Path]:
    """The files of a folder that are frames, in the order of their numbers."""
    # Hidden files are not ours, or were left unfinished by a killed run.
    visible = (file for file in folder.iterdir() if not file.name.startswith("."))
    files = sorted(file for file in visible if file.suffix.lower() in FORMATS and file.is_file())
    for suffix in GRID_FORMATS:
        grids = [file for file in files if file.suffix.lower() == suffix]
        others = set(grids) - set(densities(grids))
        files = [file for file in files if file not in others]
    if not files:
        raise InputError(f"{folder}: no frames in this folder, expected files {', '.join(FORMATS)}")
    if len(files) == 1:
        return files
    numbered = sorted((number, file) for file in files if (number := _number(file)) is not None)
    if not numbered:
        raise InputError(f"{folder}: no file name ends in a frame number (such as frame_0012.npz)")
    return [file for _, file in numbered]


def _require_complete(folder: Path, files: list[Path]) -> None:
    """Check that no frame number is repeated and none is missing in between."""
    if len(files) == 1:
        return
    numbers = _numbers(files)
    if len(set(numbers)) < len(numbers):
        double = next(number for number in numbers if numbers.count(number) > 1)
        names = ", ".join(file.name for file in files if _number(file) == double)
        raise InputError(f"{folder}: frame {double} is there more than once: {names}")
    if numbers[-1] - numbers[0] >= len(numbers):
        missing = sorted(set(range(numbers[0], numbers[-1] + 1)[:100_000]) - set(numbers))
        shown = ", ".join(map(str, missing[:10])) + (", …" if len(missing) > 10 else "")
        raise InputError(f"{folder}: frames are missing between {numbers[0]} and {numbers[-1]}: {shown}")
