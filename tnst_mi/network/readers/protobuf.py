"""A minimal reader of the protocol buffer wire format (https://protobuf.dev/programming-guides/encoding).

It covers only what the two weights formats need. Every length is checked against the remaining bytes before it is used,
and nothing is copied until a field is read.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from tnst_mi.network.readers.network_weights import MalformedFile

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
# A field takes far more memory than the two bytes that it may have in a file.
_MOST_FIELDS = 1 << 20
_FIXED_SIZES = {_FIXED64: 8, _FIXED32: 4}


def _varint(data: memoryview, start: int) -> tuple[int, int]:
    """The unsigned integer at `start` and the position after it."""
    value = 0
    for index, byte in enumerate(data[start : start + 10]):
        value |= (byte & 0x7F) << (7 * index)
        if byte < 0x80:
            return value, start + index + 1
    raise MalformedFile("truncated or not a protocol buffer (an integer does not end)")


class Message:
    """One message: its fields by number, each a list of integers (varints) or byte ranges (all else)."""

    def __init__(self, data: memoryview) -> None:
        """Split `data` into fields; raises `MalformedFile` where a field runs past the end."""
        self._fields: dict[int, list[int | memoryview]] = defaultdict(list)
        position = count = 0
        while position < len(data):
            if (count := count + 1) > _MOST_FIELDS:
                raise MalformedFile(f"not the expected protocol buffer (more than {_MOST_FIELDS} fields in a message)")
            key, position = _varint(data, position)
            number, wire_type = key >> 3, key & 7
            if wire_type == _VARINT:
                value, position = _varint(data, position)
                self._fields[number].append(value)
                continue
            if wire_type == _BYTES:
                size, position = _varint(data, position)
            elif wire_type in _FIXED_SIZES:
                size = _FIXED_SIZES[wire_type]
            else:
                raise MalformedFile(f"truncated or not a protocol buffer (wire type {wire_type})")
            if size > len(data) - position:
                raise MalformedFile(f"truncated: a field of {size} bytes where {len(data) - position} are left")
            self._fields[number].append(data[position : position + size])
            position += size

    def byte_ranges(self, number: int) -> list[memoryview]:
        """Every occurrence of a field of bytes; nothing is copied."""
        values = self._fields.get(number, [])
        ranges = [value for value in values if not isinstance(value, int)]
        if len(ranges) < len(values):
            raise MalformedFile(f"not the expected protocol buffer (field {number} is an integer)")
        return ranges

    def messages(self, number: int) -> list[Message]:
        """Every occurrence of a sub-message."""
        return [Message(data) for data in self.byte_ranges(number)]

    def text(self, number: int) -> str:
        """A string, "" if the field is absent; the last occurrence counts, as the format requires."""
        values = self.byte_ranges(number)
        try:
            return bytes(values[-1]).decode("utf-8") if values else ""
        except UnicodeDecodeError:
            raise MalformedFile(f"not the expected protocol buffer (field {number} is no text)") from None

    def integers(self, number: int) -> list[int]:
        """A repeated unsigned integer, packed or not."""
        values: list[int] = []
        for value in self._fields.get(number, []):
            if isinstance(value, int):
                values.append(value)
                continue
            position = 0
            while position < len(value):
                element, position = _varint(value, position)
                values.append(element)
        return values

    def floats(self, number: int) -> np.ndarray:
        """A repeated float32, packed or not, as a new array."""
        data = b"".join(self.byte_ranges(number))
        if len(data) % 4:
            raise MalformedFile(f"truncated: field {number} has {len(data)} bytes, not a multiple of 4")
        return np.frombuffer(data, "<f4").astype(np.float32)
