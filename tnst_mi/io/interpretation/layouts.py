"""The shapes in which programs store grids as arrays, brought to ours: (D, H, W) and (D, H, W, 3).

An axis of one entry at either end counts a batch or the channels, and is dropped; grids (H, W) are planes, D = 1.
Velocities may have their components last or first, planes two of them, and one entry more along each axis than there
are cells if they lie on the cells' faces (MAC grids): component c of entry i then is on the lower face of cell i.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.io.grids.uni import OBSTACLE_FLAG

#: Types of numbers that stand for 0 to 1, with their largest value: those of pictures.
_PICTURE_TYPES = {"uint8": 255, "uint16": 65535}

#: Larger values are no bits of cell types.
_LARGEST_FLAG = 1 << 24

Shape = tuple[int, ...]


def scalar_shape(shape: Shape) -> Shape | None:
    """The extents (D, H, W) or, of a plane, (H, W) of a scalar grid in an array of some shape; None if it is none.

    Example:
        >>> from tnst_mi.io.interpretation.layouts import scalar_shape
        >>> scalar_shape((1, 4, 6, 5, 1)), scalar_shape((6, 5)), scalar_shape((2, 4, 6, 5))
        ((4, 6, 5), (6, 5), None)
    """
    while len(shape) > 3:
        if shape[-1] == 1:
            shape = shape[:-1]
        elif shape[0] == 1:
            shape = shape[1:]
        else:
            return None
    return shape if len(shape) >= 2 else None


def is_vector_shape(shape: Shape, plane: bool) -> bool:
    """Whether an array of this shape can be a grid of vectors, or if `plane`, one of two or three components in 2-D."""
    extents = [extent for extent in shape if extent != 1]
    axes = (2, 3) if plane else (3,)
    return any(len(extents) in (size + 1 for size in axes) and extents[end] in axes for end in (0, -1))


def scalar_grid(array: np.ndarray, name: str) -> tuple[np.ndarray, str]:
    """A scalar grid (D, H, W), and in words how it was stored; "" if in just this shape.

    Raises:
        InputError: it is no scalar grid.
    """
    shape = scalar_shape(array.shape)
    if shape is None:
        raise InputError(f"{name} has shape {array.shape}, expected (D, H, W), one frame a file")
    if len(shape) == 2:
        return array.reshape(1, *shape), f"{name} {array.shape} is a plane seen face-on"
    return array.reshape(shape), "" if shape == array.shape else f"{name} {array.shape} is (D, H, W) = {shape}"


def velocity_grid(array: np.ndarray, cells: Shape) -> tuple[np.ndarray, str]:
    """A velocity (D, H, W, 3), or (D + 1, H + 1, W + 1, 3) on faces, and in words how it was stored; "" if just so.

    Args:
        array: the velocity as stored.
        cells: the shape (D, H, W) of its density.

    Raises:
        InputError: it does not fit the density.
    """
    faces = tuple(extent + 1 for extent in cells)
    wanted = (3, 2) if cells[0] == 1 else (3,)
    for axis in _ends(array.shape):
        rest = _without(array.shape, axis)
        if array.shape[axis] not in wanted:
            continue
        for shape in (cells, faces, (1, *faces[1:])):
            if _long(rest) == _long(shape) and (shape[0] > 1 or cells[0] == 1):
                vectors = _three(np.moveaxis(array, axis, -1).reshape(*shape, array.shape[axis]))
                if shape == (1, *faces[1:]):  # the faces of a plane: its upper layer is the same
                    vectors = np.concatenate([vectors, vectors])
                return vectors, "" if array.shape == (*cells, 3) else _described(array.shape, axis, shape != cells)
    raise InputError(
        f"velocity has shape {array.shape}, expected {(*cells, 3)} to fit the density; --velocity none goes without it"
    )


def velocity_of_components(arrays: Sequence[np.ndarray], names: Sequence[str], cells: Shape) -> tuple[np.ndarray, str]:
    """A velocity as `velocity_grid` gives it, from an array for each component: x, y and, unless in a plane, z.

    Each has the shape of the density, or one entry more along its own axis or along all of them.

    Raises:
        InputError: they do not fit the density.
    """
    if all(_long(array.shape) == _long(cells) for array in arrays):
        return _three(np.stack([array.reshape(cells) for array in arrays], axis=-1)), "velocity in components"
    faces = np.zeros((*(extent + 1 for extent in cells), 3), np.float32)
    for number, array in enumerate(arrays):
        own = tuple(extent + (axis == 2 - number) for axis, extent in enumerate(cells))
        shapes = (own, faces.shape[:3], (cells[0], *faces.shape[1:3]))
        shape = next((shape for shape in shapes if _long(array.shape) == _long(shape)), None)
        if shape is None:
            stored = ", ".join(f"{name} {array.shape}" for name, array in zip(names, arrays, strict=True))
            raise InputError(
                f"velocity components have shapes {stored}, expected {cells} of all to fit the density, or one entry "
                "more of all along their own axes; --velocity none goes without them"
            )
        faces[(*map(slice, shape), number)] = array.reshape(shape)
    return faces, "velocity in components, faces"


def fits(shape: Shape, cells: Shape) -> bool:
    """Whether an array of some shape holds a number, or a vector of three, for each cell of a density (D, H, W)."""
    if _long(shape) == _long(cells):
        return True
    return any(shape[axis] == 3 and _long(_without(shape, axis)) == _long(cells) for axis in _ends(shape))


def other_grid(array: np.ndarray, cells: Shape) -> np.ndarray:
    """An array that `fits`, as (D, H, W), or (D, H, W, 3) with the components last."""
    if _long(array.shape) == _long(cells):
        return array.reshape(cells)
    axis = next(
        axis
        for axis in _ends(array.shape)
        if array.shape[axis] == 3 and _long(_without(array.shape, axis)) == _long(cells)
    )
    return np.ascontiguousarray(np.moveaxis(array, axis, -1).reshape(*cells, 3))


def picture_scale(dtype: np.dtype) -> float | None:
    """The factor that takes the values of a type that pictures have to 0 to 1; None for other types."""
    largest = _PICTURE_TYPES.get(dtype.newbyteorder("=").name)
    return None if largest is None else 1.0 / largest


def solid_cells(values: np.ndarray, flags: bool = False) -> tuple[np.ndarray, str]:
    """Which cells are solid (bool), and in words how that was stored; "" for a mask of 0 and 1.

    Args:
        values: with the bits of Mantaflow's cells if `flags`; else 0 and 1, 0 and 255, or what lies between 0 and 1, or
            between 0 and 255 in bytes.
        flags: whether the grid is one of cell types.

    Raises:
        InputError: they are something else.
    """
    if values.size == 0:
        return np.zeros(values.shape, bool), ""
    low, high = float(values.min()), float(values.max())
    if flags and -_LARGEST_FLAG <= low <= high <= _LARGEST_FLAG:
        return (values.astype(np.int32) & OBSTACLE_FLAG) != 0, "obstacle is what flags mark as solid"
    byte = high > 1.0 and (values.dtype == np.uint8 or bool(((values == 0) | (values == 255)).all()))
    largest = 255.0 if byte else 1.0
    if not 0.0 <= low <= high <= largest:
        raise InputError(
            f"obstacle has values from {low:g} to {high:g}, values besides 0 and 1, expected a mask of 0 and 1; "
            "--obstacle none goes without it"
        )
    sharp = bool(((values == 0) | (values == largest)).all())
    return values > largest / 2, "" if sharp and not byte else f"obstacle is solid above {largest / 2:g}"


def _long(shape: Shape) -> Shape:
    """The extents of more than one entry."""
    return tuple(extent for extent in shape if extent != 1)


def _without(shape: Shape, axis: int) -> Shape:
    return shape[:axis] + shape[axis + 1 :]


def _ends(shape: Shape) -> list[int]:
    """The last and the first axis of more than one entry."""
    axes = [axis for axis, extent in enumerate(shape) if extent != 1]
    return [axes[-1], axes[0]] if axes else []


def _three(vectors: np.ndarray) -> np.ndarray:
    """Vectors with z = 0 if they have only x and y."""
    if vectors.shape[-1] == 3:
        return vectors
    return np.concatenate([vectors, np.zeros_like(vectors[..., :1])], axis=-1)


def _described(shape: Shape, axis: int, faces: bool) -> str:
    first = axis < len(shape) - 1 and _long(shape[:axis]) == ()
    words = [*(["components first"] if first else []), *(["faces, one more than cells"] if faces else [])]
    words += ["z is 0"] if shape[axis] == 2 else []
    return f"velocity {shape}" + (f": {', '.join(words)}" if words else " has axes of one entry")
