"""An item as a file: safetensors, read without pickle and with its sizes checked.

It holds a checksum of each array together with the item's name and the run that it belongs to. So an item that is
truncated, that has lost its contents with the power, or that has another's name is found when it is read.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Collection
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save

from tnst_mi.optimisation.items.damage import DamagedItemError, reading
from tnst_mi.optimisation.items.interface import Arrays


class Item(NamedTuple):
    """Which item: its group, frame and generation."""

    group: str
    frame: int
    generation: int

    @property
    def path(self) -> PurePosixPath:
        """Of its file, in the folder of the working state."""
        return PurePosixPath(self.group) / f"{self.frame:06d}.{self.generation:06d}.safetensors"

    def content(self, arrays: Arrays, run: str) -> bytes:
        """What its file holds.

        Args:
            arrays: of the item, by name.
            run: identifies the run that it belongs to.
        """
        arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
        return save(arrays, {name: self._checksum(run, name, array) for name, array in arrays.items()})

    def read(self, path: Path, run: str, names: Collection[str] | None = None) -> Arrays:
        """The arrays of its file, or only the named ones.

        Raises:
            DamagedItemError: the file is not what was written by the run.
        """
        with reading(path, *self), safe_open(path, framework="numpy") as file:
            written = file.metadata() or {}
            found = {name: file.get_tensor(name) for name in file.keys() if names is None or name in names}
        if names is not None and set(names) - set(found):
            raise DamagedItemError(path, "arrays are missing", *self)
        for name, array in found.items():
            # Other packages add types to numpy, of which none is ever written.
            if array.dtype.isbuiltin != 1:
                raise DamagedItemError(path, f"{name} is of another type", *self)
            if written.get(name) != self._checksum(run, name, array):
                raise DamagedItemError(path, f"the checksum of {name} is another", *self)
        return found

    def _checksum(self, run: str, name: str, array: np.ndarray) -> str:
        """The checksum of an array (CRC-32), with what must not be another's: its run, its item, its name and form."""
        form = json.dumps([run, self.group, self.path.name, name, array.dtype.str, array.shape])
        return f"{zlib.crc32(array.data, zlib.crc32(form.encode('utf-8'))):08x}"
