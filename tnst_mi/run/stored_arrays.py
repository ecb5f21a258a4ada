"""The arrays that a run wrote, read from its folder when they are needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import overload

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.geometry.other_grids import OtherGrid, OtherGrids
from tnst_mi.io.formats import FORMATS, read_stored
from tnst_mi.io.interpretation.conventions import Conventions
from tnst_mi.io.sequence import FrameFiles
from tnst_mi.run.carry import VELOCITY


class StoredArrays(Sequence[np.ndarray]):
    """The arrays that a run wrote, in the order of their names; each access reads a file."""

    def __init__(
        self,
        out: Path,
        kind: str,
        names: Sequence[str],
        suffix: str = FORMATS[0],
        inputs: Sequence[Frame] = (),
    ) -> None:
        """Take the "density" or "velocity" of the named frames.

        Args:
            out: the folder of the run.
            kind: "density" or "velocity".
            names: of the frames.
            suffix: with which the names of the files end.
            inputs: the frames of the run, on whose grid results are that lie on voxels of their own.
        """
        self._out, self._kind, self._names, self._suffix, self._inputs = out, kind, names, suffix, inputs

    def __len__(self) -> int:
        """Number of frames."""
        return len(self._names)

    @overload
    def __getitem__(self, index: int) -> np.ndarray: ...
    @overload
    def __getitem__(self, index: slice) -> StoredArrays: ...
    def __getitem__(self, index: int | slice) -> np.ndarray | StoredArrays:
        """Read one array, or select several.

        Raises:
            InputError: its file has been damaged since the run.
        """
        if isinstance(index, slice):
            return StoredArrays(self._out, self._kind, self._names[index], self._suffix, self._inputs)
        name, as_told = self._names[index], Conventions()
        file = self._out / self._kind / f"{name}{self._suffix}"
        stored = self._inputs.result(file) if isinstance(self._inputs, FrameFiles) else read_stored(file)
        if self._kind == "density":
            return stored.frame(as_told, name, None).density
        velocity = stored.centred_velocity(as_told)
        if velocity is None:
            raise InputError(f"{file}: holds no velocity, expected that of a run's result")
        return velocity


class StoredGrids(Sequence[Mapping[str, np.ndarray]]):
    """The grids beside the densities that a run wrote, frame by frame; each is read from its file on access."""

    def __init__(self, out: Path, names: Sequence[str], suffix: str, inputs: Sequence[Frame]) -> None:
        """Take those of the named frames.

        Args:
            out: the folder of the run.
            names: of the frames.
            suffix: with which the names of the files end.
            inputs: the frames of the run.
        """
        self._out, self._names, self._suffix, self._inputs = out, names, suffix, inputs

    def __len__(self) -> int:
        """Number of frames."""
        return len(self._names)

    @overload
    def __getitem__(self, index: int) -> Mapping[str, np.ndarray]: ...
    @overload
    def __getitem__(self, index: slice) -> StoredGrids: ...
    def __getitem__(self, index: int | slice) -> Mapping[str, np.ndarray] | StoredGrids:
        """The grids of one frame by name, or those of several.

        Raises:
            InputError: its file has been damaged since the run.
        """
        if isinstance(index, slice):
            return StoredGrids(self._out, self._names[index], self._suffix, self._inputs)
        file, inputs = self._out / "density" / f"{self._names[index]}{self._suffix}", self._inputs
        stored = inputs.result(file, simulated=True) if isinstance(inputs, FrameFiles) else read_stored(file)
        frame = stored.frame(Conventions(), self._names[index], None)
        readers = frame.other_grids.readers
        if frame.velocity is not None:
            readers = readers | {VELOCITY: partial(OtherGrid, frame.velocity)}
        return OtherGrids(readers, frame.density.shape, frame.name)
