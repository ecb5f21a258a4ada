"""Mitsuba's .vol files (VolumeGrid): a header and the values, x running fastest, channels interleaved.

Source: Mitsuba's documentation of `gridvolume`. The bounding box in the header is written as the unit cube, Mitsuba's
default placement, and ignored on reading: scenes place a volume by its `to_world`.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import written_whole
from tnst_mi.io.untrusted import LARGEST_EXTENT
from tnst_mi.machine.gate import opening

_MAGIC = b"VOL"
_VERSION = 3
_HEADER = struct.Struct("<3sB5i6f")
_UNIT_CUBE = (0.0, 0.0, 0.0, 1.0, 1.0, 1.0)

# Encodings: float32, half precision, and bytes with 255 for 1. Mitsuba 3 reads and writes only the first.
_FLOAT = 1
_ENCODINGS = {_FLOAT: "<f4", 2: "<f2", 3: "u1"}


def read_vol_shape(path: Path) -> tuple[int, ...]:
    """Read the shape of the grid in a .vol file: (D, H, W), or (D, H, W, channels) for several channels.

    Raises:
        InputError: the file is missing, damaged, or of an unknown kind.
    """
    return _read(path, values=False)[0]


def read_vol(path: Path) -> np.ndarray:
    """Read a .vol file: float32 (D, H, W), or (D, H, W, channels) for several channels.

    Raises:
        InputError: as `read_vol_shape`.
    """
    return _read(path, values=True)[1]


def write_vol(path: Path, values: np.ndarray) -> None:
    """Write a grid (D, H, W) or (D, H, W, channels) as a .vol file of float32."""
    depth, height, width = values.shape[:3]
    channels = values.shape[3] if values.ndim == 4 else 1
    with written_whole(path) as temporary, temporary.open("wb") as file:
        file.write(_HEADER.pack(_MAGIC, _VERSION, _FLOAT, width, height, depth, channels, *_UNIT_CUBE))
        file.write(np.ascontiguousarray(values, dtype="<f4").data)


def _read(path: Path, values: bool) -> tuple[tuple[int, ...], np.ndarray]:
    with opening(path, "a .vol file"), path.open("rb") as file:
        shape, dtype = _shape_and_type(path, file.read(_HEADER.size))
        size = math.prod(shape) * dtype.itemsize
        held = path.stat().st_size - _HEADER.size
        if held != size:
            raise InputError(f"{path}: holds {held} bytes of values, expected {size} for shape {shape}")
        stored = np.frombuffer(file.read(size), dtype) if values else np.empty(0, dtype)
    if not values:
        return shape, stored
    if stored.size != math.prod(shape):
        raise InputError(f"{path}: became shorter while it was read")
    grid = stored.astype(np.float32).reshape(shape)
    return shape, grid / np.float32(255.0) if dtype.kind == "u" else grid


def _shape_and_type(path: Path, data: bytes) -> tuple[tuple[int, ...], np.dtype]:
    if len(data) < _HEADER.size:
        raise InputError(f"{path}: {len(data)} bytes, expected a header of {_HEADER.size}")
    magic, version, encoding, width, height, depth, channels, *_ = _HEADER.unpack(data)
    if magic != _MAGIC or version != _VERSION:
        raise InputError(f"{path}: starts with {data[:4]!r}, expected a Mitsuba volume, {_MAGIC + bytes([_VERSION])!r}")
    if encoding not in _ENCODINGS:
        raise InputError(f"{path}: encoding {encoding}, expected 1 (float32), 2 (half) or 3 (bytes)")
    if not all(1 <= extent <= LARGEST_EXTENT for extent in (width, height, depth)) or channels not in (1, 3):
        raise InputError(
            f"{path}: claims {width} x {height} x {depth} cells of {channels} channels, "
            f"expected 1 to {LARGEST_EXTENT} cells each and 1 or 3 channels"
        )
    shape = (depth, height, width)
    return shape if channels == 1 else (*shape, channels), np.dtype(_ENCODINGS[encoding])
