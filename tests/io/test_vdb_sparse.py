"""Smoke in large and empty boxes: cropped, followed, its stray voxels named; what is read grows with the smoke."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import mitsuba as mi
import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import open_frames, save_frames
from tnst_mi.io.grids.vdb import DenseGrid, read_vdb, write_vdb
from tnst_mi.io.grids.vdb.clumps import clumps_of, stray
from tnst_mi.io.grids.vdb.run_grid import REACH
from tnst_mi.io.interpretation.conventions import Boxing, Conventions
from tnst_mi.io.sequence import FrameFiles
from tnst_mi.optimisation.mask import soft_mask
from tnst_mi.optimisation.temporal.alignment import transported_sums
from tnst_mi.optimisation.temporal.window import reading_order, window_of, window_weights

CROP = Conventions(velocity_units="cells-per-frame", box=Boxing(crop=True))
NO_STRAY = Conventions(box=Boxing(crop=True, ignore_stray=True))
SMOKE = np.random.default_rng(0).random((10, 12, 14)).astype(np.float32) + 0.5


def domain(low: tuple[int, int, int], high: tuple[int, int, int]) -> dict[str, tuple[str, tuple[int, int, int]]]:
    return {"tnst_mi_box_min": ("vec3i", low), "tnst_mi_box_max": ("vec3i", high)}


#: A domain with room around smoke that travels.
ROOM = domain((-9, -9, -9), (119, 29, 29))


def travelling(
    folder: Path,
    *firsts: tuple[int, int, int],
    names: tuple[str, ...] = (),
    told: Mapping[str, tuple[str, tuple[int, int, int]]] = MappingProxyType({}),
) -> FrameFiles:
    velocity = np.zeros((*SMOKE.shape, 3), np.float32)
    velocity[..., 0] = 30.0
    for number, first in enumerate(firsts):
        name = names[number] if names else f"s_{number:04d}"
        write_vdb(folder / f"{name}.vdb", [DenseGrid("density", SMOKE, first), DenseGrid("vel", velocity, first)], told)
    return open_frames(folder, given=CROP)


def as_staggered(folder: Path) -> None:
    """Mark the vectors of all files as those on faces, as Blender writes them."""
    for path in folder.glob("*.vdb"):
        file = read_vdb(path)
        data = path.read_bytes()
        at = data.rindex(b"unknown")
        data = data[: at - 4] + b"\x09\0\0\0staggered" + data[at + 7 :]
        header = data.index(b"Tree_vec3s_5_4_3") + 16 + 4
        offsets = np.add(np.frombuffer(data[header : header + 24], "<i8"), (0, 2, 2))
        assert len(file.grids) == 2  # those of a later grid would have to move too
        path.write_bytes(data[:header] + offsets.astype("<i8").tobytes() + data[header + 24 :])


def window_sum(frames: Sequence[Frame], index: int) -> np.ndarray:
    """The densities of a window of three frames, transported to one of them and averaged."""
    window = window_of(index, len(frames), 3)

    def neighbours() -> Iterator[tuple[dict[str, mi.TensorXf], mi.TensorXf]]:
        for i in reading_order(index, window):
            yield {"f": mi.TensorXf(frames[i].density)}, mi.TensorXf(frames[i if i < index else i - 1].velocity)

    own = {"f": mi.TensorXf(frames[index].density)}
    return transported_sums(own, window_weights(3), window, index, neighbours(), 1.0)["f"].numpy()


def test_the_reach_is_that_of_the_mask() -> None:
    density = np.zeros((31, 1, 1), np.float32)
    density[15] = 1e6
    reached = np.flatnonzero(soft_mask(density).ravel())
    assert reached[-1] - 15 == 15 - reached[0] == REACH


def test_a_grid_is_cropped_to_the_smoke_and_what_it_reaches(tmp_path: Path) -> None:
    write_vdb(tmp_path / "a.vdb", [DenseGrid("density", SMOKE, (20, 30, 1))], domain((0, 0, 0), (99, 99, 99)))
    frames = open_frames(tmp_path / "a.vdb", given=CROP)
    frame = frames[0]
    # Along z the domain ends one cell below the smoke.
    assert frame.density.shape == (1 + 10 + REACH, 12 + 2 * REACH, 14 + 2 * REACH)
    np.testing.assert_array_equal(frame.density[1:11, REACH:-REACH, REACH:-REACH], SMOKE)
    assert frame.placement.corner == (15.0, 25.0, 0.0)
    (note,) = frames.grid_notes
    assert "cropped to the smoke of all frames and 5 cells around it: 24 × 22 × 16 of 100 × 100 × 100 cells" in note
    assert "--crop off" in note
    save_frames(tmp_path / "b.vdb", frame)
    grid = read_vdb(tmp_path / "b.vdb").grids[0]
    box = np.array([20, 30, 1]), np.array([33, 41, 10])
    np.testing.assert_array_equal(grid.tree.values_in(box), SMOKE)
    assert grid.tree.active_voxels == SMOKE.size
    assert open_frames(tmp_path / "a.vdb")[0].density.shape == (100, 100, 100)


def test_a_grid_stays_where_cropping_saves_less_than_half(tmp_path: Path) -> None:
    write_vdb(tmp_path / "a.vdb", [DenseGrid("density", SMOKE, (3, 3, 3))], domain((0, 0, 0), (23, 23, 23)))
    frames = open_frames(tmp_path / "a.vdb", given=CROP)
    assert frames[0].density.shape == (24, 24, 24) and frames.grid_notes == ()


def test_a_box_moves_with_the_smoke(tmp_path: Path) -> None:
    firsts = [(0, 0, 0), (31, 0, 0), (60, 2, 0)]
    frames = travelling(tmp_path, *firsts)
    low = []
    for frame, first in zip(frames, firsts, strict=True):
        assert frame.density.shape == frames[0].density.shape
        low.append(np.array(frame.placement.corner).astype(int))
        x, y, z = first - low[-1]
        np.testing.assert_array_equal(frame.density[z : z + 10, y : y + 12, x : x + 14], SMOKE)
        assert frame.mass == pytest.approx(float(SMOKE.sum()), rel=1e-6)
    assert any("moves with it in whole cells" in note for note in frames.grid_notes)
    # A velocity leads from a place in one box to the place in the next: x + v − low(t + 1) = x − low(t) + v − Δ.
    for number in (0, 1):
        moved = low[number + 1] - low[number]
        smoke = frames[number].density > 0
        np.testing.assert_array_equal(frames[number].velocity[smoke], np.tile([30, 0, 0] - moved, (smoke.sum(), 1)))
    # No frame follows the last one: the smoke goes on as before.
    np.testing.assert_array_equal(frames[2].velocity, np.broadcast_to([30, 0, 0] - moved, frames[2].velocity.shape))
    # At rest, the box holds all of it.
    rest = open_frames(tmp_path, given=Conventions(velocity_units="cells-per-frame"))
    assert rest[0].density.shape == (10, 14, 74)
    np.testing.assert_array_equal(rest[0].velocity[0, 0, 0], [30, 0, 0])


def test_cells_without_velocity_move_with_the_smoke(tmp_path: Path) -> None:
    """Counted as at rest in the scene, they would fall behind the box by 30 cells per frame."""
    frames = travelling(tmp_path, (0, 0, 0), (31, 0, 0), (62, 0, 0), told=ROOM)
    for frame in frames:
        assert frame.velocity is not None and not (frame.density > 0).all()
        np.testing.assert_array_equal(frame.velocity, np.broadcast_to(np.float32([-1, 0, 0]), frame.velocity.shape))


def test_a_velocity_on_faces_is_relative_where_it_is_known(tmp_path: Path) -> None:
    velocity = np.random.default_rng(1).normal(size=(*SMOKE.shape, 3)).astype(np.float32) + np.float32([30, 0, 0])
    for number in range(2):
        first = (31 * number, 0, 0)
        grids = [DenseGrid("density", SMOKE, first), DenseGrid("vel", velocity, first)]
        write_vdb(tmp_path / f"s_{number:04d}.vdb", grids, ROOM)
    as_staggered(tmp_path)
    moving = open_frames(tmp_path, given=CROP)
    rest = open_frames(tmp_path, given=Conventions(velocity_units="cells-per-frame"))
    for frame, still in zip(moving, rest, strict=True):
        assert "velocity on faces" in frame.reading and "velocity on faces" in still.reading
        inside, smoke = frame.density > 0, still.density > 0
        np.testing.assert_allclose(frame.velocity[inside] + [31, 0, 0], still.velocity[smoke], atol=1e-5)
        outside = frame.velocity[~inside]
        average = np.average(frame.velocity[inside], axis=0, weights=frame.density[inside])
        np.testing.assert_allclose(outside, np.broadcast_to(average, outside.shape), atol=1e-5)


def test_steps_are_transported_in_a_moving_box_as_in_one_at_rest(tmp_path: Path) -> None:
    """At rest with a velocity everywhere, moving with one in the smoke alone: the sums are the same, to the last frame.

    By whole cells: MacCormack's correction depends on how far smoke moves through its grid, its steps by whole cells
    are exact.
    """
    firsts = [(0, 0, 0), (31, 1, 0), (62, 2, 0), (93, 3, 0)]
    own = np.float32([32.0, 0.0, -1.0])
    everywhere = np.broadcast_to(own, (39, 39, 129, 3)).copy()
    (tmp_path / "moving").mkdir()
    (tmp_path / "rest").mkdir()
    for number, first in enumerate(firsts):
        smoke = DenseGrid("density", SMOKE, first)
        inside = DenseGrid("vel", np.broadcast_to(own, (*SMOKE.shape, 3)).copy(), first)
        write_vdb(tmp_path / "moving" / f"s_{number}.vdb", [smoke, inside], ROOM)
        write_vdb(tmp_path / "rest" / f"s_{number}.vdb", [smoke, DenseGrid("vel", everywhere, (-9, -9, -9))], ROOM)
    moving = list(open_frames(tmp_path / "moving", given=CROP))
    rest = list(open_frames(tmp_path / "rest", given=Conventions(velocity_units="cells-per-frame")))
    assert rest[0].density.shape == everywhere.shape[:3] and moving[0].density.size < rest[0].density.size / 2
    for frame in range(len(firsts)):
        x, y, z = np.array(moving[frame].placement.corner, int) + 9
        depth, height, width = moving[frame].density.shape
        expected = window_sum(rest, frame)[z : z + depth, y : y + height, x : x + width]
        np.testing.assert_allclose(window_sum(moving, frame), expected, atol=2e-6)


def test_what_a_moving_box_is_converted_to_moves_in_the_scene(tmp_path: Path) -> None:
    frames = travelling(tmp_path, (0, 0, 0), (31, 0, 0), (62, 0, 0), told=ROOM)
    save_frames(tmp_path / "converted", list(frames), "vdb")
    for frame in open_frames(tmp_path / "converted"):
        np.testing.assert_array_equal(frame.velocity[frame.density > 0], np.tile([30, 0, 0], (SMOKE.size, 1)))
    flipped = open_frames(tmp_path, given=replace(CROP, flip="x"))
    assert flipped[0].placement.drift == (-31.0, 0.0, 0.0)
    np.testing.assert_array_equal(flipped[0].velocity[0, 0, 0], [1, 0, 0])


def test_the_drift_of_the_last_frame_selected_is_that_of_the_sequence(tmp_path: Path) -> None:
    names = ("s_0010", "s_0012", "s_0014")
    travelling(tmp_path, (0, 0, 0), (60, 0, 0), (100, 0, 0), names=names)
    alone = open_frames(tmp_path, (12, 12), CROP)[0]
    np.testing.assert_array_equal(alone.velocity, open_frames(tmp_path, given=CROP)[1].velocity)


def test_the_drift_counts_frames(tmp_path: Path) -> None:
    frames = travelling(tmp_path, (0, 0, 0), (60, 0, 0), names=("s_0010", "s_0012"))
    smoke = frames[0].density > 0
    moved = frames[1].placement.corner[0] - frames[0].placement.corner[0]
    np.testing.assert_array_equal(frames[0].velocity[smoke][:, 0], 30 - moved / 2)


def strayed(folder: Path, value: float = 0.3, far: int = 700) -> Path:
    density = np.zeros((10, 12, far), np.float32)
    density[..., :14] = SMOKE
    density[3, 2, -1] = value
    write_vdb(folder / "s_0001.vdb", [DenseGrid("density", density)], {})
    return folder / "s_0001.vdb"


def test_stray_voxels_are_named_and_left_out(tmp_path: Path) -> None:
    path = strayed(tmp_path)
    frames = open_frames(path, given=CROP)
    assert frames[0].density.shape == (10, 12, 700)
    (note,) = frames.grid_notes
    share = 0.3 / (float(SMOKE.sum()) + 0.3)
    assert note == (
        f"s_0001.vdb: 1 stray voxel at (699, 2, 3) with {share:.2g} of the smoke; they make the grid larger: "
        "--ignore-stray drops them"
    )
    frames = open_frames(path, given=NO_STRAY)
    assert frames[0].density.shape == (10, 12, 19) and frames[0].mass == pytest.approx(float(SMOKE.sum()), rel=1e-6)
    assert "left out" in frames.grid_notes[0] and "cropped" in frames.grid_notes[1]


def test_a_thousandth_of_the_smoke_is_no_stray(tmp_path: Path) -> None:
    path = strayed(tmp_path, 0.0015 * float(SMOKE.sum()))
    clumps = clumps_of([read_vdb(path).grids[0].tree])
    assert [clump.voxels for clump in clumps] == [SMOKE.size, 1] and stray(clumps) == []
    assert clumps[0].mass == pytest.approx(float(SMOKE.sum()), rel=1e-6)


def test_boxes_that_are_almost_empty_are_refused(tmp_path: Path) -> None:
    grid = [DenseGrid("density", SMOKE)]
    write_vdb(tmp_path / "a.vdb", grid, domain((0, 0, 0), (14, 12, 1_048_585)))
    tracemalloc.start()
    with pytest.raises(
        InputError, match=r"a\.vdb: its grid spans 15 × 13 × 1048586 cells .* --crop on takes the smoke"
    ):
        open_frames(tmp_path / "a.vdb")[0]
    assert open_frames(tmp_path / "a.vdb", given=CROP)[0].density.size < 10_000
    assert tracemalloc.get_traced_memory()[1] < 30_000_000
    tracemalloc.stop()
    puffs = tmp_path / "puffs.vdb"
    write_vdb(puffs, grid, {})
    data = puffs.read_bytes()
    # A leaf of the smoke, far away: the origin of the node that holds it has one bit more.
    write_vdb(puffs, [DenseGrid("density", SMOKE, (4090, 0, 0))], {})
    data = puffs.read_bytes()
    node = np.array([4096, 0, 0], "<i4").tobytes()
    assert data.count(node) == 1
    puffs.write_bytes(data.replace(node, np.array([1 << 20, 0, 1 << 20], "<i4").tobytes()))
    with pytest.raises(InputError, match=r"puffs\.vdb: its grid spans 1044494 × 12 × 1048586 .*% at .*split the file"):
        open_frames(puffs, given=CROP)[0]


def test_active_tiles_are_smoke(tmp_path: Path) -> None:
    write_vdb(tmp_path / "a.vdb", [DenseGrid("density", np.full((128, 128, 256), 0.5, np.float32))], {})
    tree = read_vdb(tmp_path / "a.vdb").grids[0].tree
    assert len(tree.leaf_origins) == 0 and tree.tile_edges.tolist() == [128, 128]
    (clump,) = clumps_of([tree])
    assert (clump.mass, clump.voxels) == (0.5 * 128 * 128 * 256, 128 * 128 * 256)
    assert open_frames(tmp_path / "a.vdb", given=CROP)[0].density.shape == (128, 128, 256)


def test_a_background_of_smoke_ends_with_the_active_voxels(tmp_path: Path) -> None:
    density = np.pad(SMOKE, 2)
    write_vdb(tmp_path / "a.vdb", [DenseGrid("density", density, background=0.25)], {})
    frames = open_frames(tmp_path / "a.vdb", given=CROP)
    np.testing.assert_array_equal(frames[0].density, density)
    assert "outside of its active voxels is 0.25" in frames.grid_notes[0]
    save_frames(tmp_path / "b.vdb", frames[0])
    grid = read_vdb(tmp_path / "b.vdb").grids[0]
    box = np.array([-3, -3, -3]), np.array([20, 20, 20])
    np.testing.assert_array_equal(grid.tree.values_in(box), read_vdb(tmp_path / "a.vdb").grids[0].tree.values_in(box))
