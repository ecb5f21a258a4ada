"""Pictures of the smoke before and after its stylization, side by side."""

from __future__ import annotations

import numpy as np

from tnst_mi.losses.pictures import resized

#: White columns between the two pictures, in their own pixels (before enlargement).
_GAP = 2

#: Pictures of small grids are enlarged to at least this many rows.
_LEAST_HEIGHT = 400


def side_by_side(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Join two pictures (H, W) with values in [0, 1] by a white gap, enlarged by an integer factor."""
    rows, columns = before.shape
    scale = -(-_LEAST_HEIGHT // rows)
    # Enlarged before they are joined: interpolation would blend the gap into their edges.
    left, right = (resized(image, scale * rows, scale * columns) for image in (before, after))
    return np.concatenate([left, np.ones((scale * rows, scale * _GAP), left.dtype), right], axis=1)
