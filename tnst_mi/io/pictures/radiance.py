"""Radiance pictures (.hdr, .pic): linear red, green and blue with a shared exponent, read with bounded memory."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.machine.gate import opening

#: How the files begin.
MAGIC = (b"#?RADIANCE", b"#?RGBE")

#: Largest number of pixels, 4096 × 4096.
_LARGEST = 1 << 24
_LONGEST_HEADER = 1 << 16
_RESOLUTION = re.compile(rb"(?P<y>[-+])Y (?P<rows>\d{1,6}) (?P<x>[-+])X (?P<columns>\d{1,6})")

#: Widths of scanlines whose components are compressed one by one.
_COMPRESSED_WIDTHS = range(8, 1 << 15)


def read_radiance(path: Path, most: int) -> np.ndarray:
    """Read a picture as linear values (H, W, 3) float32, row 0 at the top.

    Args:
        path: the file.
        most: the largest number of pixels to read, as far as that is not more than 4096 × 4096.

    Raises:
        InputError: the file is missing, damaged, has too many pixels, or holds another colour space than RGB.
    """
    with opening(path, "a Radiance picture"):
        data = path.read_bytes()
        header, _, rest = data[:_LONGEST_HEADER].partition(b"\n\n")
        line, _, _ = rest.partition(b"\n")
        match = _RESOLUTION.fullmatch(line.strip())
        if not header.startswith(MAGIC) or match is None:
            raise ValueError("expected a line with its size, such as -Y 512 +X 512")
        if re.search(rb"^FORMAT=\s*32-bit_rle_xyze", header, re.MULTILINE):
            raise InputError(f"{path}: holds XYZ colours, expected RGB; save it again as OpenEXR")
        rows, columns = int(match["rows"]), int(match["columns"])
        if not 0 < rows * columns <= (most := min(most, _LARGEST)):
            raise InputError(f"{path}: has {columns} x {rows} pixels, expected at most {most}; make it smaller")
        start = len(header) + 2 + len(line) + 1
        packed = _unpacked(memoryview(data)[start:], rows, columns)
    values = np.ldexp(packed[..., :3].astype(np.float32), packed[..., 3:].astype(np.int32) - 136)
    values[packed[..., 3] == 0] = 0.0
    return values[:: 1 if match["y"] == b"-" else -1, :: 1 if match["x"] == b"+" else -1]


def _unpacked(data: memoryview, rows: int, columns: int) -> np.ndarray:
    """The bytes (H, W, 4) of the pixels, decompressed; raises ValueError if there are fewer."""
    packed, position = np.zeros((rows, columns, 4), np.uint8), 0
    for row in packed:
        start = bytes(data[position : position + 4])
        if columns in _COMPRESSED_WIDTHS and start == bytes((2, 2, columns >> 8, columns & 255)):
            position = _by_component(data, position + 4, row)
        else:
            position = _by_pixel(data, position, row)
    return packed


def _by_component(data: memoryview, position: int, row: np.ndarray) -> int:
    """Fill a scanline whose components follow each other, in runs and literal stretches; returns where it ends."""
    for component in range(4):
        filled = 0
        while filled < len(row):
            count = _byte(data, position)
            run = count > 128
            count = count - 128 if run else count
            stretch = data[position + 1 : position + (2 if run else 1 + count)]
            if count == 0 or filled + count > len(row) or len(stretch) < (1 if run else count):
                raise ValueError("a scanline is damaged or truncated")
            row[filled : filled + count, component] = stretch[0] if run else stretch
            filled, position = filled + count, position + 1 + len(stretch)
    return position


def _by_pixel(data: memoryview, position: int, row: np.ndarray) -> int:
    """Fill a scanline of pixels, of which (1, 1, 1, n) repeats the one before; returns where it ends."""
    filled, shift = 0, 0
    while filled < len(row):
        pixel = bytes(data[position : position + 4])
        if len(pixel) < 4:
            raise ValueError("a scanline is truncated")
        position += 4
        if pixel[:3] != b"\1\1\1":
            row[filled] = tuple(pixel)
            filled, shift = filled + 1, 0
            continue
        count = pixel[3] << shift
        if filled == 0 or filled + count > len(row):
            raise ValueError("a scanline is damaged")
        row[filled : filled + count] = row[filled - 1]
        filled, shift = filled + count, min(shift + 8, 24)
    return position


def _byte(data: memoryview, position: int) -> int:
    if position >= len(data):
        raise ValueError("a scanline is truncated")
    return data[position]
