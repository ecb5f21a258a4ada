"""Cameras of scenes in the renderer's world, and where they see the smoke from."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.geometry.placement import Placement
from tnst_mi.io.cameras.scene_camera import SceneCamera, looking
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.regions.shapes import cell_positions
from tnst_mi.rendering.cameras.camera import Camera
from tnst_mi.rendering.cameras.shots import camera_in_cells, shot_view, shot_views, with_shots
from tnst_mi.rendering.cameras.views import camera_frame
from tnst_mi.rendering.columns import views_around
from tnst_mi.rendering.levels import full_level, levels_of

SHAPE = (9, 14, 11)


def projected(to_world: np.ndarray, points: np.ndarray, perspective: bool, field: float) -> np.ndarray:
    """Oracle: where points (n, 3) are in the picture, in parts of its height from where the axis meets it."""
    local = (points - to_world[:3, 3]) @ to_world[:3, :3]
    half = np.tan(np.radians(field) / 2) * -local[:, 2:] if perspective else field / 2
    return local[:, :2] / (2 * half)


@pytest.mark.parametrize("perspective", [True, False])
@pytest.mark.parametrize(
    "placement", [None, Placement(0.25, (3.0, -2.0, 7.0), "z"), Placement(2.0, (1.0, 2.0, 3.0), "y")]
)
def test_a_camera_in_cells_sees_every_cell_where_it_lies_in_the_scene(
    placement: Placement | None, perspective: bool
) -> None:
    scene = np.stack(np.broadcast_arrays(*cell_positions(SHAPE, placement)), axis=-1).reshape(-1, 3)
    size = 1.0 if placement is None else placement.voxel_size
    eye, up = scene.mean(axis=0) + size * np.array([40.0, -25.0, 31.0]), np.array([0.1, 0.2, 1.0])
    pose = looking(eye, scene[17], up)
    field = 33.0 if perspective else 21.0 * size
    camera = camera_in_cells(SceneCamera(pose, perspective, field, 1.6, (0.1, -0.2)), placement, SHAPE)
    z, y, x = np.indices(SHAPE)
    cells = np.stack([x, y, z], axis=-1).reshape(-1, 3) - (np.array(SHAPE[::-1]) - 1) / 2
    seen = projected(np.array(camera.to_world), cells, perspective, camera.field)
    np.testing.assert_allclose(seen, projected(pose, scene, perspective, field), atol=1e-9)
    assert (camera.aspect, camera.shift, camera.perspective) == (1.6, (0.1, -0.2), perspective)


def camera_at(position: tuple[float, float, float], target: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Camera:
    pose = looking(np.array(position), np.array(target), np.array([0.0, 1.0, 0.0]))
    return Camera(tuple(map(tuple, pose)), True, 30.0, 1.0)


def test_a_view_is_where_the_camera_stands_whatever_it_looks_at() -> None:
    angle = math.radians(30)
    place = (40 * math.sin(angle), 30.0, 40 * math.cos(angle))
    for target in ((0.0, 0.0, 0.0), (5.0, -3.0, 1.0)):
        shot = shot_view(camera_at(place, target), SHAPE)
        assert shot.view == pytest.approx((30.0, math.degrees(math.atan2(30, 40)), 50.0)) and not shot.inside


@pytest.mark.parametrize("share", [1.001, 1.0, 0.999, 0.5, 0.01])
def test_a_camera_inside_the_grid_sees_from_where_its_direction_leaves_it(share: float) -> None:
    """(4.5, 5.6, 2) is on the side z = 4.5 of the box of half edges (5.5, 7, 4.5)."""
    side = np.array([2.0, 5.6, 4.5])
    shot = shot_view(camera_at(tuple((share * side).tolist()), (9.0, 9.0, -9.0)), SHAPE)
    at_side = shot_view(camera_at(tuple(side.tolist()), (9.0, 9.0, -9.0)), SHAPE).view
    assert shot.view[:2] == pytest.approx(at_side[:2])
    assert shot.view[2] == pytest.approx(max(share, 1.0) * float(np.linalg.norm(side)))
    assert shot.inside == (share < 1)


def written(folder: Path, text: str) -> Recipe:
    (folder / "shot.toml").write_text(text, "utf-8")
    return Recipe(camera=str(folder / "shot.toml"))


def test_views_follow_a_box_that_moves_with_the_smoke(tmp_path: Path) -> None:
    """A still camera, in a scene whose z is up; the second box lies 8 units farther along X."""
    recipe = written(tmp_path, "fov = 30\naspect = 1\nposition = [0, -10, 0]\ntarget = [1, 0, 0]\n")
    middle = np.array([5.0, 4.0, 6.5])
    frames = []
    for number, x in ((1, 0.0), (2, 8.0)):
        corner = np.array([x, 0.0, 0.0]) - 0.5 * middle
        frames.append(
            Frame(np.ones(SHAPE, np.float32), number=number, placement=Placement(0.5, tuple(corner.tolist())))
        )
    first, second = (shot.view for shot in shot_views(recipe, frames, SHAPE))
    assert first == pytest.approx((0.0, 0.0, 20.0), abs=1e-9)
    assert second == pytest.approx((-math.degrees(math.atan2(8, 10)), 0.0, 2 * math.hypot(8, 10)), abs=1e-9)


def test_a_frame_without_a_camera_and_one_at_the_centre_are_refused(tmp_path: Path) -> None:
    frames = [Frame(np.ones(SHAPE, np.float32), number=number) for number in (1, 2)]
    keyed = written(tmp_path, "fov = 30\naspect = 1\n[frames.1]\nposition = [0, 0, 50]\ntarget = [0, 0, 0]\n")
    with pytest.raises(InputError, match="no camera for frame 2; the nearest is 1"):
        shot_views(keyed, frames, SHAPE)
    centre = written(tmp_path, "fov = 30\naspect = 1\nposition = [5, 6.5, 4]\ntarget = [0, 0, 0]\n")
    with pytest.raises(InputError, match=r"frame 1: .* centre"):
        shot_views(centre, frames, SHAPE)
    assert shot_views(Recipe(), frames, SHAPE) == []


def test_images_that_fit_have_room_for_the_grid_from_the_nearest_shot() -> None:
    """Oracle: the farthest corner's image in any view of either frame, of the full grid and of an octave."""
    recipe = Recipe(fit=True, shots=((20.0, 10.0, 40.0), (60.0, -5.0, 30.0)), azimuth=(-6, 6), elevation=(-3, 3))
    corners = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3), axis=-1).reshape(-1, 3) * SHAPE[::-1]
    for level in (full_level(recipe, SHAPE), levels_of(dataclasses.replace(recipe, octaves=2), SHAPE)[0]):
        for shot in recipe.shots:
            for across, above in ((-6, -3), (0, 0), (6, 3), (6, -3), (-6, 3)):
                right, up, towards = camera_frame(shot[0] + across, shot[1] + above)
                nearness = shot[2] / (shot[2] - corners @ towards) / level.pixel
                assert np.abs(corners @ up * nearness).max() <= level.size[0] / 2 + 1e-6
                assert np.abs(corners @ right * nearness).max() <= level.size[1] / 2 + 1e-6
    with pytest.raises(InputError, match="no image shows all of a grid"):
        full_level(dataclasses.replace(recipe, shots=((0.0, 0.0, 4.6),)), SHAPE)


def test_ranges_are_offsets_around_the_shot() -> None:
    recipe = Recipe(azimuth=(-10, 30), elevation=(0, 4), shots=((50.0, 20.0, 99.0),))
    assert recipe.main_view == (60.0, 22.0, 99.0)
    views = np.array(views_around(recipe))
    np.testing.assert_allclose(views.min(axis=0), [40, 20, 99])
    np.testing.assert_allclose(views.max(axis=0), [80, 24, 99])
    flat = dataclasses.replace(recipe, shots=((50.0, 20.0), (-70.0, 10.0)))
    assert flat.main_view == (60.0, 22.0)
    assert flat.view_ranges == ((-80.0, 80.0), (10.0, 24.0)), "of all frames"
    assert with_shots(recipe, []).main_view == (10.0, 2.0)
