"""Smoke in large and empty boxes: cropped, followed, its stray voxels named; what is read grows with the smoke."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.io import open_frames, save_frames
from tnst_mi.io.grids.vdb import DenseGrid, read_vdb, write_vdb
from tnst_mi.io.grids.vdb.clumps import clumps_of, stray
from tnst_mi.io.grids.vdb.run_grid import REACH
from tnst_mi.io.interpretation.conventions import Boxing, Conventions
from tnst_mi.io.sequence import FrameFiles
from tnst_mi.optimisation.mask import soft_mask

CROP = Conventions(velocity_units="cells-per-frame", box=Boxing(crop=True))
NO_STRAY = Conventions(box=Boxing(crop=True, ignore_stray=True))
SMOKE = np.random.default_rng(0).random((10, 12, 14)).astype(np.float32) + 0.5


def domain(low: tuple[int, int, int], high: tuple[int, int, int]) -> dict[str, tuple[str, tuple[int, int, int]]]:
    return {"tnst_mi_box_min": ("vec3i", low), "tnst_mi_box_max": ("vec3i", high)}


def travelling(folder: Path, *firsts: tuple[int, int, int], names: tuple[str, ...] = ()) -> FrameFiles:
    velocity = np.zeros((*SMOKE.shape, 3), np.float32)
    velocity[..., 0] = 30.0
    for number, first in enumerate(firsts):
        name = names[number] if names else f"s_{number:04d}"
        write_vdb(folder / f"{name}.vdb", [DenseGrid("density", SMOKE, first), DenseGrid("vel", velocity, first)], {})
    return open_frames(folder, given=CROP)


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
    # At rest, the box holds all of it.
    rest = open_frames(tmp_path, given=Conventions(velocity_units="cells-per-frame"))
    assert rest[0].density.shape == (10, 14, 74)
    np.testing.assert_array_equal(rest[0].velocity[0, 0, 0], [30, 0, 0])


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
