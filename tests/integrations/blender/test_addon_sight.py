"""Whether cameras see a box: from the numbers of their tables alone."""

from __future__ import annotations

import itertools
from typing import Any

import blender_addon  # noqa: F401  (makes tnst_mi_blender importable)
import pytest
from tnst_mi_blender.scene.sight import may_see

#: Looks along −z from 10 above the origin, through a picture that is 2 · 10 · tan 15° = 5.36 high there, and 10.7 wide.
FROM_ABOVE = {
    "matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 10], [0, 0, 0, 1]],
    "fov": 30.0,
    "aspect": 2.0,
    "shift": [0.0, 0.0],
}
PARALLEL = {key: value for key, value in FROM_ABOVE.items() if key != "fov"} | {"height": 5.36}
#: Looks along +x: its −z axis is the world's x.
SIDEWAYS = FROM_ABOVE | {"matrix": [[0, 0, -1, -10], [-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]}


def box(x: float, y: float, z: float) -> list[tuple[float, ...]]:
    return list(itertools.product((x - 0.1, x + 0.1), (y - 0.1, y + 0.1), (z - 0.1, z + 0.1)))


@pytest.mark.parametrize(
    ("camera", "place", "seen"),
    [
        (FROM_ABOVE, (0, 0, 0), True),
        (FROM_ABOVE, (5.2, 0, 0), True),
        (FROM_ABOVE, (5.6, 0, 0), False),
        (FROM_ABOVE, (0, -2.6, 0), True),
        (FROM_ABOVE, (0, -3.0, 0), False),
        (FROM_ABOVE, (0, -3.0, -5), True),
        (FROM_ABOVE, (0, 0, 11), False),
        (PARALLEL, (0, -3.0, -5), False),
        (PARALLEL, (5.2, 2.6, -50), True),
        (SIDEWAYS, (0, -5.2, 0), True),
        (SIDEWAYS, (0, -5.6, 0), False),
        (SIDEWAYS, (0, 0, -3.0), False),
        (SIDEWAYS, (-10.2, 0, 0), False),
    ],
)
def test_a_box_is_seen(camera: dict[str, Any], place: tuple[float, float, float], seen: bool) -> None:
    assert may_see(camera, box(*place)) is seen


def test_the_axis_of_a_shifted_camera_meets_its_picture_off_the_middle() -> None:
    """At 0.5 of the height to the right of the middle, what is seen is to the left of the axis."""
    camera = FROM_ABOVE | {"shift": [0.5, 0.0]}
    assert may_see(camera, box(-7.9, 0, 0)) and not may_see(camera, box(2.9, 0, 0))
