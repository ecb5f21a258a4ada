"""Blender's adaptive domains: files whose transforms are untrue, read where the cache's config/ says they are."""

from __future__ import annotations

import contextlib
import gzip
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import open_frames, save_frames
from tnst_mi.io.grids.vdb import DenseGrid, read_vdb, write_vdb
from tnst_mi.io.grids.vdb.frames import describe_vdb
from tnst_mi.io.interpretation.conventions import Conventions
from tnst_mi.io.sequence import FrameFiles

WHOLE = (9, 10, 16)  # cells of the domain along X, Y, Z; its longest side is 3.2
#: Of three frames: the first cell of the part, by how many cells the domain has moved, and the part's extents.
PARTS = (((1, 2, 0), (0, 0, 0), (6, 7, 5)), ((0, 1, 0), (0, 0, 0), (8, 9, 10)), ((0, 0, 0), (1, -2, 3), (9, 10, 11)))


def smoke(low: np.ndarray, extents: np.ndarray) -> np.ndarray:
    """Smoke of the lattice that rests, a number of its own in each cell: (Z, Y, X) from a lowest cell on."""
    z, y, x = np.indices(extents[::-1])
    x, y, z = x + low[0] + 10, y + low[1] + 10, z + low[2] + 10
    return np.float32((x * 10_000 + y * 100 + z) / 1e6)


def configuration(first: tuple[int, ...], moved: tuple[int, ...], extents: tuple[int, ...]) -> bytes:
    """Oracle: what Blender 3.4 writes, field by field."""
    data = struct.pack("<i3i2f", 11, *extents, 1 / max(WHOLE), 0.1)  # fields, resolution, dx, dt
    data += struct.pack("<9f", *[-1.0] * 3, *[1.0] * 3, *[-1.0] * 3)  # p0, p1, dp0
    data += struct.pack("<3i3f16f", *moved, *[0.0] * 3, *np.eye(4).ravel())  # shift, the object's shift and matrix
    last = np.add(first, extents).tolist()
    data += struct.pack("<9i", *WHOLE, *first, *last)  # base_res, res_min, res_max
    return data + bytes(20)  # colour, time, …


def cache(folder: Path, finer: int = 1) -> Path:
    """A cache of Blender's, with the transforms that it writes; or its noise, so many times finer."""
    data = folder / ("data" if finer == 1 else "noise")
    for path in (data, folder / "config"):
        path.mkdir(parents=True, exist_ok=True)
    for number, (first, moved, extents) in enumerate(PARTS, 1):
        resolution = finer * np.array(extents)
        density = smoke(finer * np.add(first, moved), resolution)
        edge = 3.2 / resolution.max()
        metadata = {"file_base_resolution": ("vec3i", tuple(resolution.tolist()))}
        grids = [DenseGrid("density", density, (0, 0, 0), edge, metadata=metadata)]
        if finer == 1:
            velocity = np.full((*density.shape, 3), 20.0, np.float32)
            grids.append(DenseGrid("velocity", velocity, (0, 0, 0), edge, metadata=metadata))
        write_vdb(data / f"fluid_{data.name}_{number:04d}.vdb", grids, {})
        with gzip.open(folder / "config" / f"config_{number:04d}.uni", "wb") as file:
            file.write(configuration(first, moved, extents))
    return data


def expected(number: int, finer: int = 1) -> np.ndarray:
    """The density of a frame in the box around all parts, y up: (z, y, x) = (−Y, Z, X)."""
    lows = [finer * np.add(first, moved) for first, moved, _ in PARTS]
    highs = [low + finer * np.array(extents) for low, (_, _, extents) in zip(lows, PARTS, strict=True)]
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    density = np.zeros((high - low)[::-1], np.float32)
    x, y, z = lows[number] - low
    width, depth, height = highs[number] - lows[number]
    density[z : z + height, y : y + depth, x : x + width] = smoke(lows[number], highs[number] - lows[number])
    return density.transpose(1, 0, 2)[::-1]


def require_as_expected(frames: FrameFiles, finer: int = 1) -> None:
    for number, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.density, expected(number, finer))
        assert frame.placement.voxel_size == pytest.approx(0.2 / finer)
        np.testing.assert_allclose(frame.placement.corner, [0.0, -0.4, 0.0], atol=1e-9)


@pytest.mark.parametrize("finer", [1, 2])
def test_all_frames_lie_on_one_lattice_value_by_value(finer: int, tmp_path: Path) -> None:
    data = cache(tmp_path, finer)
    frames = open_frames(data)
    require_as_expected(frames, finer)
    (note,) = frames.grid_notes
    assert f"{0.2 / finer:g} large, not {3.2 / 7 / finer:.4g} as fluid_{data.name}_0001.vdb says" in note
    assert "Blender's Adaptive Domain" in note
    if finer == 1:
        for frame in frames:
            # 0.1 time units are a frame, whatever the transform.
            motion = frame.velocity[frame.density > 0]
            np.testing.assert_allclose(motion, np.broadcast_to([2.0, 2.0, -2.0], motion.shape))


def test_noise_has_the_velocity_of_its_simulation_at_the_centres_of_its_own_cells(tmp_path: Path) -> None:
    cache(tmp_path)
    cache(tmp_path, finer=2)
    for number, (first, moved, extents) in enumerate(PARTS, 1):
        file = tmp_path / "data" / f"fluid_data_{number:04d}.vdb"
        z, y, x = np.indices(extents[::-1])
        centres = np.stack([x, y, z], axis=-1) + np.add(first, moved) + 0.5  # in cells of the simulation
        density, velocity = read_vdb(file).grids
        grids = [
            DenseGrid(grid.name, values, (0, 0, 0), 3.2 / max(extents), metadata=grid.stored)
            for grid, values in (
                (density, smoke(np.add(first, moved), np.array(extents))),
                (velocity, np.float32(centres)),
            )
        ]
        write_vdb(file, grids, {})
    frames = open_frames(tmp_path)
    assert "velocities are in data/" in frames.notes[0]
    for number, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.density, expected(number, 2))
        first, moved, extents = (np.array(part) for part in PARTS[number])
        z, y, x = np.indices(frame.density.shape)
        lowest = np.min([np.add(first, moved) for first, moved, _ in PARTS], axis=0)
        depth = frame.density.shape[0]
        # y up: x, y, z are X, Z, -Y, in cells of the noise, two to one of the simulation.
        own = np.stack([x, y, depth - 1 - z], axis=-1) + 0.5
        world = own / 2 + lowest[[0, 2, 1]]
        # Away from the border of the part, where interpolation has both neighbours.
        low, high = (first + moved + 0.5)[[0, 2, 1]], (first + moved + extents - 0.5)[[0, 2, 1]]
        inside = ((world > low) & (world < high)).all(axis=-1)
        # 0.1 time units a frame, and two cells of the noise for one of the simulation.
        wanted = 0.2 * world * [1.0, 1.0, -1.0]
        np.testing.assert_allclose(frame.velocity[inside], wanted[inside], rtol=1e-5, atol=1e-6)


def test_results_keep_the_voxels_of_their_file_and_are_read_again_where_they_were(tmp_path: Path) -> None:
    data = cache(tmp_path / "cache")
    frames = open_frames(data)
    again = tmp_path / "results" / "density"
    again.mkdir(parents=True)
    for frame, file in zip(frames, frames.files, strict=True):
        halved = Frame(0.5 * frame.density, placement=frame.placement, name=frame.name)
        save_frames(again / file.name, halved)
        result, source = read_vdb(again / file.name).grids[0], read_vdb(file).grids[0]
        np.testing.assert_array_equal(result.affine.matrix, source.affine.matrix)
        np.testing.assert_array_equal(result.affine.offset, source.affine.offset)
        box = source.tree.active_box()
        np.testing.assert_array_equal(result.tree.active_box(), box)
        np.testing.assert_array_equal(result.tree.values_in(box), 0.5 * source.tree.values_in(box))
    for number, frame in enumerate(open_frames(again)):
        np.testing.assert_array_equal(frame.density, 0.5 * expected(number))
    # With a size of voxels, even the one that they have, results lie on the lattice itself.
    edge = frames[0].placement.voxel_size
    for number, frame in enumerate(open_frames(data, given=Conventions(voxel_size=edge))):
        save_frames(tmp_path / "lattice.vdb", frame)
        grid = read_vdb(tmp_path / "lattice.vdb").grids[0]
        assert grid.voxel_size == edge
        first = np.rint(np.array(grid.translation) / edge).astype(int) + grid.tree.active_box()[0]
        np.testing.assert_array_equal(first, np.add(*PARTS[number][:2]))
    # Moved, they are so in their transforms and where they are read.
    moved = open_frames(again, given=Conventions(origin=(1.0, 2.0, 3.0)))[0]
    save_frames(tmp_path / "moved.vdb", moved)
    np.testing.assert_allclose(read_vdb(tmp_path / "moved.vdb").grids[0].translation, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(open_frames(tmp_path / "moved.vdb")[0].placement.corner, moved.placement.corner)
    # Of another grid than the file's, what the file said of its own is no more true.
    mirrored = open_frames(again, given=Conventions(flip="x"))[0]
    save_frames(tmp_path / "mirrored.vdb", mirrored)
    np.testing.assert_allclose(open_frames(tmp_path / "mirrored.vdb")[0].placement.corner, mirrored.placement.corner)
    assert open_frames(tmp_path / "mirrored.vdb")[0].placement.voxel_size == pytest.approx(0.2)


def test_without_the_configuration_files_are_taken_at_their_word(tmp_path: Path) -> None:
    data = cache(tmp_path)
    shutil.rmtree(tmp_path / "config")
    frames = open_frames(data)
    assert frames[0].placement.voxel_size != pytest.approx(0.2)
    (note,) = frames.grid_notes
    assert "Blender: Adaptive Domain changes them" in note and "config/" in note


def test_the_configuration_of_another_bake_is_none(tmp_path: Path) -> None:
    data = cache(tmp_path)
    for number, (first, moved, extents) in enumerate(PARTS, 1):
        with gzip.open(tmp_path / "config" / f"config_{number:04d}.uni", "wb") as file:
            file.write(configuration(first, moved, (*extents[:2], extents[2] + 1)))
    assert "resampled" in open_frames(data).grid_notes[0]


def test_info_says_how_results_get_to_the_domain(tmp_path: Path) -> None:
    data = cache(tmp_path)
    lines = describe_vdb(data / "fluid_data_0001.vdb")
    assert str(lines[-1]).endswith("; --origin=-1,-1,-1 --voxel-size=0.2 places results as in its object")
    shutil.rmtree(tmp_path / "config")
    assert "domain" not in "".join(map(str, describe_vdb(data / "fluid_data_0001.vdb")))


def test_any_changed_bit_of_a_configuration_is_found(tmp_path: Path) -> None:
    folder = cache(tmp_path)
    file = tmp_path / "config" / "config_0002.uni"
    whole = file.read_bytes()
    expected_of_frame = open_frames(folder / "fluid_data_0002.vdb")[0]
    for bit in range(0, 8 * len(whole), 5):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        file.write_bytes(damaged)
        # Some say nothing, such as those of the name and date that gzip keeps.
        with contextlib.suppress(InputError):
            frame = open_frames(folder / "fluid_data_0002.vdb")[0]
            assert frame.placement.voxel_size == expected_of_frame.placement.voxel_size
            assert frame.placement.corner == expected_of_frame.placement.corner


def test_frames_with_negative_numbers_have_configurations(tmp_path: Path) -> None:
    data = cache(tmp_path)
    for number in range(1, len(PARTS) + 1):
        for file in (data / f"fluid_data_{number:04d}.vdb", tmp_path / "config" / f"config_{number:04d}.uni"):
            file.rename(file.with_name(file.name.replace(f"{number:04d}", f"{number - 4:05d}")))
    require_as_expected(open_frames(data))


def test_a_part_may_reach_beyond_its_domain(tmp_path: Path) -> None:
    """As it does with Add Resolution."""
    data = cache(tmp_path)
    extents = PARTS[0][2]
    part = configuration((-2, 2, -9), (0, 0, 0), extents)
    (tmp_path / "config" / "config_0001.uni").write_bytes(gzip.compress(part))
    frame = open_frames(data / "fluid_data_0001.vdb")[0]
    np.testing.assert_array_equal(frame.density.shape, np.array(extents)[[1, 2, 0]])
    np.testing.assert_allclose(frame.placement.corner, 0.2 * np.array([-2, 2, -9]))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", r"config_0002\.uni: is empty"),
        (b"no gzip", r"config_0002\.uni: not a configuration of Blender's fluids, truncated, or damaged"),
        (gzip.compress(b"short"), r"config_0002\.uni: truncated: 5 bytes, expected 184 or more"),
        (gzip.compress(bytes(204)), r"config_0002\.uni: damaged: \[0, 0, 0\] cells"),
    ],
    ids=["empty", "other", "short", "zeros"],
)
def test_a_damaged_configuration_is_one_line(data: bytes, message: str, tmp_path: Path) -> None:
    folder = cache(tmp_path)
    (tmp_path / "config" / "config_0002.uni").write_bytes(data)
    with pytest.raises(InputError, match=message):
        open_frames(folder)[1]
