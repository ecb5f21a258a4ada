"""Whether a camera sees anything of a box; on plain numbers, without Blender."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any


def may_see(camera: Mapping[str, Any], corners: Sequence[Sequence[float]]) -> bool:
    """Whether a box may be in the picture of a camera.

    Args:
        camera: its table in a file of cameras, as `export_camera.camera_table` makes it.
        corners: those of the box, (x, y, z) each, in the space in which the camera is.

    Returns:
        False only if all of the box is behind the camera, or beyond one side of its picture.
    """
    matrix = camera["matrix"]
    place = [row[3] for row in matrix[:3]]
    # In the camera's own space, where it looks along −z: a rotation's inverse is its transpose.
    own = [
        [sum(matrix[row][axis] * (corner[row] - place[row]) for row in range(3)) for axis in range(3)]
        for corner in corners
    ]
    if all(-corner[2] <= 0 for corner in own):
        return False
    perspective = "fov" in camera
    height = 2 * math.tan(math.radians(camera["fov"]) / 2) if perspective else camera["height"]
    for axis, side in ((0, height * camera["aspect"]), (1, height)):
        middle = -camera["shift"][axis] * height
        reach = [(corner[axis], -corner[2] if perspective else 1.0) for corner in own]
        if all(at < (middle - side / 2) * far for at, far in reach):
            return False
        if all(at > (middle + side / 2) * far for at, far in reach):
            return False
    return True
