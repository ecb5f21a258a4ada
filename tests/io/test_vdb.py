"""OpenVDB files: what the official module says of files of its own and of Blender's, round trips, boxes, damage.

The files of tests/data/vdb were made by `scripts/check_vdb.py --keep`, two of them by Blender in a bake of 8 × 8 × 12
cells; beside each lies what the official module finds in it.
"""

from __future__ import annotations

import gzip
import itertools
import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame, Placement
from tnst_mi.geometry.affine import Affine
from tnst_mi.io import load_frames, open_frames, save_frames
from tnst_mi.io.grids.vdb import DenseGrid, read_vdb, require_small, write_vdb
from tnst_mi.io.grids.vdb.file_format.cursor import Cursor
from tnst_mi.io.grids.vdb.file_format.metadata import read_transform, written_string, written_transform
from tnst_mi.io.interpretation.conventions import Conventions
from tnst_mi.io.interpretation.orientation import from_z_up
from tnst_mi.io.interpretation.staggered import centred_velocity

DATA = Path(__file__).parents[1] / "data" / "vdb"
OFFICIAL = ("blender_float_blosc", "blender_half_zip", "inactive", "shared", "sparse_float", "sparse_half", "tiles")
SHAPE = (5, 11, 9)


def unpacked(name: str, folder: Path) -> Path:
    path = folder / f"{name}.vdb"
    path.write_bytes(gzip.decompress((DATA / f"{name}.vdb.gz").read_bytes()))
    return path


def random_frame(seed: int = 0, placement: Placement | None = None) -> Frame:
    rng = np.random.default_rng(seed)
    density = np.where(rng.random(SHAPE) < 0.4, rng.random(SHAPE), 0.0)
    name = f"frame_{seed:04d}"
    return Frame(density, rng.normal(size=(*SHAPE, 3)), rng.random(SHAPE) < 0.2, name, seed, placement)


def everything_in(path: Path) -> None:
    """Read all that a file holds."""
    for grid in read_vdb(path).grids:
        if grid.kind is not None and (box := grid.tree.active_box()) is not None:
            require_small(path, box)
            grid.tree.values_in(box)
            grid.tree.active_in(box)


@pytest.mark.parametrize("name", OFFICIAL)
def test_the_official_module_finds_the_same(name: str, tmp_path: Path) -> None:
    grids = read_vdb(unpacked(name, tmp_path)).grids
    expected = np.load(DATA / f"{name}.npz")
    descriptions = json.loads(str(expected["grids"]))
    assert sorted(grid.name for grid in grids) == sorted(entry["name"] for entry in descriptions)
    for number, entry in enumerate(descriptions):
        grid = [grid for grid in grids if grid.name == entry["name"]][entry["same_name"]]
        low, active = expected[f"first_{number}"].astype(int), expected[f"active_{number}"]
        box = (low, low + active.shape[::-1] - 1)
        np.testing.assert_array_equal(grid.tree.values_in(box), expected[f"values_{number}"])
        np.testing.assert_array_equal(grid.tree.active_in(box), active)
        assert grid.tree.active_voxels == grid.topology.active_voxels == entry["active_voxels"]
        assert grid.metadata.get("class", "unknown") == entry["class"]
        assert [grid.voxel_size, *grid.translation] == pytest.approx(entry["transform"], rel=1e-6)
        inside = np.argwhere(active)
        tight = grid.tree.active_box()
        if len(inside):
            np.testing.assert_array_equal(tight[0], low + inside.min(axis=0)[::-1])
            np.testing.assert_array_equal(tight[1], low + inside.max(axis=0)[::-1])
        else:
            assert tight is None


@pytest.mark.parametrize("compression", ["blosc", "zip", "none"])
def test_grids_round_trip_anywhere(compression: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    values = np.where(rng.random((3, 20, 17)) < 0.5, rng.normal(size=(3, 20, 17)), 0.0).astype(np.float32)
    vectors = rng.normal(size=(9, 1, 4, 3)).astype(np.float32)
    firsts = ((0, 0, 0), (-13, 4090, 125), (-4097, -128, 5))
    for first in firsts:
        grids = [DenseGrid("a", values, first, 0.1), DenseGrid("b", vectors, first, 0.25, (1.0, -2.0, 3.5))]
        write_vdb(tmp_path / "a.vdb", [*grids, DenseGrid("c", 0 * values)], {}, compression)
        read = read_vdb(tmp_path / "a.vdb").grids
        for grid, original in zip(read, grids, strict=False):
            low = np.array(first)
            box = (low, low + original.values.shape[2::-1] - 1)
            np.testing.assert_array_equal(grid.tree.values_in(box), original.values)
            assert (grid.name, grid.voxel_size, grid.translation) == (
                original.name,
                original.voxel_size,
                original.translation,
            )
            assert grid.metadata["class"] == ("fog volume" if grid.name == "a" else "unknown")
        assert read[2].tree.active_box() is None and read[2].tree.active_voxels == 0


@pytest.mark.parametrize(
    "placement",
    [
        None,
        Placement(0.1, (-1.3, 0.5, 7.0), "z"),
        Placement(0.25, (0.1, -3.0, 2.0), "y"),
        Placement(3.0),
        Placement(1e-6, (1e6, 0.0, 0.0)),
    ],
)
def test_frames_round_trip_where_they_came_from(placement: Placement | None, tmp_path: Path) -> None:
    frame = random_frame(7, placement)
    save_frames(tmp_path / "frame_0007.vdb", frame)
    (loaded,) = load_frames(tmp_path)
    for key in ("density", "velocity", "obstacle"):
        np.testing.assert_array_equal(getattr(loaded, key), getattr(frame, key))
    expected = placement or Placement()
    assert (loaded.placement.voxel_size, loaded.placement.up) == (expected.voxel_size, expected.up)
    assert loaded.placement.corner == pytest.approx(expected.corner, abs=1e-12)
    assert (loaded.name, loaded.number) == ("frame_0007", 7)


def test_blenders_cache_is_read_as_mantaflow_means_it(tmp_path: Path) -> None:
    path = unpacked("blender_half_zip", tmp_path)
    (frame,) = load_frames(path)
    grids = {grid.name: grid for grid in read_vdb(path).grids}
    domain = (np.zeros(3, int), np.array([7, 7, 11]))
    density = grids["density"].tree.values_in(domain)
    np.testing.assert_array_equal(frame.density, from_z_up(density))
    assert frame.density.shape == (8, 12, 8)  # all of the domain, though the smoke fills a part
    assert frame.placement == Placement(0.25, (0.0, 0.0, 0.0), "z")
    faces, known = grids["velocity"].tree.values_in(domain), grids["velocity"].tree.active_in(domain)
    assert grids["velocity"].staggered and 0.0 < known.mean() < 0.5
    np.testing.assert_array_equal(frame.velocity, from_z_up(centred_velocity(faces, known) * np.float32(0.1)))
    # In the midst of the smoke both faces are known.
    inner = known[:-1, :-1, :-1] & known[1:, :-1, :-1]
    up = 0.05 * (faces[:-1, :-1, :-1, 2] + faces[1:, :-1, :-1, 2])
    centred = centred_velocity(faces, known)[:-1, :-1, :-1, 2] * 0.1
    assert inner.any()
    np.testing.assert_allclose(centred[inner], up[inner], rtol=1e-5)


def test_files_of_other_programs_have_y_up_and_lengths_per_second(tmp_path: Path) -> None:
    frame = random_frame()
    grids = [DenseGrid("density", frame.density, (-3, 0, 2), 0.5), DenseGrid("vel", frame.velocity, (-3, 0, 2), 0.5)]
    write_vdb(tmp_path / "a.vdb", grids, {})
    (loaded,) = load_frames(tmp_path / "a.vdb")
    assert loaded.placement.up == "y" and loaded.placement.corner == (-1.5, 0.0, 1.0)
    np.testing.assert_allclose(loaded.velocity, frame.velocity / (24 * 0.5), rtol=1e-6)
    given = Conventions(up="z", velocity_units="cells-per-frame")
    turned = open_frames(tmp_path / "a.vdb", given=given)[0]
    np.testing.assert_array_equal(turned.density, from_z_up(frame.density))
    np.testing.assert_array_equal(turned.velocity, from_z_up(frame.velocity))


def test_a_sequence_has_the_box_of_all_its_frames(tmp_path: Path) -> None:
    density = np.ones((2, 3, 4), np.float32)
    for number, first in enumerate(((0, 0, 0), (5, -1, 0), (1, 1, 1))):
        write_vdb(tmp_path / f"f_{number}.vdb", [DenseGrid("density", density, first)], {})
    write_vdb(tmp_path / "f_3.vdb", [DenseGrid("density", 0 * density)], {})
    loaded = load_frames(tmp_path)
    # x from 0 to 8, y from −1 to 3, z from 0 to 2.
    assert [frame.density.shape for frame in loaded] == [(3, 5, 9)] * 4
    assert [frame.mass for frame in loaded] == [24.0, 24.0, 24.0, 0.0]
    assert loaded[1].density[0, 0, 5] == 1.0 and loaded[0].density[0, 1, 0] == 1.0
    # Whichever frames are chosen, their shape is the same; a file by itself has its own.
    assert open_frames(tmp_path, (2, 2))[0].density.shape == (3, 5, 9)
    assert load_frames(tmp_path / "f_2.vdb")[0].density.shape == (2, 3, 4)
    with pytest.raises(InputError, match=r"f_3\.vdb: no active voxel in it"):
        load_frames(tmp_path / "f_3.vdb")


def test_grids_that_make_no_frame(tmp_path: Path) -> None:
    density, velocity = np.ones((2, 3, 4), np.float32), np.ones((2, 3, 4, 3), np.float32)
    path = tmp_path / "a.vdb"
    for grids, message in (
        ([DenseGrid("heat", density), DenseGrid("flame", density)], "no grid 'density', the grids found are: 'heat', "),
        ([DenseGrid("velocity", velocity)], "no grid 'density', the grids found are: 'velocity'"),
        ([DenseGrid("density", -density)], "24 negative values"),
        ([], "no grid 'density', the grids found are: none"),
    ):
        write_vdb(path, grids, {})
        with pytest.raises(InputError, match=rf"a\.vdb: .*{message}"):
            load_frames(path)
    write_vdb(path, [DenseGrid("smoke", density), DenseGrid("velocity", velocity)], {})
    assert load_frames(path)[0].mass == 24.0  # the only grid that is smoke by name
    for name in ("Obstacle", "FLAGS"):
        write_vdb(path, [DenseGrid(name, 3 * density), DenseGrid("vel", velocity)], {})
        with pytest.raises(InputError, match=f"no grid 'density', the grids found are: '{name}', 'vel'"):
            load_frames(path)
        # 1 in flags is a fluid.
        write_vdb(path, [DenseGrid(name, density), DenseGrid("smoke", density)], {})
        (frame,) = load_frames(path)
        assert (frame.mass, frame.obstacle.all()) == (24.0, name == "Obstacle")


def test_all_affine_maps_are_read() -> None:
    def read(kind: str, *numbers: float) -> Affine | str:
        return read_transform(Cursor(Path("a.vdb"), written_string(kind) + struct.pack(f"<{len(numbers)}d", *numbers)))

    scale, inverses, translation = (0.5,) * 3, (0.5,) * 3 + (2.0,) * 3 + (4.0,) * 3 + (1.0,) * 3, (1.0, 2.0, 3.0)
    matrix = np.arange(9.0).reshape(3, 3) - 2 * np.eye(3)
    rows = np.block([[matrix.T, np.zeros((3, 1))], [np.array(translation), 1.0]])
    for read_map, linear, offset in (
        (read("UniformScaleMap", *scale, *inverses), 0.5 * np.eye(3), (0, 0, 0)),
        (read("ScaleMap", 0.5, -1.0, 2.0, *inverses), np.diag([0.5, -1.0, 2.0]), (0, 0, 0)),
        (read("UniformScaleTranslateMap", *translation, *scale, *inverses), 0.5 * np.eye(3), translation),
        (read("ScaleTranslateMap", *translation, *scale, *inverses), 0.5 * np.eye(3), translation),
        (read("TranslationMap", *translation), np.eye(3), translation),
        (read("AffineMap", *rows.ravel()), matrix, translation),
        (read("UnitaryMap", *np.eye(4)[[1, 0, 2, 3]].ravel()), np.eye(3)[[1, 0, 2]], (0, 0, 0)),
    ):
        assert isinstance(read_map, Affine)
        np.testing.assert_array_equal(read_map.matrix, linear)
        np.testing.assert_array_equal(read_map.offset, offset)
        again = read_transform(Cursor(Path("a.vdb"), written_transform(read_map)))
        assert isinstance(again, Affine)
        np.testing.assert_array_equal(again.matrix, linear)
        np.testing.assert_array_equal(again.offset, offset)
    assert read("NonlinearFrustumMap", 1.0) == "NonlinearFrustumMap"
    flat = np.diag([1.0, 1.0, 0.0, 1.0])
    for kind, numbers in (
        ("AffineMap", flat.ravel()),
        ("UniformScaleMap", (0.0,) * 3 + inverses),
        ("TranslationMap", (np.nan, 0.0, 0.0)),
    ):
        with pytest.raises(InputError, match=r"a\.vdb: voxels along .* flat or placed nowhere"):
            read(kind, *numbers)


def test_other_files_are_refused(tmp_path: Path) -> None:
    whole = unpacked("blender_half_zip", tmp_path).read_bytes()
    path = tmp_path / "a.vdb"
    for content, message in (
        (b"", "is empty"),
        (b"PK" + whole[2:], "no OpenVDB file"),
        (whole[:8] + struct.pack("<I", 213) + whole[12:], "OpenVDB file version 213, expected 222 to 224"),
    ):
        path.write_bytes(content)
        with pytest.raises(InputError, match=rf"a\.vdb: {message}"):
            read_vdb(path)
    with pytest.raises(InputError, match="no such file"):
        read_vdb(tmp_path / "b.vdb")
    with pytest.raises(InputError, match="is a folder"):
        read_vdb(tmp_path)


def test_values_that_start_before_their_description_ends(tmp_path: Path) -> None:
    path = tmp_path / "a.vdb"
    write_vdb(path, [DenseGrid("density", np.ones((2, 3, 4), np.float32))], {})
    whole = path.read_bytes()
    at = whole.index(b"Tree_float_5_4_3") + len(b"Tree_float_5_4_3") + 4
    start, _, end = struct.unpack_from("<3q", whole, at)
    path.write_bytes(whole[:at] + struct.pack("<3q", start, start + 8, end) + whole[at + 24 :])
    with pytest.raises(InputError, match=r"a\.vdb: damaged: a grid's values start before"):
        load_frames(path)


def test_grids_larger_than_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, density = tmp_path / "a.vdb", np.ones((2, 3, 4), np.float32)
    write_vdb(path, [DenseGrid("density", density), DenseGrid("velocity", np.stack([density] * 3, axis=-1))], {})
    # A leaf of 8³ voxels, four components, 14 bytes each.
    for free, fits in ((512 * 4 * 14, True), (512 * 4 * 14 - 1, False), (None, True)):
        monkeypatch.setattr("tnst_mi.io.grids.vdb.limits.free_memory", lambda free=free: free)
        if fits:
            load_frames(path)
            continue
        with pytest.raises(InputError, match=r"span 4 × 3 × 2 cells, which take .* MB are free; crop the grid"):
            load_frames(path)


@pytest.mark.parametrize("name", ["blender_float_blosc", "blender_half_zip", "tiles"])
def test_damaged_files_are_refused_or_read(name: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    path = unpacked(name, tmp_path)
    whole = path.read_bytes()
    for length in rng.integers(0, len(whole), 20):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=rf"{name}\.vdb: "):
            everything_in(path)
    refused = 0
    for places, kind in itertools.product(rng.integers(0, len(whole), (15, 10)), ("bits", "sizes")):
        damaged = bytearray(whole)
        for place in places if kind == "bits" else places[:2]:
            if kind == "bits":
                damaged[place] ^= 1 << rng.integers(0, 8)
            else:
                damaged[place : place + 4] = b"\xff\xff\xff\x7f"
        path.write_bytes(damaged)
        try:
            everything_in(path)
        except InputError as error:
            refused += 1
            assert "\n" not in str(error)
    assert refused > 10


def test_all_encodings_of_blender_hold_the_reference(asset: Callable[[str], Path]) -> None:
    folder = asset("data/formats")
    reference = np.load(folder / "tiny_reference_0040.npz")
    files = sorted(folder.glob("*.vdb"))
    assert len(files) == 7
    domain = (np.zeros(3, int), np.array([23, 23, 35]))
    for file in files:
        precision = "half" if "half" in file.name else "float"
        grids = {grid.name: grid for grid in read_vdb(file).grids}
        for name in ("density", "flame", "shadow", "temperature", "velocity"):
            values = grids[name].tree.values_in(domain).swapaxes(0, 2)
            np.testing.assert_array_equal(values, reference[f"{name}_{precision}"])
        if "resumable" in file.name:
            np.testing.assert_array_equal(grids["flags"].tree.values_in(domain).swapaxes(0, 2), reference["flags"])
            values = grids["phi_obstacle"].tree.values_in(domain).swapaxes(0, 2)
            np.testing.assert_array_equal(values, reference["phi_obstacle_half"])


def test_caches_in_uni_and_vdb_are_the_same_frame(asset: Callable[[str], Path]) -> None:
    folder = asset("data/formats")
    (uni,) = load_frames(folder / "tiny_density_0040.uni")
    (vdb,) = load_frames(folder / "tiny_float_zip_0040.vdb")
    smoke = vdb.density > 0.0
    np.testing.assert_array_equal(vdb.density[smoke], uni.density[smoke])
    assert uni.density[~smoke].max() < 1e-6  # what Blender leaves out of its VDB caches
    # Where all faces of a cell have smoke on their upper side, both know the same; at the edge one face is taken.
    inner = smoke.copy()
    inner[1:] &= smoke[:-1]  # z = −Y: the upper face along Y is the lower one along z
    inner[:, :-1] &= smoke[:, 1:]
    inner[..., :-1] &= smoke[..., 1:]
    assert 0.5 < inner.sum() / smoke.sum() < 1.0
    np.testing.assert_allclose(vdb.velocity[inner], uni.velocity[inner], atol=1e-6)


def test_a_frame_of_the_jet_is_that_of_its_npz(asset: Callable[[str], Path]) -> None:
    (frame,) = load_frames(asset("data/smokejet/vdb/fluid_data_0060.zip_float.vdb"))
    (expected,) = load_frames(asset("data/smokejet/frame_0060.npz"))
    np.testing.assert_array_equal(frame.density, expected.density)
    error = np.abs(frame.velocity - expected.velocity)[frame.density > 0.0]
    # The npz is rounded to 2⁻⁹; at the smoke's edge one known face stands for the mean of two.
    assert np.median(error) < 2.0**-9
    assert error.max() < 0.26 and np.sqrt(np.mean(error**2)) < 0.0085
