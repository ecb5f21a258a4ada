"""The camera of a shot in the world of the renderer, and where it sees the smoke of each frame from."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Shape
from tnst_mi.geometry.placement import Placement
from tnst_mi.io.cameras.reading import Cameras, read_cameras
from tnst_mi.io.cameras.scene_camera import SceneCamera
from tnst_mi.recipe.combinations import require_unmirrored
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.camera import Camera
from tnst_mi.rendering.cameras.views import View

#: Where frames without a place in a scene lie: a cell is the unit, and the first one is at the origin.
_UNPLACED = Placement(up="y")


class Placed(Protocol):
    """What is needed of a frame: its number, and where it lies in its scene."""

    @property
    def number(self) -> int | float | None:
        """The number of the frame, or None if it has none."""
        ...

    @property
    def placement(self) -> Placement | None:
        """Where its grid lies."""
        ...


@dataclass(frozen=True)
class ShotView:
    """Where a shot's camera sees the smoke of a frame from.

    Attributes:
        view: the centred view from there, which the camera's zoom, pan, roll and shift do not change (paper 4.1).
        inside: whether the camera is inside the grid: the view is then from where its direction leaves the grid.
    """

    view: View
    inside: bool


def camera_in_cells(camera: SceneCamera, placement: Placement | None, shape: Shape) -> Camera:
    """A camera of a scene in the renderer's world: full-resolution cells, the origin at the centre of the grid.

    Args:
        camera: in the axes of the placement's scene.
        placement: of the grid; None if its scene is its own, in cells.
        shape: (D, H, W) of the grid.
    """
    cells = (placement or _UNPLACED).to_scene(shape).inverse()
    to_world = np.eye(4)
    to_world[:3, :3] = cells.matrix
    to_world[:3, 3] = cells.offset - (np.array(shape[::-1]) - 1) / 2
    in_scene = Camera(tuple(map(tuple, camera.to_scene)), camera.perspective, camera.field, camera.aspect, camera.shift)
    return in_scene.moved(to_world)


def camera_of(cameras: Cameras, frame: Placed, shape: Shape) -> Camera:
    """The camera of a frame in the renderer's world.

    Raises:
        InputError: the frame has none.
    """
    up = (frame.placement or _UNPLACED).up
    return camera_in_cells(cameras.at(frame.number, up), frame.placement, shape)


def shot_view(camera: Camera, shape: Shape) -> ShotView:
    """Where a camera in the renderer's world sees a grid of shape (D, H, W) from.

    Raises:
        InputError: it is at the centre of the grid, from which there is no direction.
    """
    view = camera.centred_view
    if len(view) == 2:
        return ShotView(view, False)
    azimuth, elevation, distance = view
    direction = np.abs(camera.position) / distance
    half = np.array(shape[::-1]) / 2
    # How far it is from the centre to the side of the box that lies in this direction.
    leaves = float((half[direction > 0] / direction[direction > 0]).min())
    return ShotView((azimuth, elevation, max(distance, leaves)), distance < leaves)


def shot_views(recipe: Recipe, frames: Iterable[Placed], shape: Shape) -> list[ShotView]:
    """Where the camera of a recipe sees the smoke of each frame from; empty if the recipe names none.

    Args:
        recipe: with absolute paths.
        frames: the frames of the run.
        shape: (D, H, W) of their grids.

    Raises:
        InputError: the file of the camera cannot be read, or has none for a frame, or the smoke is mirrored.
    """
    if recipe.camera is None:
        return []
    require_unmirrored(recipe.flip)
    cameras = read_cameras(recipe.camera)
    views = []
    for frame in frames:
        camera = camera_of(cameras, frame, shape)
        try:
            views.append(shot_view(camera, shape))
        except InputError as error:
            raise InputError(f"{recipe.camera}: frame {frame.number}: {error}") from None
    return views


def with_shots(recipe: Recipe, views: Iterable[ShotView]) -> Recipe:
    """A recipe whose views are around those of a shot, frame by frame."""
    return replace(recipe, shots=tuple(shot.view for shot in views))
