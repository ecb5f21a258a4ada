"""The metadata of OpenVDB files and grids, and the transforms from voxels to the scene.

Sources: `openvdb/Metadata.h`, `openvdb/math/Maps.h`.
"""

from __future__ import annotations

import struct

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.io.grids.vdb.cursor import Cursor

#: A metadata value: a string, a number, or three numbers.
Value = str | bool | int | float | tuple[int, ...] | tuple[float, ...]

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

# Voxels count as cubes aligned with the scene's axes up to this fraction of their size.
_TOLERANCE = 1e-4


def read_metadata(cursor: Cursor) -> dict[str, Value]:
    """Read metadata by name; values of unknown types are skipped.

    Raises:
        InputError: the data are damaged.
    """
    (count,) = cursor.unpack(_COUNT)
    if count > _LARGEST_COUNT:
        raise InputError(f"{cursor.path}: damaged: {count} named values")
    values: dict[str, Value] = {}
    for _ in range(count):
        name, kind = cursor.string(), cursor.string()
        (size,) = cursor.unpack(_COUNT)
        data = cursor.take(size)
        if kind == "string":
            values[name] = bytes(data).decode("utf-8", "replace")
        elif kind in _LAYOUTS and _LAYOUTS[kind].size == size:
            numbers = _LAYOUTS[kind].unpack(data)
            values[name] = numbers[0] if len(numbers) == 1 else numbers
    return values


def written_metadata(values: dict[str, tuple[str, Value]]) -> bytes:
    """Encode (type, value) by name as `read_metadata` reads it."""
    data = _COUNT.pack(len(values))
    for name, (kind, value) in values.items():
        if isinstance(value, str):
            content = value.encode("utf-8")
        else:
            content = _LAYOUTS[kind].pack(*(value if isinstance(value, tuple) else (value,)))
        data += written_string(name) + written_string(kind) + _COUNT.pack(len(content)) + content
    return data


def written_string(text: str) -> bytes:
    """Encode a string: its length, then its bytes."""
    encoded = text.encode("utf-8")
    return _COUNT.pack(len(encoded)) + encoded


def read_transform(cursor: Cursor) -> tuple[float, tuple[float, float, float]]:
    """Read the transform from voxels to the scene: the edge of a voxel, and the position of voxel (0, 0, 0).

    Raises:
        InputError: voxels are not cubes aligned with the scene's axes, or the data are damaged.
    """
    kind = cursor.string()
    scale, translation = np.eye(3), np.zeros(3)
    if kind in ("AffineMap", "UnitaryMap"):
        matrix = np.array(cursor.unpack(_MATRIX)).reshape(4, 4)  # acts on row vectors
        scale, translation = matrix[:3, :3], matrix[3, :3]
    elif kind in ("UniformScaleMap", "ScaleMap", "UniformScaleTranslateMap", "ScaleTranslateMap", "TranslationMap"):
        if "Transla" in kind:
            translation = np.array(cursor.unpack(_VECTOR))
        if "Scale" in kind:
            scale = np.diag(cursor.unpack(_VECTOR))
            cursor.take(4 * _VECTOR.size)  # the voxel size, and inverses derived from it
    else:
        raise InputError(f"{cursor.path}: voxels placed by a {kind!r}, expected scaling and translation; resample it")
    edge = float(scale[0, 0])
    if not (np.isfinite(scale).all() and np.isfinite(translation).all() and edge > 0.0):
        raise InputError(f"{cursor.path}: voxels of size {edge:g} or placed nowhere, expected positive numbers")
    if np.abs(scale - edge * np.eye(3)).max() > _TOLERANCE * edge:
        raise InputError(
            f"{cursor.path}: voxels that are turned or no cubes (matrix {scale.round(6).tolist()}), "
            "expected cubes along the axes; resample the grid"
        )
    x, y, z = map(float, translation)
    return edge, (x, y, z)


def written_transform(edge: float, translation: tuple[float, float, float]) -> bytes:
    """Encode a transform as `read_transform` reads it."""
    vectors = [(value,) * 3 for value in (edge, edge, 1.0 / edge, 1.0 / edge**2, 0.5 / edge)]
    kind = "UniformScaleMap"
    if any(translation):
        kind, vectors = "UniformScaleTranslateMap", [translation, *vectors]
    return written_string(kind) + b"".join(_VECTOR.pack(*vector) for vector in vectors)
