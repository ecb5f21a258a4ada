"""What reading one frame of a sequence needs from all its files: the box of the voxels, the shape of missing grids."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.io.array_frames import ARRAY_FORMATS, shape_of_density
from tnst_mi.io.grids.vdb.frames import box_of_all, has_density
from tnst_mi.io.grids.vdb.tree import Box
from tnst_mi.io.roles import Wanted


class SequenceContext:
    """What reading one frame of a sequence needs from all its files; found out on first access.

    A frame whose file has no density is one without smoke if another file has one.
    """

    def __init__(self, files: Sequence[Path], wanted: Wanted) -> None:
        """Set the files, and the names that the user gives for grids."""
        self._files, self._wanted = files, wanted

    @cached_property
    def box(self) -> Box | None:
        """The voxels of the frames in .vdb files; None if there are none.

        Raises:
            InputError: the files do not fit together.
        """
        return box_of_all([file for file in self._files if file.suffix.lower() == ".vdb"], self._wanted)

    @cached_property
    def has_density(self) -> bool:
        """Whether any .vdb file has a density."""
        return any(self._of_each(has_density, (".vdb",)))

    @cached_property
    def shape(self) -> tuple[int, ...] | None:
        """The shape (D, H, W) of the first density in the files of arrays; None if there is none."""
        return next(filter(None, self._of_each(shape_of_density, ARRAY_FORMATS)), None)

    def _of_each(self, found: Callable[[Path, Wanted], Any], formats: Sequence[str]) -> Iterator[Any]:
        """What is found in each file of some formats; those that cannot be read tell why when their frames are."""
        for file in self._files:
            if file.suffix.lower() in formats:
                with contextlib.suppress(InputError):
                    yield found(file, self._wanted)
