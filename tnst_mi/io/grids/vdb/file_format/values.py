"""The value types of OpenVDB trees, and the compression of runs of values in files.

Source: `openvdb/io/Compression.h` and `Compression.cc`, file versions 222 to 224.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import blosc
import numpy as np
from blosc.blosc_extension import error as BloscError

from tnst_mi.errors import InputError
from tnst_mi.io.grids.vdb.file_format.cursor import Cursor

# Bits of a grid's compression flags.
ZIP, ACTIVE_MASK, BLOSC = 1, 2, 4

_SIZE = struct.Struct("<q")
_BLOSC_HEADER = struct.Struct("<4BIII")  # versions, flags, size of a value; bytes, bytes of a block, compressed bytes
_BLOSC_LEVEL = 9  # as OpenVDB does

# A run of values is at most a few hundred kilobytes: threads cost more than they gain.
blosc.set_nthreads(1)


@dataclass(frozen=True)
class ValueType:
    """How the values of a tree are stored: numbers of one type, one or three per voxel."""

    dtype: np.dtype
    components: int
    half: bool = False

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one value: () or (3,)."""
        return () if self.components == 1 else (self.components,)

    @property
    def itemsize(self) -> int:
        """Bytes of a single value, such as the background, which is never in half precision."""
        return self.dtype.itemsize * self.components

    @property
    def run_dtype(self) -> np.dtype:
        """The type of the numbers in runs of values."""
        return np.dtype("<f2") if self.half else self.dtype

    @property
    def run_itemsize(self) -> int:
        """Bytes of a value in a run."""
        return self.run_dtype.itemsize * self.components

    def one(self, data: bytes | memoryview) -> np.ndarray:
        """Decode a single value."""
        return np.frombuffer(data, self.dtype).reshape(self.shape)

    def run(self, data: bytes) -> np.ndarray:
        """Decode a run of values, (N) or (N, 3)."""
        return np.frombuffer(data, self.run_dtype).astype(self.dtype, copy=False).reshape(-1, *self.shape)


#: Supported trees, by the names of their types in files; all have the branching 32³, 16³, 8³.
VALUE_TYPES = {
    "Tree_float_5_4_3": ValueType(np.dtype("<f4"), 1),
    "Tree_double_5_4_3": ValueType(np.dtype("<f8"), 1),
    "Tree_int32_5_4_3": ValueType(np.dtype("<i4"), 1),
    "Tree_vec3s_5_4_3": ValueType(np.dtype("<f4"), 3),
    "Tree_vec3d_5_4_3": ValueType(np.dtype("<f8"), 3),
}


def read_run(cursor: Cursor, size: int, compression: int) -> bytes | memoryview:
    """Read and decompress a run of values of `size` bytes (before compression)."""
    if not compression & (ZIP | BLOSC):
        return cursor.take(size)
    (stored,) = cursor.unpack(_SIZE)
    if stored <= 0:  # data that do not shrink are stored uncompressed
        data = cursor.take(-stored)
    elif compression & BLOSC:
        data = _decompressed_by_blosc(cursor, cursor.take(stored), size)
    else:
        data = _decompressed_by_zlib(cursor, cursor.take(stored), size)
    if len(data) != size:
        raise InputError(f"{cursor.path}: damaged: {len(data)} bytes of values where {size} belong; export it again")
    return data


def written_run(data: bytes, itemsize: int, compression: int) -> bytes:
    """Encode a run, whose values have `itemsize` bytes each, as `read_run` reads it."""
    if not compression & (ZIP | BLOSC):
        return data
    if not data:
        return _SIZE.pack(0)
    if compression & BLOSC:
        compressed = blosc.compress(data, typesize=itemsize, clevel=_BLOSC_LEVEL, cname="lz4")
    else:
        compressed = zlib.compress(data)
    if len(compressed) >= len(data):
        return _SIZE.pack(-len(data)) + data
    return _SIZE.pack(len(compressed)) + compressed


def _decompressed_by_blosc(cursor: Cursor, data: memoryview, size: int) -> bytes:
    # The library allocates what the header claims, so check the claim first.
    if len(data) >= _BLOSC_HEADER.size:
        *_, claimed, _, compressed = _BLOSC_HEADER.unpack_from(data)
        if claimed == size and compressed == len(data):
            try:
                return blosc.decompress(bytes(data))
            except BloscError:
                pass
    raise InputError(f"{cursor.path}: damaged: values that blosc cannot decompress; export it again")


def _decompressed_by_zlib(cursor: Cursor, data: memoryview, size: int) -> bytes:
    try:
        return zlib.decompressobj().decompress(data, size + 1)
    except zlib.error as error:
        raise InputError(
            f"{cursor.path}: damaged: values that zlib cannot decompress ({error}); export it again"
        ) from None
