"""The outline of smoke in its main view, and how far its cells may be moved so that the outline stays where it is.

A cell may be moved `keep` full-resolution cells, or as far as it lies inside the outline as seen, if that is farther.
Smoke that comes to a place outside the outline then started at most `keep` from there, and what comes to a place
deeper inside than `keep` started inside: the outline neither grows nor retreats by more, whatever happens within. This
holds for a straight step. Along the flow it holds too, since a path slows down as it nears the outline: one that starts
deeper inside than `keep` does not reach the band of that width within a frame.
"""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np

from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.views import camera_frame
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

#: Opacity of a pixel from which on it counts as smoke.
_SEEN = 0.05

#: Where smoke starts and where it arrives may each be half a diagonal from the centre of the pixel that stands for it.
_PIXELS = math.sqrt(2)


def displacement_allowed(density: np.ndarray, recipe: Recipe, size: tuple[int, int], keep: float) -> np.ndarray:
    """How far each cell may be moved: (D, H, W) float32, in full-resolution cells, `keep` or more.

    Args:
        density: (D, H, W) of the unstylized frame at full resolution, in the run's unit.
        recipe: of the frame, with γ per full-resolution cell.
        size: rows and columns of images that show the frame.
        keep: by how much the outline may move, in full-resolution cells.
    """
    renderer = EmissionAbsorptionRenderer(density.shape, recipe.extinction, "transmittance", 1.0, size=size)
    view = recipe.main_view
    opacity = renderer.render(mi.TensorXf(density), [view]).numpy()[0]
    inside = distance_inside(opacity > _SEEN)
    z, y, x = (np.arange(n) - (n - 1) / 2 for n in density.shape)
    down, across, towards = (
        axis[2] * z[:, None, None] + axis[1] * y[:, None] + axis[0] * x
        for right, up, viewer in [camera_frame(*view[:2])]
        for axis in (-up, right, viewer)
    )
    nearness = np.ones_like(down) if len(view) == 2 else _magnification(towards, view[2])
    row, column = (
        np.rint((place * nearness + (n - 1) / 2).clip(-1, n)).astype(np.int64)
        for place, n in ((down, size[0]), (across, size[1]))
    )
    shown = (row >= 0) & (row < size[0]) & (column >= 0) & (column < size[1]) & (nearness > 0)
    depth = np.where(shown, inside[row.clip(0, size[0] - 1), column.clip(0, size[1] - 1)], 0) - _PIXELS
    if len(view) == 3:
        depth = _in_cells(depth, np.hypot(down, across), nearness, view[2])
    return np.maximum(depth, keep).astype(np.float32)


def _magnification(towards: np.ndarray, distance: float) -> np.ndarray:
    """By what a perspective view enlarges what is so much nearer to it than the centre; 0 for what is behind it."""
    ahead = distance - towards
    return np.where(ahead > 0, distance / np.where(ahead > 0, ahead, 1.0), 0.0)


def _in_cells(pixels: np.ndarray, off_axis: np.ndarray, nearness: np.ndarray, distance: float) -> np.ndarray:
    """How far a place may be moved in any direction so that its image in a perspective view moves so many pixels.

    An image at D x/z, with z ahead of the viewer at distance D, is moved by D(x' z + x z')/(z(z − z')) by a movement of
    x' across and z' towards the viewer: at most D L √(z² + x²)/(z(z − L)) by one of length L, which is solved for L.

    Args:
        pixels: how far the image may move, (D, H, W).
        off_axis: distance x of the places from the axis of the view, in cells.
        nearness: D/z, above 0 where they are ahead of the viewer.
        distance: D.
    """
    ahead = np.where(nearness > 0, distance / np.where(nearness > 0, nearness, 1.0), np.inf)
    return np.where(nearness > 0, pixels / (nearness * np.hypot(1.0, off_axis / ahead) + pixels / ahead), 0.0)


def distance_inside(mask: np.ndarray) -> np.ndarray:
    """The distance of each pixel of a mask (H, W) to the nearest one outside it, in pixels; 0 outside.

    What lies beyond the image is outside. Exact: the least of column distances² + row offsets² (Felzenszwalb and
    Huttenlocher 2012, without their envelope, as images are small).
    """
    padded = np.pad(mask, 1)
    rows = np.arange(padded.shape[0])
    # By column, the distance to the nearest row outside, which the border is at the latest.
    above = rows[:, None] - np.maximum.accumulate(np.where(padded, 0, rows[:, None]), axis=0)
    below = np.minimum.accumulate(np.where(padded, rows[-1], rows[:, None])[::-1], axis=0)[::-1] - rows[:, None]
    square = np.minimum(above, below).astype(np.float64) ** 2
    offsets = np.subtract.outer(np.arange(padded.shape[1]), np.arange(padded.shape[1])).astype(np.float64) ** 2
    nearest = np.stack([(row + offsets).min(axis=1) for row in square])
    return np.sqrt(nearest)[1:-1, 1:-1]
