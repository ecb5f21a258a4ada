"""Files without the places of their grids, level sets; results like their source: names, metadata, precision, tiles."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import open_frames, save_frames
from tnst_mi.io.grids.vdb import DenseGrid, read_vdb, write_vdb
from tnst_mi.io.interpretation.conventions import Conventions

RANDOM = np.random.default_rng(3)
DENSITY = np.where(RANDOM.random((9, 10, 11)) < 0.5, RANDOM.random((9, 10, 11)), 0.0).astype(np.float32)
OFFSETS_FLAG = 20


def without_offsets(path: Path) -> None:
    """Make a file one that was written as a stream: no places of grids, and a header that says so."""
    data = bytearray(path.read_bytes())
    data[OFFSETS_FLAG] = 0
    for kind in (b"Tree_float_5_4_3", b"Tree_vec3s_5_4_3", b"Tree_ptdataidx32"):
        at = -1
        while (at := data.find(kind, at + 1)) >= 0:
            end = data.index(b"\0\0\0\0", at) + 4
            data[end : end + 24] = bytes(24)
    path.write_bytes(data)


@pytest.mark.parametrize("compression", ["blosc", "zip", "none"])
@pytest.mark.parametrize("half", [False, True])
def test_grids_that_follow_one_another(compression: str, half: bool, tmp_path: Path) -> None:
    vectors = RANDOM.normal(size=(9, 10, 11, 3)).astype(np.float32)
    solid = np.ones((40, 16, 16), np.float32)
    grids = [
        DenseGrid("density", DENSITY, (-5, 4090, 3), 0.5, half=half),
        DenseGrid("vel", vectors, half=half),
        DenseGrid("obstacle", solid, half=half),
    ]
    write_vdb(tmp_path / "a.vdb", grids, {}, compression)
    with_places = read_vdb(tmp_path / "a.vdb").grids
    without_offsets(tmp_path / "a.vdb")
    for grid, original in zip(read_vdb(tmp_path / "a.vdb").grids, with_places, strict=True):
        assert (grid.name, grid.span, grid.voxel_size) == (original.name, original.span, original.voxel_size)
        box = original.tree.active_box()
        np.testing.assert_array_equal(grid.tree.values_in(box), original.tree.values_in(box))


def test_grids_of_other_types_hide_those_after_them(tmp_path: Path) -> None:
    grids = [DenseGrid("points", DENSITY), DenseGrid("density", DENSITY)]
    write_vdb(tmp_path / "a.vdb", grids, {})
    data = (tmp_path / "a.vdb").read_bytes()
    (tmp_path / "a.vdb").write_bytes(data.replace(b"Tree_float_5_4_3", b"Tree_ptdataidx32", 1))
    # With places, points are passed over, however many passes their leaves are written in.
    np.testing.assert_array_equal(open_frames(tmp_path / "a.vdb")[0].density.sum(), DENSITY.sum())
    without_offsets(tmp_path / "a.vdb")
    with pytest.raises(InputError, match=r"a\.vdb: its header does not say where grids begin, so those after 'points'"):
        read_vdb(tmp_path / "a.vdb")


def sphere(path: Path, name: str = "surface", kind: bytes = b"level set ") -> np.ndarray:
    """A level set with a narrow band of three voxels of size 0.5; returns its signed distances."""
    z, y, x = np.indices((24, 24, 24)) - 11.5
    distance = np.clip((np.sqrt(x**2 + y**2 + z**2) - 8.0) * 0.5, -1.5, 1.5).astype(np.float32)
    write_vdb(path, [DenseGrid(name, distance, voxel_size=0.5, background=1.5)], {})
    data = path.read_bytes()
    # The class has as many letters as "fog volume" with a space at its end; a class is given without it.
    path.write_bytes(data.replace(b"\x0a\0\0\0fog volume", struct.pack("<I", len(kind.strip())) + kind.strip()))
    without = data.index(b"Tree_float_5_4_3") + 20
    if kind.strip() != b"fog volume":
        shift = len(kind.strip()) - 10
        offsets = np.add(np.frombuffer(data[without : without + 24], "<i8"), (0, shift, shift)).tobytes()
        changed = path.read_bytes()
        path.write_bytes(changed[:without] + offsets + changed[without + 24 :])
    return distance


@pytest.mark.parametrize(
    ("name", "kind"), [("density", b"level set"), ("smoke_sdf", b"fog volume"), ("density", b"unknown")]
)
def test_level_sets_are_recognised(name: str, kind: bytes, tmp_path: Path) -> None:
    distance = sphere(tmp_path / "a.vdb", name, kind)
    named = Conventions() if name == "density" else Conventions(fog=False)
    what = r"looks like a level set \(negative inside, 1.5 outside\)" if kind == b"unknown" else "level set"
    with pytest.raises(InputError, match=f"{what}.*--fog takes"):
        open_frames(tmp_path / "a.vdb", given=named)[0]
    frame = open_frames(tmp_path / "a.vdb", given=Conventions(fog=True))[0]
    # OpenVDB's sdfToFogVolume: 1 where the band ends inside, 0 at the surface and outside.
    expected = np.clip(-distance / 1.5, 0, 1)
    occupied = np.argwhere(expected > 0)
    low, high = occupied.min(axis=0), occupied.max(axis=0) + 1
    np.testing.assert_allclose(frame.density, expected[tuple(map(slice, low, high))], rtol=1e-6)


def test_negative_noise_beside_a_background_is_no_level_set(tmp_path: Path) -> None:
    density = np.where(DENSITY > 0.5, DENSITY, np.float32(-1e-8))
    write_vdb(tmp_path / "a.vdb", [DenseGrid("density", density, background=2.0)], {})
    frame = open_frames(tmp_path / "a.vdb")[0]
    assert frame.density.min() == 0.0 and "negative noise" in frame.notes[0].text


def test_an_obstacle_of_signed_distances_is_solid_inside_whatever_its_class(tmp_path: Path) -> None:
    distance = sphere(tmp_path / "a.vdb")
    grids = [DenseGrid("density", np.ones_like(distance), voxel_size=0.5)]
    write_vdb(tmp_path / "b.vdb", [*grids, DenseGrid("collision", distance, voxel_size=0.5, background=1.5)], {})
    frame = open_frames(tmp_path / "b.vdb")[0]
    np.testing.assert_array_equal(frame.obstacle, distance < 0.0)
    assert "obstacle is the inside of a level set" in frame.reading


def test_a_result_keeps_what_its_source_has(tmp_path: Path) -> None:
    metadata = {"shot": ("string", "sh010"), "colour": ("vec4s", struct.pack("<4f", 1, 2, 3, 4))}
    source = DenseGrid("Smoke", DENSITY, (2, 3, 4), 0.3, half=True, metadata={"note": ("int32", 7), **metadata})
    write_vdb(tmp_path / "a.vdb", [source], metadata)
    frame = open_frames(tmp_path / "a.vdb")[0]
    save_frames(tmp_path / "b.vdb", Frame(frame.density * 0.5, placement=frame.placement))
    file = read_vdb(tmp_path / "b.vdb")
    (grid,) = file.grids
    assert (grid.name, grid.half, grid.voxel_size) == ("Smoke", True, 0.3)
    assert grid.metadata["note"] == 7 and grid.metadata["class"] == "fog volume"
    assert file.metadata["shot"] == grid.metadata["shot"] == "sh010"
    # A type that we do not know is kept byte by byte.
    assert file.stored["colour"] == grid.stored["colour"] == metadata["colour"]
    # The result is read again without being told which grid it is.
    np.testing.assert_array_equal(open_frames(tmp_path / "b.vdb")[0].density, frame.density * 0.5)


def test_values_beyond_half_precision_stay(tmp_path: Path) -> None:
    write_vdb(tmp_path / "a.vdb", [DenseGrid("density", 1e6 * DENSITY, half=True)], {})
    grid = read_vdb(tmp_path / "a.vdb").grids[0]
    assert not grid.half and grid.tree.leaf_values.max() > 65504


def test_constant_parts_become_tiles(tmp_path: Path) -> None:
    values = np.zeros((16, 16, 24), np.float32)
    values[:8] = 2.0
    values[0, 0, 0] = 1.0
    vectors = np.zeros((8, 8, 16, 3), np.float32)
    vectors[..., :8, 1] = 3.0
    write_vdb(tmp_path / "a.vdb", [DenseGrid("density", values, (-8, 0, 8)), DenseGrid("v", vectors)], {})
    density, velocity = read_vdb(tmp_path / "a.vdb").grids
    assert len(density.tree.leaf_origins) == 1 and density.tree.tile_active.tolist() == [True] * 5
    assert len(velocity.tree.leaf_origins) == 0 and velocity.tree.tile_values.tolist() == [[0.0, 3.0, 0.0]]
    box = np.array([-8, 0, 8]), np.array([15, 15, 23])
    np.testing.assert_array_equal(density.tree.values_in(box), values)
    assert density.tree.active_voxels == 8 * 16 * 24 == density.metadata["file_voxel_count"]
