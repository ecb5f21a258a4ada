"""Bounds-checked reading of binary data from a file that may be damaged."""

from __future__ import annotations

import struct
from pathlib import Path

from tnst_mi.errors import InputError

_LENGTH = struct.Struct("<I")
_LARGEST_STRING = 1 << 16


class Cursor:
    """A position in the bytes of a file."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path, self._data, self._position = path, memoryview(data), 0

    @property
    def position(self) -> int:
        """How many bytes have been read."""
        return self._position

    def take(self, count: int) -> memoryview:
        """The next `count` bytes.

        Raises:
            InputError: fewer are left.
        """
        end = self._position + count
        if count < 0 or end > len(self._data):
            raise InputError(f"{self.path}: truncated or damaged: its data end too early; export it again")
        taken = self._data[self._position : end]
        self._position = end
        return taken

    def unpack(self, layout: struct.Struct) -> tuple:
        """The next numbers, in the given layout."""
        return layout.unpack(self.take(layout.size))

    def string(self) -> str:
        """The next string, stored as its length and its bytes."""
        (length,) = self.unpack(_LENGTH)
        if length > _LARGEST_STRING:
            raise InputError(f"{self.path}: damaged: a name of {length} bytes; export it again")
        return bytes(self.take(length)).decode("utf-8", "replace")
