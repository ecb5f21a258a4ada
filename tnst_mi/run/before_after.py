"""Pictures of the smoke before and after its stylization, side by side."""

from __future__ import annotations

import numpy as np

from tnst_mi.losses.pictures import resized

#: White columns between the two pictures, in their own pixels (before enlargement).
_GAP = 2

#: Pictures of small grids are enlarged to at least this many rows, as far as both fit into this many columns.
_LEAST_HEIGHT, _WIDEST = 400, 1920

#: Wider ones are reduced to this many columns: encoders and viewers have their limits.
_MOST_COLUMNS = 8192


def side_by_side(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Join two pictures (H, W) or (H, W, 3) with values in [0, 1] by a white gap, enlarged by an integer factor."""
    rows, columns = before.shape[:2]
    joined = 2 * columns + _GAP
    scale = max(1, min(-(-_LEAST_HEIGHT // rows), _WIDEST // joined)) if joined <= _MOST_COLUMNS else 1
    height, width = scale * rows, scale * columns
    if joined > _MOST_COLUMNS:
        width = (_MOST_COLUMNS - _GAP) // 2
        height = max(1, round(rows * width / columns))
    # Enlarged before they are joined: interpolation would blend the gap into their edges.
    left, right = (resized(image, height, width) for image in (before, after))
    gap = np.ones((height, scale * _GAP, *left.shape[2:]), left.dtype)
    return np.concatenate([left, gap, right], axis=1)
