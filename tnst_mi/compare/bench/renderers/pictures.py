"""A folder of OpenEXR pictures as a side: rendered by any program, as many independent renders of each view as it has.

They count as they are stored, of films with alpha too: the light that reaches the camera, nothing divided by alpha.
`NAME.exr` is one render of the only view; with several views, `0_NAME.exr` is one of the first, `1_NAME.exr` of the
second. A single render of a view is taken as free of noise, and two that are the same are refused.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tnst_mi.compare.bench.renderers.variants import LUMINANCE
from tnst_mi.compare.bench.statistics.batches import Batches
from tnst_mi.errors import InputError
from tnst_mi.io.pictures.exr import read_premultiplied

#: Values of all pictures together, at most.
_MOST = 1 << 26

#: Fewer renders than this are said to be few.
_FEW = 8


def pictures(folder: Path, shape: tuple[int, int, int, int]) -> tuple[Batches, list[str]]:
    """(batches, V, H, W, C) of the pictures in a folder, and what they do not show, or not certainly.

    Args:
        folder: the folder; files whose names begin with a dot are none of its pictures.
        shape: (V, H, W, C) of the images that they are compared with; of C = 1 the luminance.

    Raises:
        InputError: there are none, views have different numbers of them, two are the same, or one is damaged, has other
            rows and columns, or values that are not finite.
    """
    views, rows, columns, channels = shape
    files = sorted(p for p in folder.iterdir() if p.suffix.lower() == ".exr" and not p.name.startswith("."))
    _require_one_side(folder, files)
    by_view = [files] if views == 1 else [[p for p in files if _view(p) == view] for view in range(views)]
    counts = sorted({len(found) for found in by_view})
    if counts == [0] or len(counts) > 1:
        expected = "" if views == 1 else f"; with {views} views, as many named 0_….exr as 1_….exr and so on"
        raise InputError(f"{folder}: {len(files)} OpenEXR pictures, expected one or more of each view{expected}")
    if others := [path for path in files if not any(path in found for found in by_view)]:
        raise InputError(f"{others[0]}: is of none of the {views} views, expected 0_….exr to {views - 1}_….exr")
    if rows * columns * channels * len(files) > _MOST:
        raise InputError(f"{folder}: {len(files)} pictures are more than can be compared at once; leave some out")
    read = [[_read(path, rows, columns) for path in found] for found in by_view]
    for found, values in zip(by_view, read, strict=True):
        _require_independent(found, values)
    remarks = _remarks(folder, counts[0])
    colours = np.array(read)
    if channels == 1:
        if (colours != colours[..., :1]).any():
            remarks.append(f"colours of {folder}: luminance alone is compared")
        colours = np.broadcast_to(colours, (*colours.shape[:-1], 3)) @ np.array(LUMINANCE)[:, None]
    ends = (0.0, math.inf) if colours.min() >= 0 else (-math.inf, math.inf)
    return Batches(np.moveaxis(colours, 1, 0), ends=ends), remarks


def _require_one_side(folder: Path, files: Sequence[Path]) -> None:
    """Refuse what a comparison has written, for the means of both sides would be taken as renders of one."""
    if all(any(path.stem.endswith(side) for path in files) for side in ("_left", "_right")):
        raise InputError(f"{folder}: has pictures of a left and a right side, expected those of one renderer")


def _require_independent(files: Sequence[Path], values: Sequence[np.ndarray]) -> None:
    seen: dict[bytes, Path] = {}
    for path, picture in zip(files, values, strict=True):
        first = seen.setdefault(hashlib.sha256(picture.tobytes()).digest(), path)
        if first != path:
            raise InputError(
                f"{path}: is the same picture as {first.name}, expected independent renders; leave one of a renderer "
                "without noise"
            )


def _remarks(folder: Path, count: int) -> list[str]:
    if count == 1:
        return [f"noise of {folder}: it has one picture of each view, taken as exact"]
    if count < _FEW:
        return [f"small differences from {folder}: {count} renders tell little of their noise; {_FEW} or more do"]
    return []


def _view(path: Path) -> int | None:
    found = re.match(r"(\d{1,4})_", path.name)
    return int(found[1]) if found else None


def _read(path: Path, rows: int, columns: int) -> np.ndarray:
    """(rows, columns, 1 or 3)."""
    picture = read_premultiplied(path, _MOST)[..., :3].astype(np.float64)
    if picture.shape[:2] != (rows, columns):
        found = f"{picture.shape[1]}×{picture.shape[0]}"
        raise InputError(f"{path}: has {found} pixels, expected {columns}×{rows} as on the other side")
    if not np.isfinite(picture).all():
        raise InputError(f"{path}: has values that are not finite, expected finite ones")
    return picture
