"""The box around the smoke."""

from __future__ import annotations

import numpy as np

from tnst_mi.fields.bounds import hull, smoke_box


def test_the_box_holds_the_smoke_and_its_margin_inside_the_grid() -> None:
    density = np.zeros((8, 9, 10))
    density[2, 3, 9] = density[4, 6, 5] = 1e-30
    assert smoke_box(density, 0) == (slice(2, 5), slice(3, 7), slice(5, 10))
    assert smoke_box(density, 2) == (slice(0, 7), slice(1, 9), slice(3, 10))
    assert smoke_box(np.zeros((2, 3, 4)), 1) is None


def test_the_hull_of_boxes_is_the_box_of_all_their_smoke() -> None:
    densities = np.zeros((3, 6, 7, 8))
    densities[0, 1, 2, 3] = densities[1, 4, 0, 5] = densities[2, 2, 6, 1] = 1.0
    boxes = [box for density in densities if (box := smoke_box(density, 1)) is not None]
    assert len(boxes) == 3 and hull(boxes) == smoke_box(densities.max(axis=0), 1)
