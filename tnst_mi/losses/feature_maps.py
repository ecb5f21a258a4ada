"""Maps of features to match (the M of paper Eq. 5): reading them from npz files, resampling them to an octave."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from torch import Tensor
from torch.nn import functional

from tnst_mi.errors import InputError
from tnst_mi.io.grids.npz import read_arrays, read_headers
from tnst_mi.machine.terminal import quoted, shortened, some_of

#: Name of the array in a file that has several.
KEY = "map"

#: Largest map that is read, in values: 16 times those of the largest layer for the paper's 200×300 pixels.
LARGEST_MAP = 1 << 26


def read_map(path: str | Path) -> np.ndarray:
    """Read a map (C, H, W), or what broadcasts to one, as float32: the array `map` of an npz file, or its only array.

    Raises:
        InputError: the file is missing or damaged, does not tell which array is meant, or the array has more than
            three axes, more than `LARGEST_MAP` values or none, or a value that is not finite.
    """
    path = Path(path)
    headers = read_headers(path)
    name = next(iter(headers)) if len(headers) == 1 else KEY
    if name not in headers:
        names = some_of([shortened(name) for name in sorted(headers)]) or "nothing"
        raise InputError(f"{path}: holds {names}, expected an array {KEY!r}")
    shape = headers[name].shape
    if len(shape) > 3 or not 0 < math.prod(shape) <= LARGEST_MAP:
        raise InputError(
            f"{path}: array {quoted(name)} has shape {shape}, expected a map (C, H, W) of 1 to {LARGEST_MAP} values"
        )
    # Values that overflow float32 become infinite here and are reported as such.
    with np.errstate(over="ignore"):
        found = read_arrays(path, [name])[name].astype(np.float32)
    if bad := int((~np.isfinite(found)).sum()):
        raise InputError(
            f"{path}: {bad} of {found.size} values of array {quoted(name)} are not finite in single precision"
        )
    return found


def resampled(target: Tensor, shape: Sequence[int], name: str) -> Tensor:
    """A map, resampled to the features of a layer: linearly where it grows, by averages over areas where it shrinks.

    Args:
        target: (C, H, W), or what broadcasts to that; (C,) for a layer without positions.
        shape: of the features of one view: (C, H, W), or (C,) for a layer without positions.
        name: of the term, for errors.

    Returns:
        The map in the given shape, but for the channels if there is one for all.

    Raises:
        InputError: the map has other channels than the layer, or more axes.
    """
    channels, *size = shape
    whole = target
    if target.ndim < 3:
        # As broadcasting does, in front; but what a layer without positions has is its channels.
        missing = (1,) * (3 - target.ndim)
        whole = target.reshape(*missing, *target.shape) if size else target.reshape(*target.shape, *missing)
    if whole.ndim != 3 or whole.shape[0] not in (1, channels) or not (size or whole.shape[1:] == (1, 1)):
        raise InputError(
            f"{name}: the map has shape {tuple(target.shape)}, expected {channels} channels, or 1 for all, as the "
            f"layer has: {tuple(shape)}"
        )
    if not size:
        return whole[:, 0, 0]
    smaller = (min(whole.shape[1], size[0]), min(whole.shape[2], size[1]))
    averaged = functional.adaptive_avg_pool2d(whole, smaller)
    return functional.interpolate(averaged[None], size, mode="bilinear")[0]
