"""What reading one frame of a sequence needs from all its files: the grid of the run, the shape of missing arrays."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.io.array_frames import ARRAY_FORMATS, shape_of_density
from tnst_mi.io.grids.vdb.frames import has_density, run_grid_of
from tnst_mi.io.grids.vdb.run_grid import RunGrid
from tnst_mi.io.interpretation.conventions import Conventions
from tnst_mi.io.interpretation.roles import Wanted
from tnst_mi.machine.gate import gate


class SequenceContext:
    """What reading one frame of a sequence needs from all its files; found out on first access.

    A frame whose file has no density is one without smoke if another file has one.
    """

    def __init__(
        self,
        files: Sequence[Path],
        given: Conventions,
        numbers: Mapping[Path, float] = MappingProxyType({}),
        beside: Sequence[Sequence[Path]] = (),
    ) -> None:
        """Set what is known of the sequence.

        Args:
            files: of the densities.
            given: what the user overrides.
            numbers: of the frames, as far as they are known.
            beside: files of velocities and obstacles alone, or of which these are read alone; those of a velocity's
                components together.
        """
        self._files, self._given, self._numbers, self._beside = files, given, numbers, beside

    @property
    def run(self) -> RunGrid | None:
        """The grid on which .vdb files are read; None if there are none with voxels.

        Raises:
            InputError: it would be too large.
        """
        run = self._run
        if isinstance(run, InputError):
            raise InputError(str(run))
        return run

    @cached_property
    def _run(self) -> RunGrid | InputError | None:
        # An error is kept too: it would be found anew for every frame.
        files = [file for file in self._files if file.suffix.lower() == ".vdb"]
        beside = [group for group in self._beside if group[0].suffix.lower() == ".vdb"]
        try:
            with gate(files[0] if files else Path(), "a .vdb file"):
                given = self._given
                return run_grid_of(files, given.names, given.box, given.fog, self._numbers, beside, given.up)
        except InputError as error:
            return error

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
                    with gate(file, f"a {file.suffix.lower()} file"):
                        yield found(file, self._given.names)
