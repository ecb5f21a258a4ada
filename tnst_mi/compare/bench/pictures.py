"""A folder of OpenEXR pictures as a side: rendered by any program, as many independent renders of each view as it has.

They count as they are stored, of films with alpha too: the light that reaches the camera, nothing divided by alpha.
`NAME.exr` is one render of the only view; with several views, `0_NAME.exr` is one of the first, `1_NAME.exr` of the
second. A single render of a view is taken as free of noise.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from tnst_mi.compare.bench.batches import Batches
from tnst_mi.compare.bench.variants import LUMINANCE
from tnst_mi.errors import InputError
from tnst_mi.io.pictures.exr import read_premultiplied

#: Values of all pictures together, at most.
_MOST = 1 << 26


def pictures(folder: Path, shape: tuple[int, int, int, int]) -> Batches:
    """(batches, V, H, W, C) of the pictures in a folder.

    Args:
        folder: the folder.
        shape: (V, H, W, C) of the images that they are compared with; of C = 1 the luminance.

    Raises:
        InputError: there are none, views have different numbers of them, or one is damaged, has other rows and columns,
            or values that are not finite.
    """
    views, rows, columns, channels = shape
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() == ".exr")
    by_view = [files] if views == 1 else [[p for p in files if _view(p) == view] for view in range(views)]
    counts = sorted({len(found) for found in by_view})
    if counts == [0] or len(counts) > 1:
        expected = "" if views == 1 else f"; with {views} views, as many named 0_….exr as 1_….exr and so on"
        raise InputError(f"{folder}: {len(files)} OpenEXR pictures, expected one or more of each view{expected}")
    if rows * columns * channels * len(files) > _MOST:
        raise InputError(f"{folder}: {len(files)} pictures are more than can be compared at once; leave some out")
    values = np.array([[_read(path, rows, columns, channels) for path in found] for found in by_view], np.float64)
    return Batches(np.moveaxis(values, 1, 0))


def _view(path: Path) -> int | None:
    found = re.match(r"(\d{1,4})_", path.name)
    return int(found[1]) if found else None


def _read(path: Path, rows: int, columns: int, channels: int) -> np.ndarray:
    picture = read_premultiplied(path, _MOST)[..., :3].astype(np.float64)
    if picture.shape[:2] != (rows, columns):
        found = f"{picture.shape[1]}×{picture.shape[0]}"
        raise InputError(f"{path}: has {found} pixels, expected {columns}×{rows} as on the other side")
    if not np.isfinite(picture).all():
        raise InputError(f"{path}: has values that are not finite, expected finite ones")
    return picture @ np.array(LUMINANCE)[:, None] if channels == 1 else picture
