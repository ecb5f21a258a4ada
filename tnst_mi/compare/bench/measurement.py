from __future__ import annotations
from collections.abc import Sequence
import numpy as np
from tnst_mi.compare.bench.batches import Batches
from tnst_mi.compare.bench.decision import Family, family

_CHANNELS = {1: ("",), 3: (", red", ", green", ", blue")}


def value_families(
    where: str, left: Batches, right: Batches, tolerance: float, views: Sequence[str] | None = None
) -> list[Family]:
    """The tests of images: the mean of each view, tiles of it, and pixels.

    Args:
        where: what the images are of, for labels.
        left, right: (batches, V, H, W, C).
        tolerance: difference that does not count, relative to the RMS of a view.
        views: names of the views.
    """
    _, count, rows, columns, channels = left.values.shape
    names = [f"view {name}" for name in (views or map(str, range(count)))]
    parts = _CHANNELS[channels]
    size = np.sqrt(np.maximum(left.mean**2, right.mean**2).mean((1, 2, 3)))
    allowance = tolerance * size
    prefix = f"{where}, " if where else ""
    tiles = left.tiles().values.shape[2:4]
    return [
        family(
            "means",
            [f"{prefix}{v}, mean{c}" for v in names for c in parts],
            left.means(),
            right.means(),
            allowance[:, None],
        ),
        family(
            "tiles",
            [f"{prefix}{v}, tile {y},{x}{c}" for v in names for y, x in np.ndindex(*tiles) for c in parts],
            left.tiles(),
            right.tiles(),
            allowance[:, None, None, None],
        ),
        family(
            "pixels",
            [
                f"{prefix}{v}, row {y}, column {x}{c}"
                for v in names
                for y, x in np.ndindex(rows, columns)
                for c in parts
            ],
            left,
            right,
            allowance[:, None, None, None],
        ),
    ]
