"""Where cameras may stand in the studio, and how far centred views zoom.

World units are those of the studio: the longest edge of the grid is 1, its centre is the origin and y is up.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Shape
from tnst_mi.rendering.cameras.camera import Camera
from tnst_mi.rendering.cameras.views import View, camera_frame, distance_of, text_of
from tnst_mi.rendering.looks import camera_distance

#: Distance of the ground below the grid, so that no ray starts on both.
GROUND_GAP = 2e-3

#: Margin around the grid's box in the picture, as a factor.
_MARGIN = 1.05

#: How near a shot's camera may be to the box of the smoke: its rays, which start at a small distance, start outside.
_CLEARANCE = 1e-3

#: The sine of the elevation up to which an orthographic camera sees the ground as a line.
_LEVEL = 1e-3

#: The nearest that a corner of the grid may be before the eye of a view, relative to the centre: see `field_of_view`.
_NEAREST = 1e-2


def ground_height(shape: Shape) -> float:
    """The y of the ground under a grid (D, H, W)."""
    return -shape[1] / max(shape) / 2 - GROUND_GAP


def stand(view: View, shape: Shape) -> tuple[float, float, float]:
    """(azimuth, elevation, distance) of the camera of a view of a grid (D, H, W), in degrees and world units.

    Args:
        view: with its distance in cells; views without one have that of the studio.
        shape: of the grid.

    Raises:
        InputError: the camera would be below the ground.
    """
    cells = distance_of(view)
    azimuth, elevation, distance = view[0], view[1], camera_distance() if cells is None else cells / max(shape)
    below = shape[1] / max(shape) / 2
    if distance * math.sin(math.radians(elevation)) <= -below:
        raise InputError(
            f"view {azimuth:g},{elevation:g}: the camera would be below the ground; "
            f"expected an elevation above {math.degrees(math.asin(-below / distance)):.1f}"
        )
    return azimuth, elevation, distance


def field_of_view(shape: Shape, views: Sequence[View], size: tuple[int, int]) -> float:
    """The horizontal angle in degrees at which pictures show a whole grid, plus a margin, in each of some views.

    Args:
        shape: (D, H, W) of the grid, at whose centre the camera looks.
        views: one or more.
        size: (width, height) of the pictures.

    Raises:
        InputError: a view is from below the ground, or so near that no picture shows all of the grid.
    """
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * shape[::-1] / max(shape)
    widest = 0.0
    for view in views:
        azimuth, elevation, distance = stand(view, shape)
        x, y, towards = (corners @ axis for axis in camera_frame(azimuth, elevation))
        before = distance - towards
        if before.min() < _NEAREST * distance:
            raise InputError(
                f"view {text_of(view)}: from so near no picture shows all of the grid; move the camera away"
            )
        slope = np.maximum(abs(x), abs(y) * size[0] / size[1]) / before
        widest = max(widest, float(slope.max()))
    return 2 * math.degrees(math.atan(_MARGIN * widest))


def shows_all(view: View, shape: Shape, size: tuple[int, int]) -> bool:
    """Whether a picture of the given (width, height) can show all of a grid (D, H, W) from a view in the studio."""
    try:
        field_of_view(shape, [view], size)
    except InputError:
        return False
    return True


def require_place(camera: Camera, low: np.ndarray, high: np.ndarray, ground: float) -> None:
    """Check that the rays of a shot's camera start above the ground and outside the smoke.

    Args:
        camera: in world units.
        low: the lowest corner (x, y, z) of the box that contains the smoke.
        high: the highest.
        ground: the y of the ground.

    Raises:
        InputError: they do not.
    """
    low, high = low - _CLEARANCE, high + _CLEARANCE
    if camera.perspective:
        starts = camera.position[None]
        inside = bool(((low < camera.position) & (camera.position < high)).all())
    else:
        starts = _picture_corners(camera)
        box = np.array(list(itertools.product(*zip(low, high, strict=True))))
        # In the camera's axes, where the picture is a rectangle at z = 0.
        first, last = ((points - camera.position) @ camera.axes.T for points in (box, starts))
        inside = bool(((first.min(0) < last.max(0)) & (last.min(0) < first.max(0))).all())
    if inside:
        raise InputError(
            "the camera is inside the box of the smoke, where no path can begin; move it away, or leave the look out"
        )
    if starts[:, 1].min() > ground + _CLEARANCE:
        return
    if camera.perspective:
        raise InputError(
            "the camera is below the studio's ground, which lies under the grid; raise it, or leave the look out"
        )
    # For rays that are level the ground is a line, wherever they start.
    if abs(camera.axes[2][1]) > _LEVEL:
        raise InputError(
            "a part of the orthographic camera's picture starts below the studio's ground, which lies under the grid; "
            "move the camera along its axis until none does, which does not move the picture, or leave the look out"
        )


def _picture_corners(camera: Camera) -> np.ndarray:
    """The corners (4, 3) of the picture of an orthographic camera, from which its rays start."""
    right, up, _ = camera.axes
    across, along = (
        np.array([-0.5, 0.5]) * edge - shift for edge, shift in zip((camera.aspect, 1.0), camera.shift, strict=True)
    )
    return np.array([camera.position + camera.field * (x * right + y * up) for x in across for y in along])
