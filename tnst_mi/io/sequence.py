"""Frames on disk: single files, sequences in folders, and the layout of the paper's authors.

An npz file holds `density` (D, H, W) and may hold `velocity` (D, H, W, 3) in cells per frame and `obstacle`
(D, H, W); docs/formats.md describes the other formats. The authors' files hold one array `x` each: densities in a
folder `d`, velocities in a folder `v` beside it. Their velocities are on the cell faces (MAC), in cells per time unit,
with 0.5 time units per frame: reading averages the two faces of each cell (the last cell has only one) and multiplies
by 0.5. Which files are frames is decided by `tnst_mi.io.files.listing`.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import overload

import numpy as np

from tnst_mi.errors import InputError, naming
from tnst_mi.frame import Frame
from tnst_mi.io.context import SequenceContext
from tnst_mi.io.files.companions import companion_groups, companions_of
from tnst_mi.io.files.folders import densities_of_run
from tnst_mi.io.files.frame_numbers import Number
from tnst_mi.io.files.listing import Listing, list_frames
from tnst_mi.io.formats import (
    FORMATS,
    files_around,
    read_stored,
    require_format,
    write_frame,
)
from tnst_mi.io.interpretation.conventions import Conventions, StoredFrame
from tnst_mi.io.interpretation.roles import NONE, Wanted
from tnst_mi.machine.gate import gate
from tnst_mi.machine.terminal import displayable
from tnst_mi.resources import expanded


class FrameFiles(Sequence[Frame]):
    """The frames of a file, a folder or a pattern, in the order of their numbers; each access reads the file anew."""

    def __init__(
        self,
        source: Path,
        listing: Listing,
        given: Conventions | None = None,
        context: SequenceContext | None = None,
    ) -> None:
        """Set the files of the frames, and how to read them.

        Args:
            source: the file, the folder or the pattern.
            listing: its files.
            given: the user's overrides, see `tnst_mi.io.interpretation.conventions.Conventions`.
            context: what reading a frame needs from the whole sequence, if that has been found out already.
        """
        self.source, self._listing, self._given = source, listing, given or Conventions()
        self._known_context = context

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.files)

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Frame]: ...
    def __getitem__(self, index: int | slice) -> Frame | Sequence[Frame]:
        """Read one frame, or select several, which are read on access."""
        if isinstance(index, slice):
            return self.only(range(len(self))[index])
        return self.frame_of(index, self.stored(index))

    def only(self, indices: Iterable[int]) -> FrameFiles:
        """Some of the frames, each read as in the whole sequence."""
        chosen = list(indices)
        files, numbers = ([items[index] for index in chosen] for items in (self.files, self.numbers))
        return FrameFiles(self.source, replace(self._listing, files=files, numbers=numbers), self._given, self._context)

    @property
    def files(self) -> list[Path]:
        """The density files."""
        return self._listing.files

    @property
    def numbers(self) -> list[Number | None]:
        """The numbers of the frames; None for a single file without one."""
        return self._listing.numbers

    @property
    def numbers_there(self) -> list[Number]:
        """The numbers of all frames of the sequence, of which these may be a part."""
        return sorted(number for number in self._listing.sequence.values() if number is not None)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was decided in choosing the files, to be said."""
        return self._listing.notes

    @property
    def title(self) -> str:
        """A name for all frames together, which can be part of a file's name."""
        source = self.source.resolve()
        name = source.name if source.is_dir() else source.stem if source.exists() else self.files[0].stem
        return displayable(name)

    @property
    def grid_notes(self) -> tuple[str, ...]:
        """What was decided about the grid on which the files are read, to be said once they have been.

        Raises:
            InputError: there is no such grid.
        """
        run = None if self._context is None else self._context.run
        return () if run is None else run.notes

    @property
    def suffix(self) -> str:
        """The extension of the files, which identifies their format."""
        return self.files[0].suffix.lower()

    def sources(self, index: int) -> list[Path]:
        """The files that one frame is read from, or would be if they existed."""
        file, velocities = self.files[index], self._listing.velocities
        return [*files_around(file), *companions_of(file), *([] if velocities is None else [velocities / file.name])]

    def stored(self, index: int) -> StoredFrame:
        """Read one frame as it is stored, which may have no density.

        Raises:
            InputError: a file cannot be used.
        """
        return read_stored(
            self.files[index], self._listing.velocities, self._context, self._given.names, self._given.fog
        )

    def result(self, file: Path, simulated: bool = False) -> StoredFrame:
        """Read the result of a frame, a file of the same name, on the grid of these files.

        Args:
            file: the file.
            simulated: whether its velocity is that of the simulation, as it is beside a density.

        Raises:
            InputError: it cannot be used.
        """
        stored = read_stored(file, context=self._context)
        if not simulated:
            # A velocity that is not that of the smoke does not go with a moving grid.
            return replace(stored, drift=None)
        return replace(stored, dt=stored.frame_duration(self._given))

    def grid_on_cells(self, index: int, name: str | None, file: Path | None = None) -> np.ndarray:
        """A scalar grid other than the density, on the cells of a frame (D, H, W), in our axes; not checked.

        Args:
            index: of the frame.
            name: of the grid; None for what would be taken as the density.
            file: that has it; None for that of the frame.

        Raises:
            InputError: the file cannot be used, or has no such grid.
        """
        own = self.files[index]
        file, run = own if file is None else file, None if self._context is None else self._context.run
        if run is not None and run.lows and file.stem != own.stem:
            raise InputError(
                f"{file}: the grid moves with the smoke, and places in it are known by names of files; give the masks "
                "the names of the frames, or take the whole grid (--crop off)"
            )
        stored = read_stored(file, context=self._context, wanted=Wanted(name, NONE, NONE, alone=True))
        with naming(file):
            return stored.scaled_density(replace(self._given, scale=None))

    def frame_of(self, index: int, stored: StoredFrame) -> Frame:
        """The frame made from what `stored` has read.

        Raises:
            InputError: it has no density, or its arrays cannot be used.
        """
        file = self.files[index]
        if stored.density is None and (densities := densities_of_run(file)):
            raise InputError(f"{file}: holds the velocity v* of a run and is no frame; its frames are in {densities}")
        name = displayable(file.stem)
        with gate(file, "a frame"):
            try:
                return stored.frame(self._given, name, self.numbers[index])
            except InputError as error:
                raise InputError(f"{file}: {str(error).removeprefix(f'{name}: ')}") from None

    @functools.cached_property
    def _context(self) -> SequenceContext | None:
        """What reading one frame needs from all files: it is read the same whichever frames are selected."""
        if self._known_context is not None:
            return self._known_context
        sequence = self._listing.sequence
        beside = [group for file in sequence for group in companion_groups(file)]
        if not (self.source.is_dir() or len(sequence) > 1 or beside or self.suffix == ".vdb"):
            return None
        numbers = {file: float(number) for file, number in sequence.items() if number is not None}
        return SequenceContext(list(sequence), self._given, numbers, beside)


def open_frames(
    path: str | Path, numbers: tuple[Number, Number] | None = None, given: Conventions | None = None
) -> FrameFiles:
    """List the frames of a file, a folder, a folder that a program made, or a pattern, without reading them.

    Args:
        path: the file, the folder, or the pattern (`tnst_mi.io.files.patterns`).
        numbers: the first and the last frame to take, both included; floats take sub-frames too. None takes all whole
            frames, or all sub-frames if there are no others.
        given: the user's overrides for what the files declare or their format implies.

    Raises:
        InputError: nothing is there, the format is unknown, there are several sequences, or numbers are missing or
            duplicated.
    """
    path = Path(path)
    with gate(path, "the path of frames"):
        return FrameFiles(path, list_frames(path, numbers), given)


def load_frames(path: str | Path) -> list[Frame]:
    """Read all frames of a file, a folder or a pattern such as `smoke_####.vdb`.

    Formats are npz, .npy, .vdb, .uni and .vol. The frames of a folder are the files of one name with different numbers,
    in the order of the numbers; a folder with one file needs none. Folders that programs make lead to their frames:
    the cache of Blender, a scene of PhiFlow, a run of ours, the layout of the paper's authors.

    Args:
        path: the file, the folder or the pattern.

    Returns:
        One `Frame` for each: densities (D, H, W), velocities (D, H, W, 3) in cells per frame, at the cell centres.
        Other grids, such as `frame.grids["temperature"]`, are read from the files when they are accessed.

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
    path = expanded(Path(path))
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
    write_frame(path, frame.density, frame.velocity, frame.obstacle, frame.placement, frame.other_grids)
