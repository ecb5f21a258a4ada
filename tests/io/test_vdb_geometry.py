"""Voxels of any size, place and direction: read on one grid of cubes, and written back where they were."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tnst_mi.frame import Frame
from tnst_mi.geometry.affine import Affine
from tnst_mi.io import open_frames, save_frames
from tnst_mi.io.grids.vdb import DenseGrid, read_vdb, write_vdb
from tnst_mi.io.interpretation.conventions import Conventions
from tnst_mi.io.sequence import FrameFiles

FIRST = (3, -2, 5)
TURNS = [
    np.diag(signs) @ np.eye(3)[list(order)]
    for order in itertools.permutations(range(3))
    for signs in itertools.product((1.0, -1.0), repeat=3)
]


def turned_about_z(angle: float) -> np.ndarray:
    """Cubes with edges of 0.1, turned by an angle in radians."""
    return 0.1 * np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])


ROTATED = turned_about_z(np.radians(30.0))


def ball(size: int = 14, radius: float = 5.0) -> np.ndarray:
    """A smooth ball of smoke (Z, Y, X)."""
    z, y, x = np.indices((size,) * 3) - (size - 1) / 2
    return np.clip(1.2 - np.sqrt(x**2 + (0.8 * y) ** 2 + z**2) / radius, 0, 1).astype(np.float32)


def written(path: Path, scene: Affine, density: np.ndarray | None = None, velocity: np.ndarray | None = None) -> None:
    density = ball() if density is None else density
    grids = [DenseGrid("density", density, FIRST, transform=scene)]
    if velocity is not None:
        grids.append(DenseGrid("vel", velocity, FIRST, transform=scene))
    write_vdb(path, grids, {})


def sampled(path: Path, points: np.ndarray) -> np.ndarray:
    """The density of a file at points of the scene, by trilinear interpolation between its own voxels."""
    grid = read_vdb(path).grids[0]
    box = grid.tree.active_box()
    low = box[0] - 2
    values = grid.tree.values_in((low, box[1] + 2))
    at = (points - grid.affine.offset) @ np.linalg.inv(grid.affine.matrix).T - low
    at = np.clip(at, 0, np.array(values.shape[::-1]) - 1.001)
    base = np.floor(at).astype(int)
    total = np.zeros(len(points))
    for corner in itertools.product((0, 1), repeat=3):
        weight = np.prod(np.where(corner, at - base, 1 - (at - base)), axis=1)
        x, y, z = (base + corner).T
        total += weight * values[z, y, x]
    return total


def points_in(path: Path, count: int = 1000) -> np.ndarray:
    grid = read_vdb(path).grids[0]
    low, high = grid.tree.active_box()
    voxels = np.random.default_rng(0).uniform(low - 1, high + 1, (count, 3))
    return voxels @ grid.affine.matrix.T + grid.affine.offset


@settings(max_examples=25)
@given(st.sampled_from(TURNS))
def test_turned_and_mirrored_cubes_are_permuted(tmp_path_factory: pytest.TempPathFactory, turn: np.ndarray) -> None:
    folder = tmp_path_factory.mktemp("turned")
    rng = np.random.default_rng(2)
    density = rng.random((3, 4, 5)).astype(np.float32) + 0.1
    velocity = rng.normal(size=(3, 4, 5, 3)).astype(np.float32)
    scene = Affine(0.5 * turn, np.array([1.0, 2.0, 3.0]))
    written(folder / "a.vdb", scene, density, velocity)
    frames = open_frames(folder / "a.vdb", given=Conventions(velocity_units="cells-per-frame"))
    frame = frames[0]
    assert frames.grid_notes == ()
    corner, edge = np.array(frame.placement.corner), frame.placement.voxel_size
    assert edge == 0.5
    for z, y, x in np.ndindex(density.shape):
        place = scene(np.add(FIRST, (x, y, z)))
        i, j, k = np.rint((place - corner) / edge).astype(int)
        assert frame.density[k, j, i] == density[z, y, x]
        # OpenVDB's vectors have components along the scene's axes, unless they say otherwise.
        np.testing.assert_array_equal(frame.velocity[k, j, i], velocity[z, y, x])
    save_frames(folder / "b.vdb", frame)
    grid = read_vdb(folder / "b.vdb").grids[0]
    np.testing.assert_array_equal(grid.affine.matrix, scene.matrix)
    box = np.array(FIRST), np.add(FIRST, (4, 3, 2))
    np.testing.assert_array_equal(grid.tree.values_in(box), density)


@pytest.mark.parametrize("edges", [(0.5, 0.5, 0.5), (0.1, 0.4, 0.2)])
def test_velocities_of_the_voxels_axes_turn_with_them(edges: tuple[float, ...], tmp_path: Path) -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # a quarter turn: X becomes Y
    scene = Affine(turn * edges, np.zeros(3))
    values = np.zeros((5, 5, 5, 3), np.float32)
    values[...] = (2.0, 0.5, -3.0)
    for metadata in ({"is_local_space": ("bool", True)}, {"class": ("string", "staggered")}):
        grids = [
            DenseGrid("density", np.ones((5, 5, 5), np.float32), transform=scene),
            DenseGrid("vel", values, transform=scene, metadata=metadata),
        ]
        write_vdb(tmp_path / "a.vdb", grids, {})
        data = (tmp_path / "a.vdb").read_bytes()
        # The writer has a class of its own; vectors on faces are those of other programs.
        if "class" in metadata:
            at = data.rindex(b"unknown")
            data = data[: at - 4] + b"\x09\0\0\0staggered" + data[at + 7 :]
            shift = 2
            header = data.index(b"Tree_vec3s_5_4_3") + 16 + 4
            offsets = np.add(np.frombuffer(data[header : header + 24], "<i8"), (0, shift, shift))
            data = data[:header] + offsets.astype("<i8").tobytes() + data[header + 24 :]
            (tmp_path / "a.vdb").write_bytes(data)
        frame = open_frames(tmp_path / "a.vdb", given=Conventions(velocity_units="cells-per-frame"))[0]
        # (X, Y, Z) = (-0.5, 2, -3), up y as the file says nothing else.
        wanted = np.broadcast_to([-0.5, 2.0, -3.0], frame.velocity.shape)
        inside = frame.density > 0.5
        np.testing.assert_allclose(frame.velocity[inside], wanted[inside], rtol=1e-5)
        place = "on the faces of its own voxels, brought to the cells," if "class" in metadata else "at centres"
        assert f"velocity {place} in cells-per-frame" in frame.reading


@pytest.mark.parametrize(
    ("scene", "said"),
    [
        (Affine(ROTATED, np.array([10.0, -2.0, 0.5])), "0.1×0.1×0.1, turned or sheared"),
        (Affine(np.diag([0.1, 0.15, 0.1]), np.zeros(3)), "0.1×0.15×0.1; results return"),
        (Affine(0.1 * np.array([[1, 0.4, 0], [0, 1, 0], [0, 0.2, 1]]), np.zeros(3)), "turned or sheared"),
        (Affine(np.diag([0.1, 0.1005, 0.1]), np.array([1.0, 2.0, 3.0])), "taken as cubes: their edges differ by 0.50%"),
        (Affine(np.diag([0.1, 0.1006, 0.1]), np.zeros(3)), "0.1×0.1006×0.1; results return"),
        # A third of a degree moves the far end of 256 voxels by more than one.
        (Affine(turned_about_z(np.radians(0.3)), np.zeros(3)), "0.1×0.1×0.1, turned or sheared"),
    ],
    ids=["rotated", "unequal", "sheared", "almost cubes", "hardly cubes", "hardly rotated"],
)
def test_other_maps_are_resampled_and_come_back_as_they_were(scene: Affine, said: str, tmp_path: Path) -> None:
    written(tmp_path / "a.vdb", scene)
    frames = open_frames(tmp_path / "a.vdb")
    frame, (note,) = frames[0], frames.grid_notes
    assert said in note and ("resampled" in note) == ("taken as cubes" not in said)
    # The frame is the smoke of the file, sampled at its cubes.
    if "resampled" in note:
        z, y, x = np.indices(frame.density.shape).reshape(3, -1)
        places = np.stack([x, y, z], axis=1) * frame.placement.voxel_size + frame.placement.corner
        np.testing.assert_allclose(frame.density.ravel(), sampled(tmp_path / "a.vdb", places), atol=2e-5)
        assert frame.mass * frame.placement.voxel_size**3 == pytest.approx(
            ball().sum() * abs(np.linalg.det(scene.matrix)), rel=0.02
        )
    # Where nothing changed, the file comes back value by value, on its own voxels.
    save_frames(tmp_path / "b.vdb", frame)
    points = points_in(tmp_path / "a.vdb")
    np.testing.assert_allclose(sampled(tmp_path / "b.vdb", points), sampled(tmp_path / "a.vdb", points), atol=1e-5)
    np.testing.assert_array_equal(read_vdb(tmp_path / "b.vdb").grids[0].affine.matrix, scene.matrix)
    # A change appears in its place, and nowhere else.
    changed = frame.density.copy()
    half = changed.shape[2] // 2
    changed[..., half:] *= 0.5
    save_frames(tmp_path / "c.vdb", Frame(changed, placement=frame.placement, name="c"))
    split = frame.placement.corner[0] + (half - 0.5) * frame.placement.voxel_size
    far = np.abs(points[:, 0] - split) > 2 * frame.placement.voxel_size
    ratio = np.where(points[:, 0] > split, 0.5, 1.0)
    before, after = sampled(tmp_path / "a.vdb", points[far]), sampled(tmp_path / "c.vdb", points[far])
    np.testing.assert_allclose(after, before * ratio[far], atol=0.06)
    left = far & (points[:, 0] < split)
    np.testing.assert_allclose(
        sampled(tmp_path / "c.vdb", points[left]), sampled(tmp_path / "a.vdb", points[left]), atol=1e-5
    )


def sequence(folder: Path, *scenes: Affine) -> FrameFiles:
    for number, scene in enumerate(scenes):
        written(folder / f"s_{number:04d}.vdb", scene, ball(), np.ones((14, 14, 14, 3), np.float32))
    return open_frames(folder)


def test_sizes_that_change_from_frame_to_frame(tmp_path: Path) -> None:
    scenes = [Affine.scaling(0.3), Affine.scaling(0.2727), Affine.scaling(0.3)]
    frames = sequence(tmp_path, *scenes)
    assert len({frame.density.shape for frame in frames}) == 1
    assert {frame.placement.voxel_size for frame in frames} == {0.3}
    (note,) = frames.grid_notes
    assert "resampled to cubes of 0.3: the voxels of s_0001.vdb are 0.2727×0.2727×0.2727" in note
    # Lengths per second become cells of the run's size in all frames.
    for frame in frames:
        np.testing.assert_allclose(frame.velocity[frame.density > 0.5], 1 / 24 / 0.3, rtol=1e-5)
    for number, scene in enumerate(scenes):
        save_frames(tmp_path / "out.vdb", frames[number])
        grid, original = read_vdb(tmp_path / "out.vdb").grids[0], read_vdb(frames.files[number]).grids[0]
        assert grid.voxel_size == scene.edge
        box = original.tree.active_box()
        np.testing.assert_array_equal(grid.tree.values_in(box), original.tree.values_in(box))
    # A frame by itself keeps the size of its file.
    alone = open_frames(frames.files[1])
    assert alone[0].density.shape == (14, 14, 14) and alone.grid_notes == ()


def test_transforms_that_move_by_whole_voxels_are_exact(tmp_path: Path) -> None:
    frames = sequence(tmp_path, *(Affine.scaling(0.1, (0.2 * number, 0.0, -0.1 * number)) for number in range(3)))
    assert frames.grid_notes == ()
    for number, frame in enumerate(frames):
        x, z = 2 * number, 2 - number
        np.testing.assert_array_equal(frame.density[z : z + 14, :, x : x + 14], ball())
    assert frames[0].density.shape == (16, 14, 18)


def test_velocities_cells_of_their_own(tmp_path: Path) -> None:
    # A field that is linear in the scene is the same whatever its grid.
    for edge, offset in ((0.2, 0.05), (0.1, 0.05), (0.05, 0.0)):
        count = round(3.0 / edge)
        z, y, x = np.indices((count,) * 3) * edge + offset - 0.5
        velocity = np.stack([x + 5.0, 2 * y - z + 5.0, z + 5.0], axis=-1).astype(np.float32)
        grids = [
            DenseGrid("density", ball(), (0, 0, 0), 0.1),
            DenseGrid("vel", velocity, (0, 0, 0), edge, (offset - 0.5,) * 3),
        ]
        write_vdb(tmp_path / "a.vdb", grids, {})
        frames = open_frames(tmp_path / "a.vdb")
        (note,) = frames.grid_notes
        assert "velocity resampled to the cells of 0.1" in note
        x0, y0, z0 = frames[0].placement.corner
        z, y, x = np.indices(frames[0].density.shape) * 0.1
        x, y, z = x + x0, y + y0, z + z0
        expected = np.stack([x + 5.0, 2 * y - z + 5.0, z + 5.0], axis=-1) / 24 / 0.1
        np.testing.assert_allclose(frames[0].velocity, expected, rtol=1e-4)


def test_the_origin_moves_results(tmp_path: Path) -> None:
    written(tmp_path / "a.vdb", Affine(ROTATED, np.zeros(3)))
    frame = open_frames(tmp_path / "a.vdb", given=Conventions(origin=(5.0, -1.0, 2.0)))[0]
    save_frames(tmp_path / "b.vdb", frame)
    grid = read_vdb(tmp_path / "b.vdb").grids[0]
    np.testing.assert_allclose(grid.affine.offset, [5.0, -1.0, 2.0])
    points = points_in(tmp_path / "a.vdb")
    moved = sampled(tmp_path / "b.vdb", points + np.array([5.0, -1.0, 2.0]))
    np.testing.assert_allclose(moved, sampled(tmp_path / "a.vdb", points), atol=1e-5)


def test_the_origin_moves_every_grid(tmp_path: Path) -> None:
    """Of those that are found again in the file too, moved with the smoke or not."""
    ones, origin = np.ones((3, 4, 5), np.float32), (5.0, -1.0, 2.0)
    kinds = {"density": "", "flame": "", "surface": "level set", "obstacle": ""}
    grids = [DenseGrid(name, ones, (2, 0, 1), 0.5, (1.0, 0.0, 0.0), grid_class=kind) for name, kind in kinds.items()]
    vectors = np.ones((3, 4, 5, 3), np.float32)
    grids += [DenseGrid(name, vectors, (2, 0, 1), 0.5, (1.0, 0.0, 0.0)) for name in ("velocity", "force")]
    write_vdb(tmp_path / "a.vdb", grids, {})
    frame = open_frames(tmp_path / "a.vdb", given=Conventions(origin=origin))[0]
    save_frames(tmp_path / "b.vdb", frame)
    again = {grid.name: grid.affine(grid.topology.active_box()[0]) for grid in read_vdb(tmp_path / "b.vdb").grids}
    assert set(again) == {grid.name for grid in grids}
    for lowest in again.values():
        np.testing.assert_allclose(lowest, [7.0, -1.0, 2.5])


def test_placed_by_a_frustum(tmp_path: Path) -> None:
    written(tmp_path / "a.vdb", Affine.scaling(0.5))
    data = (tmp_path / "a.vdb").read_bytes()
    (tmp_path / "a.vdb").write_bytes(data.replace(b"UniformScaleMap", b"FrustumMapOther"))
    with pytest.raises(
        Exception, match=r"a\.vdb: grid 'density' is placed by a FrustumMapOther, expected an affine map"
    ):
        open_frames(tmp_path / "a.vdb")[0]
