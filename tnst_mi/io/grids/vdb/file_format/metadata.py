"""The metadata of OpenVDB files and grids, and the transforms from voxels to the scene.

Sources: `openvdb/Metadata.h`, `openvdb/math/Maps.h`.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.geometry.affine import Affine
from tnst_mi.io.grids.vdb.file_format.cursor import Cursor

#: A metadata value: a string, a number, or three numbers.
Value = str | bool | int | float | tuple[int, ...] | tuple[float, ...]

#: Metadata as stored, the name of the type and the bytes by name: what is of a type unknown here can be written again.
Stored = dict[str, tuple[str, bytes]]

_COUNT = struct.Struct("<I")
_LARGEST_COUNT = 10_000

# Binary layouts of the numeric types.
_LAYOUTS = {
    "bool": struct.Struct("<?"),
    "int32": struct.Struct("<i"),
    "int64": struct.Struct("<q"),
    "float": struct.Struct("<f"),
    "double": struct.Struct("<d"),
    "vec3i": struct.Struct("<3i"),
    "vec3s": struct.Struct("<3f"),
    "vec3d": struct.Struct("<3d"),
}

_VECTOR = struct.Struct("<3d")
_MATRIX = struct.Struct("<16d")

_MATRICES = ("AffineMap", "UnitaryMap")

_SCALES = ("UniformScaleMap", "ScaleMap", "UniformScaleTranslateMap", "ScaleTranslateMap")


def read_metadata(cursor: Cursor) -> Stored:
    """Read metadata as they are stored, by name.

    Raises:
        InputError: the data are damaged.
    """
    (count,) = cursor.unpack(_COUNT)
    if count > _LARGEST_COUNT:
        raise InputError(f"{cursor.path}: damaged: {count} named values; export it again")
    stored: Stored = {}
    for _ in range(count):
        name, kind = cursor.string(), cursor.string()
        (size,) = cursor.unpack(_COUNT)
        stored[name] = kind, bytes(cursor.take(size))
    return stored


def values_of(stored: Stored) -> dict[str, Value]:
    """The values of stored metadata by name, but for those of unknown types."""
    values: dict[str, Value] = {}
    for name, (kind, data) in stored.items():
        if kind == "string":
            values[name] = data.decode("utf-8", "replace")
        elif kind in _LAYOUTS and _LAYOUTS[kind].size == len(data):
            numbers = _LAYOUTS[kind].unpack(data)
            values[name] = numbers[0] if len(numbers) == 1 else numbers
    return values


def written_metadata(values: Mapping[str, tuple[str, Any]]) -> bytes:
    """Encode (type, value) by name as `read_metadata` reads it: a `Value`, or bytes as they were stored."""
    data = _COUNT.pack(len(values))
    for name, (kind, value) in values.items():
        if isinstance(value, bytes):
            content = value
        elif isinstance(value, str):
            content = value.encode("utf-8")
        else:
            content = _LAYOUTS[kind].pack(*(value if isinstance(value, tuple) else (value,)))
        data += written_string(name) + written_string(kind) + _COUNT.pack(len(content)) + content
    return data


def written_string(text: str) -> bytes:
    """Encode a string: its length, then its bytes."""
    encoded = text.encode("utf-8")
    return _COUNT.pack(len(encoded)) + encoded


def read_transform(cursor: Cursor) -> Affine | str:
    """Read the transform from voxels to the scene; the name of its kind if that is not affine.

    Raises:
        InputError: the data are damaged, or place voxels nowhere or all in one plane.
    """
    kind = cursor.string()
    matrix, offset = np.eye(3), np.zeros(3)
    if kind in _MATRICES:
        stored = np.array(cursor.unpack(_MATRIX)).reshape(4, 4)  # acts on row vectors
        matrix, offset = stored[:3, :3].T.copy(), stored[3, :3].copy()
    elif kind in _SCALES or kind == "TranslationMap":
        if "Transla" in kind:
            offset = np.array(cursor.unpack(_VECTOR))
        if kind in _SCALES:
            matrix = np.diag(cursor.unpack(_VECTOR))
            cursor.take(4 * _VECTOR.size)  # the voxel size, and inverses derived from it
    else:
        return kind
    transform = Affine(matrix, offset)
    if not transform.places_voxels:
        raise InputError(
            f"{cursor.path}: voxels along {matrix.T.tolist()} from {offset.tolist()}, flat or placed nowhere, expected "
            "a map from voxels to the scene that can be inverted; export the grid again"
        )
    return transform


def written_transform(transform: Affine) -> bytes:
    """Encode a transform as `read_transform` reads it, in the most specific kind of map."""
    edge = float(transform.matrix[0, 0])
    if (transform.matrix != edge * np.eye(3)).any() or edge < 0.0:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[3, :3] = transform.matrix.T, transform.offset
        return written_string("AffineMap") + _MATRIX.pack(*matrix.ravel())
    vectors = [(value,) * 3 for value in (edge, edge, 1.0 / edge, 1.0 / edge**2, 0.5 / edge)]
    kind = "UniformScaleMap"
    if transform.offset.any():
        kind, vectors = "UniformScaleTranslateMap", [transform.offset.tolist(), *vectors]
    return written_string(kind) + b"".join(_VECTOR.pack(*vector) for vector in vectors)
