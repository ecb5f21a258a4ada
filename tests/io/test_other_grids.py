"""Grids beside the density in files: found, read at the cells of a frame, and written again as they were."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.geometry.affine import Affine
from tnst_mi.geometry.other_grids import OtherGrids
from tnst_mi.io import load_frames, save_frames
from tnst_mi.io.formats import write_frame
from tnst_mi.io.grids.vdb import DenseGrid, Grid, read_vdb, write_vdb
from tnst_mi.io.grids.vdb.other_grids import stored_velocity

SHAPE = (8, 10, 6)


def random(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random(shape).astype(np.float32) + 0.1


DENSITY = random(*SHAPE)


def grids_of(file: Path) -> dict[str, Grid]:
    return {grid.name: grid for grid in read_vdb(file).grids}


def assert_same(one: Grid, other: Grid) -> None:
    """The same grid, value by value, in the same type and place."""
    assert (one.name, one.tree_type) == (other.name, other.tree_type)
    assert one.metadata.get("class") == other.metadata.get("class")
    np.testing.assert_array_equal(one.stored_affine.matrix, other.stored_affine.matrix)
    np.testing.assert_array_equal(one.stored_affine.offset, other.stored_affine.offset)
    np.testing.assert_array_equal(one.tree.background, other.tree.background)
    box = np.array([-4, -4, -4]), np.array([20, 20, 20])
    np.testing.assert_array_equal(one.tree.values_in(box), other.tree.values_in(box))


#: What other programs write: of every type, precision and class, on voxels and with values beyond of their own.
OTHERS: Sequence[DenseGrid] = (
    DenseGrid("temperature", 290 + random(*SHAPE, seed=1), background=290.0, voxel_size=0.5),
    DenseGrid("heat", random(5, 6, 7, seed=2), half=True, transform=Affine.scaling(1.1, (0.3, -0.2, 0.4))),
    DenseGrid("fuel", random(*SHAPE, seed=3).astype(np.float64) * np.pi, voxel_size=0.5),
    DenseGrid("ids", (random(*SHAPE, seed=4) * 2**30).astype(np.int32), voxel_size=0.5, background=-1),
    DenseGrid("Cd", random(*SHAPE, 3, seed=5), voxel_size=0.5, background=np.array([0.0, 0.5, 1.0])),
    DenseGrid("force", random(*SHAPE, 3, seed=6) - 0.5, voxel_size=0.5, grid_class="staggered"),
    DenseGrid("wide", random(16, 16, 16, seed=7), (-3, -2, -1), voxel_size=0.5),
    DenseGrid("collision_sdf", random(*SHAPE, seed=8) - 0.5, voxel_size=0.5, grid_class="level set", background=3.0),
    DenseGrid("flags", np.full(SHAPE, 2, np.int32), voxel_size=0.5),
    DenseGrid("heat", random(*SHAPE, seed=9), voxel_size=0.5),
)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    write_vdb(tmp_path / "a.vdb", [DenseGrid("density", DENSITY, voxel_size=0.5), *OTHERS], {})
    return tmp_path / "a.vdb"


def test_what_does_not_change_comes_back_bit_for_bit(file: Path, tmp_path: Path) -> None:
    (frame,) = load_frames(file)
    assert list(frame.grids) == [
        "temperature",
        "heat",
        "fuel",
        "ids",
        "Cd",
        "force",
        "wide",
        "collision_sdf",
        "heat[1]",
    ]
    save_frames(tmp_path / "b.vdb", frame)
    for one, other in zip(read_vdb(file).grids, sorted_like(file, tmp_path / "b.vdb"), strict=True):
        assert_same(one, other)


def sorted_like(file: Path, other: Path) -> list[Grid]:
    """The grids of another file in the order of the names of the first."""
    names, found = [grid.name for grid in read_vdb(file).grids], list(read_vdb(other).grids)
    return [found.pop([grid.name for grid in found].index(name)) for name in names]


def test_at_the_cells_they_are_what_is_there(file: Path) -> None:
    (frame,) = load_frames(file)
    for name in ("temperature", "fuel", "ids", "Cd"):
        (source,) = (grid for grid in OTHERS if grid.name == name)
        np.testing.assert_array_equal(frame.grids[name], source.values)
        assert frame.grids[name].dtype == source.values.dtype
    assert frame.other_grids.read("temperature").outside == 290
    np.testing.assert_array_equal(frame.other_grids.read("Cd").outside, [0, 0.5, 1])
    assert frame.other_grids.read("collision_sdf").stays
    # Components on lower faces: a centre is the mean of two, the last one has nothing above.
    force = OTHERS[5].values
    np.testing.assert_allclose(frame.grids["force"][:, :, :-1, 0], (force[:, :, :-1, 0] + force[:, :, 1:, 0]) / 2)
    np.testing.assert_allclose(frame.grids["force"][-1, ..., 2], force[-1, ..., 2] / 2)


def test_a_change_is_added_on_their_own_voxels(file: Path, tmp_path: Path) -> None:
    """A change of 1 in all cells is one of 1 on every voxel between cells, and of nothing far from them."""
    (frame,) = load_frames(file)
    changed = {name: frame.grids[name] + np.ones((), frame.grids[name].dtype) for name in frame.grids}
    readers = OtherGrids.of_arrays(changed, SHAPE, "a").readers
    write_frame(tmp_path / "b.vdb", frame.density, None, None, frame.placement, OtherGrids(readers, SHAPE, "a"))
    before, after = grids_of(file), grids_of(tmp_path / "b.vdb")
    own = np.zeros(3, int), np.array(SHAPE[::-1]) - 1
    for name in ("temperature", "fuel", "ids", "Cd"):
        moved = after[name].tree.values_in(own) - before[name].tree.values_in(own)
        np.testing.assert_allclose(moved, 1, rtol=1e-6 if name != "temperature" else 1e-4)
        assert after[name].tree_type == before[name].tree_type
    assert_same(before["collision_sdf"], after["collision_sdf"])
    # The faces between two cells, and voxels of another size whose eight cells are all there.
    faces = after["force"].tree.values_in(own) - before["force"].tree.values_in(own)
    np.testing.assert_allclose(faces[:, :, 1:, 0], 1, rtol=1e-5)
    np.testing.assert_allclose(faces[:, :, 0, 0], 0.5, rtol=1e-5)
    wide = after["wide"].tree.values_in((own[0] - 3, own[1] + 3)) - before["wide"].tree.values_in(
        (own[0] - 3, own[1] + 3)
    )
    np.testing.assert_allclose(wide[3:-3, 3:-3, 3:-3], 1, rtol=1e-5)
    assert not wide[:3].any() and not wide[..., -3:].any()


def test_the_velocity_of_a_file_stays_on_its_faces_and_in_its_unit(tmp_path: Path) -> None:
    faces = random(*SHAPE, 3, seed=3) - 0.5
    source = [
        DenseGrid("density", DENSITY, voxel_size=0.5),
        DenseGrid("vel", faces, voxel_size=0.5, half=True, grid_class="staggered"),
    ]
    write_vdb(tmp_path / "a.vdb", source, {})
    (frame,) = load_frames(tmp_path / "a.vdb")
    readers = stored_velocity(frame.placement)
    assert readers is not None and list(readers) == ["vel"]
    velocity = OtherGrids(readers, SHAPE, "a")
    write_frame(tmp_path / "b.vdb", 2 * frame.density, None, None, frame.placement, velocity)
    assert_same(grids_of(tmp_path / "a.vdb")["vel"], grids_of(tmp_path / "b.vdb")["vel"])
    (again,) = load_frames(tmp_path / "b.vdb")
    assert frame.velocity is not None and again.velocity is not None
    np.testing.assert_array_equal(again.velocity, frame.velocity)


@pytest.mark.parametrize("format", ["npz", "uni", "vol"])
def test_directions_turn_with_the_axes_and_colours_do_not(format: str, tmp_path: Path) -> None:
    """In files with z up, as Blender's are: X, Y, Z become x, −z, y."""
    blender = {"file_base_resolution": ("vec3i", SHAPE[::-1])}
    vectors = random(*SHAPE, 3)
    names = ("force", "Cd")
    grids = [DenseGrid("density", DENSITY, metadata=blender), *(DenseGrid(name, vectors) for name in names)]
    write_vdb(tmp_path / "density_1.vdb", grids, {})
    (frame,) = load_frames(tmp_path / "density_1.vdb")
    in_place = np.moveaxis(vectors, 0, 1)[::-1]
    np.testing.assert_array_equal(frame.grids["Cd"], in_place)
    np.testing.assert_array_equal(frame.grids["force"], in_place[..., [0, 2, 1]] * np.float32([1, 1, -1]))
    save_frames(tmp_path / f"density_1.{format}", frame)
    (again,) = load_frames(tmp_path / f"density_1.{format}")
    for name in names:
        np.testing.assert_array_equal(again.grids[name], frame.grids[name])


def test_arrays_come_back_in_their_types(tmp_path: Path) -> None:
    types = ("float16", ">f4", "float64", "int8", "uint16", "int64", "bool")
    arrays = {f"a{i}": (100 * DENSITY).astype(kind) for i, kind in enumerate(types)}
    np.savez(tmp_path / "a.npz", density=DENSITY, first=np.ones((3, *SHAPE)), frame=3, **arrays)
    (frame,) = load_frames(tmp_path / "a.npz")
    assert "other grids: first, a0" in frame.reading and "not read: frame" in frame.reading
    save_frames(tmp_path / "b.npz", frame)
    with np.load(tmp_path / "b.npz") as again:
        for name, array in arrays.items():
            assert again[name].dtype == array.dtype
            np.testing.assert_array_equal(again[name], array)
        assert again["first"].shape == (*SHAPE, 3)
    save_frames(tmp_path / "c.vdb", frame)
    (of_vdb,) = load_frames(tmp_path / "c.vdb")
    for name, array in arrays.items():
        np.testing.assert_array_equal(of_vdb.grids[name].astype(float), array.astype(float))
    assert grids_of(tmp_path / "c.vdb")["a0"].half and of_vdb.grids["a3"].dtype == np.int32


def test_frames_of_arrays_are_checked() -> None:
    for grids, message in (
        (
            {"heat": np.ones((2, 2, 2))},
            r"a: grid 'heat' has shape \(2, 2, 2\), expected \(8, 10, 6\) or",
        ),
        ({"heat": np.full(SHAPE, np.inf)}, "a: grid 'heat' has 480 NaN or infinite values, expected finite numbers"),
        ({"heat": np.full(SHAPE, "x")}, "a: grid 'heat' has type <U1, expected numbers"),
        ({"velocity": DENSITY}, "a: grids has 'velocity', expected other names than density, velocity, obstacle"),
    ):
        with pytest.raises(InputError, match=message):
            Frame(DENSITY, name="a", grids=grids)
    with pytest.raises(InputError, match=r"a: grids have \(8, 10, 6\) cells, expected \(4, 10, 6\) to fit the density"):
        dataclasses.replace(Frame(DENSITY, name="a", grids={"heat": DENSITY}), density=DENSITY[:4])


def test_a_file_that_has_changed_is_said(file: Path) -> None:
    (frame,) = load_frames(file)
    write_vdb(file, [DenseGrid("density", DENSITY)], {})
    with pytest.raises(InputError, match=r"a\.vdb: has changed since it was read; read the frames again"):
        frame.grids["ids"]
    file.unlink()
    with pytest.raises(InputError, match=r"a\.vdb"):
        frame.grids["ids"]
