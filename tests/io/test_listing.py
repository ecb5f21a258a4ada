"""Which files of an input are its frames: sequences, patterns, folders of programs, one grid per file."""

from __future__ import annotations

import os
import re
import tempfile
from pathlib import Path

import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import load_frames, open_frames, save_frames
from tnst_mi.io.files.folders import frame_folder
from tnst_mi.io.grids.npz import write_arrays
from tnst_mi.io.grids.uni import REAL, write_uni
from tnst_mi.io.grids.vdb import DenseGrid, write_vdb
from tnst_mi.io.grids.vdb.results import write_vdb_frame
from tnst_mi.io.grids.vol import write_vol
from tnst_mi.io.interpretation.conventions import Conventions
from tnst_mi.io.interpretation.roles import Wanted
from tnst_mi.io.single_grids import OURS, Y_UP

SHAPE = (3, 4, 5)


def densities(folder: Path, *names: str) -> None:
    """A file of each name, whose density tells which it is."""
    for value, name in enumerate(names, start=1):
        save_frames(folder / name, Frame(np.full(SHAPE, value, np.float32)))


def numbers(path: Path, span: tuple[float, float] | None = None) -> list[int | float | None]:
    return open_frames(path, span).numbers


def order(path: Path) -> list[int]:
    """The densities that `densities` wrote, in the order in which they are read."""
    return [int(frame.density[0, 0, 0]) for frame in load_frames(path)]


# --- Numbers ----------------------------------------------------------------------------------------------


def test_negative_frames_come_first(tmp_path: Path) -> None:
    densities(tmp_path, "s.-0001.vdb", "s.-0002.vdb", "s.00000.vdb", "s.00001.vdb")
    assert numbers(tmp_path) == [-2, -1, 0, 1]
    assert order(tmp_path) == [2, 1, 3, 4]
    assert [frame.number for frame in open_frames(tmp_path, (-2, 0))] == [-2, -1, 0]
    # One of them by itself is the same frame.
    assert numbers(tmp_path / "s.-0002.vdb") == [-2]


def test_a_file_by_itself_has_the_number_that_it_has_among_others(tmp_path: Path) -> None:
    densities(tmp_path, "0001_res64.npz", "0002_res64.npz")
    assert numbers(tmp_path / "0002_res64.npz") == [2]


def test_sub_frames_are_left_out_unless_asked_for(tmp_path: Path) -> None:
    densities(tmp_path, "s.0001.npz", "s.0001.50.npz", "s.0002.npz", "s.0002.50.npz")
    frames = open_frames(tmp_path)
    assert frames.numbers == [1, 2]
    (note,) = frames.notes
    assert "sub-frames are left out: 1.5, 2.5;" in note and "frames = '1.0:2.5'" in note
    assert numbers(tmp_path, (1.0, 2.5)) == [1, 1.5, 2, 2.5]
    assert numbers(tmp_path, (1.5, 1.5)) == [1.5]
    assert open_frames(tmp_path, (1.5, 1.5))[0].density[0, 0, 0] == 2
    assert numbers(tmp_path, (1, 2)) == [1, 2]
    with pytest.raises(InputError, match="both ends must be there"):
        open_frames(tmp_path, (1.25, 2.5))


def test_sub_frames_alone_are_all_taken(tmp_path: Path) -> None:
    densities(tmp_path, "s.0001.25.npz", "s.0001.75.npz", "s.0002.25.npz")
    frames = open_frames(tmp_path)
    assert (frames.numbers, frames.notes) == ([1.25, 1.75, 2.25], ())


def test_sub_frames_of_one_frame_are_said_and_may_be_meant_otherwise(tmp_path: Path) -> None:
    densities(tmp_path, "s.1.25.npz", "s.1.5.npz", "s.1.75.npz")
    frames = open_frames(tmp_path)
    assert frames.numbers == [1.25, 1.5, 1.75]
    (note,) = frames.notes
    assert note == f"s.1.25.npz is taken as frame 1.25; if it is frame 25, give '{tmp_path / 's.1.#.npz'}'"
    with pytest.raises(InputError, match="frames are missing between 5 and 75"):
        open_frames(Path(note.split("'")[1]))
    # The opposite, likewise.
    densities(tmp_path / "takes", "take.1.1.npz", "take.1.2.npz", "take.1.3.npz")
    frames = open_frames(tmp_path / "takes")
    assert frames.numbers == [1, 2, 3]
    other = open_frames(Path(frames.notes[0].split("'")[1]))
    assert (other.numbers, other.notes) == ([1.1, 1.2, 1.3], ())


def test_thirds_of_frames(tmp_path: Path) -> None:
    densities(tmp_path, "s.0001.npz", "s.0001.333.npz", "s.0001.667.npz", "s.0002.npz")
    assert numbers(tmp_path, (1.0, 2.0)) == [1, 1.333, 1.667, 2]


def test_every_second_frame(tmp_path: Path) -> None:
    densities(tmp_path, "s_0010.npz", "s_0012.npz", "s_0014.npz", "s_0018.npz")
    with pytest.raises(InputError, match=r"missing between 10 and 18: 16$"):
        open_frames(tmp_path)
    assert numbers(tmp_path, (10, 14)) == [10, 12, 14]


def test_files_without_a_number_are_named_as_left(tmp_path: Path) -> None:
    densities(tmp_path, "s_1.npz", "s_2.npz", "rest.npz")
    frames = open_frames(tmp_path)
    assert frames.numbers == [1, 2]
    assert frames.notes == (f"left alone in {tmp_path}: rest.npz",)


# --- Several sequences, and patterns ----------------------------------------------------------------------


def test_two_sequences_are_named_and_one_is_chosen_by_its_pattern(tmp_path: Path) -> None:
    densities(tmp_path, "a_0001.npz", "b_0001.npz", "a_0002.npz", "b_0002.npz", "b_0003.npz")
    expected = r"has 2 sequences: a_####.npz \(1 to 2\), b_####.npz \(1 to 3\); give one as a pattern"
    with pytest.raises(InputError, match=expected) as error:
        open_frames(tmp_path)
    pattern = str(error.value).split("'")[-2]
    assert order(Path(pattern)) == [1, 3]
    assert order(tmp_path / "b_*.npz") == [2, 4, 5]


def test_the_same_frames_in_two_formats_are_two_sequences(tmp_path: Path) -> None:
    densities(tmp_path, "s_1.npz", "s_2.npz", "s_1.vdb", "s_2.vdb")
    with pytest.raises(InputError, match=r"has 2 sequences: s_#.npz .*, s_#.vdb"):
        open_frames(tmp_path)
    assert order(tmp_path / "s_#.vdb") == [3, 4]


@pytest.mark.parametrize(
    "pattern",
    [
        *("s.####.npz", "s.#.npz", "s.%04d.npz", "s.%d.npz", "s.$F4.npz", "s.$F.npz", "s.${F4}.npz", "s.<F4>.npz"),
        *("s.<frame>.npz", "s.{frame:04d}.npz", "s.*.npz", "s.*[0-9].npz", "s.????.npz", "s.####", "[!t].*.npz"),
    ],
)
def test_patterns(tmp_path: Path, pattern: str) -> None:
    densities(tmp_path, "s.0007.npz", "s.0008.npz", "t.0007.npz", "s.notes.txt.npz")
    (tmp_path / "s.notes.txt.npz").rename(tmp_path / "s.0009.txt")
    assert numbers(tmp_path / pattern) == [7, 8]


def test_a_pattern_has_signs_and_fractions_too(tmp_path: Path) -> None:
    densities(tmp_path, "s_-003.npz", "s_-002.npz", "s_-002.50.npz")
    assert numbers(tmp_path / "s_####.npz") == [-3, -2]
    assert numbers(tmp_path / "s_####.npz", (-3.0, -2.0)) == [-3, -2.5, -2]


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("s.<UDIM>.npz", "<UDIM> counts the tiles of a texture, expected a place for the frame number, such as ####"),
        ("t.####.npz", "matches no file"),
        ("s.####.exr", "matches no file .npz"),
        ("none/s.####.npz", "no such folder"),
        ("s.##.##.npz", "has 2 places for numbers"),
        ("s.[9-0].npz", "is no pattern"),
    ],
)
def test_patterns_that_cannot_be_used(tmp_path: Path, pattern: str, message: str) -> None:
    densities(tmp_path, "s.0007.npz")
    with pytest.raises(InputError, match=message) as error:
        open_frames(tmp_path / pattern)
    assert len(str(error.value)) - len(str(tmp_path)) < 250


def test_a_file_with_the_name_of_a_pattern_is_a_file(tmp_path: Path) -> None:
    densities(tmp_path, "s[1].npz", "s1.npz")
    assert order(tmp_path / "s[1].npz") == [1]


# --- Folders that programs make ---------------------------------------------------------------------------


def test_the_cache_of_blender_leads_to_its_data(tmp_path: Path) -> None:
    densities(tmp_path / "data", "fluid_data_0001.vdb", "fluid_data_0002.vdb")
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "config_0001.uni").write_bytes(b"settings")
    frames = open_frames(tmp_path)
    assert frames.numbers == [1, 2]
    assert frames.notes == (f"{tmp_path}: is the folder of a cache; the frames are read from {tmp_path / 'data'}",)
    densities(tmp_path / "noise", "fluid_noise_0001.vdb", "fluid_noise_0002.vdb", "fluid_noise_0003.vdb")
    frames = open_frames(tmp_path)
    assert frames.numbers == [1, 2, 3]
    assert "a cache with noise, whose velocities are in data/" in frames.notes[0]


def test_the_folder_of_a_run_leads_to_its_densities(tmp_path: Path) -> None:
    for name in ("run.json", "recipe.toml"):
        (tmp_path / name).touch()
    for name in ("density", "velocity", "images"):
        (tmp_path / name).mkdir()
    with pytest.raises(InputError, match="a run that has not finished a frame"):
        open_frames(tmp_path)
    densities(tmp_path / "density", "s_1.npz", "s_2.npz")
    frames = open_frames(tmp_path)
    assert frames.numbers == [1, 2]
    assert frames.notes == (f"{tmp_path}: is the folder of a run; the frames are read from {tmp_path / 'density'}",)
    with pytest.raises(InputError, match=f"belongs to a run, whose frames are in {tmp_path / 'density'}"):
        open_frames(tmp_path / "images")


def test_a_scene_of_phiflow(tmp_path: Path) -> None:
    scene, velocity = tmp_path / "sim_000000", np.ones((*SHAPE, 3), np.float32)
    for number in (0, 1):
        write_arrays(scene / f"smoke_{number:06d}.npz", {"data": np.full(SHAPE, 0.5, np.float32)})
        write_arrays(scene / f"velocity_{number:06d}.npz", {"data": velocity * number})
        write_arrays(scene / f"pressure_{number:06d}.npz", {"data": np.ones(SHAPE, np.float32)})
    for path in (tmp_path, scene):
        frames = open_frames(path)
        assert frames.numbers == [0, 1]
        np.testing.assert_array_equal(frames[1].velocity, velocity)
        assert frames.notes[-1] == f"left alone in {scene}: pressure_######.npz"
    densities(tmp_path / "sim_000001", "smoke_000000.npz")
    with pytest.raises(InputError, match="those below it that have some are sim_000000, sim_000001: give one"):
        open_frames(tmp_path)


def test_folders_below_are_offered(tmp_path: Path) -> None:
    densities(tmp_path / "take1", "s_1.npz")
    with pytest.raises(InputError, match=r"no frames in this folder, .*; those below it that have some are take1: "):
        open_frames(tmp_path)


@pytest.mark.skipif(not hasattr(os, "seteuid"), reason="Windows has no such permissions")
@pytest.mark.parametrize("private", ["shots", "shots/take2", "shots/take2/density"])
def test_private_folders_are_passed_over(private: str) -> None:
    # Those of pytest are private themselves.
    with tempfile.TemporaryDirectory() as name:
        folder, user = Path(name), os.geteuid()
        folder.chmod(0o755)
        densities(folder / "take1", "s_1.npz")
        densities(folder / "shots" / "take2" / "density", "s_1.npz")
        (folder / private).chmod(0)
        if user == 0:  # who may read everything
            os.seteuid(65534)
        try:
            with pytest.raises(InputError, match=r"those below it that have some are take1: "):
                frame_folder(folder, (".npz",))
        finally:
            os.seteuid(user)
            (folder / private).chmod(0o755)


# --- One grid per file ------------------------------------------------------------------------------------


@pytest.mark.parametrize("format", ["npz", "npy", "vdb"])
@pytest.mark.parametrize(
    ("density", "velocity"),
    [
        ("density_0001", "vel_0001"),
        ("density_0001", "velocity_0001"),
        ("Density_0001", "Vel_0001"),
        ("smoke_0001", "velocity_0001"),
        ("smoke_0001", "smoke_vel_0001"),
        ("smoke_0001", "smoke_0001_vel"),
        ("sim.density.0001", "sim.velocity.0001"),
        ("d_0001", "v_0001"),
    ],
)
def test_a_velocity_beside_its_density(tmp_path: Path, format: str, density: str, velocity: str) -> None:
    rng = np.random.default_rng(0)
    d, v = rng.random(SHAPE).astype(np.float32), rng.normal(size=(*SHAPE, 3)).astype(np.float32)
    for name, key, array in ((density, "density", d), (velocity, "velocity", v)):
        if format == "npy":
            np.save(tmp_path / f"{name}.npy", array)
        elif format == "npz":
            write_arrays(tmp_path / f"{name}.npz", {"arr_0": array})
        else:
            write_vdb_frame(tmp_path / f"{name}.vdb", {key: array})
    for path in (tmp_path, tmp_path / f"{density}.{format}"):
        frames = open_frames(path)
        assert len(frames) == 1
        np.testing.assert_array_equal(frames[0].density, d)
        np.testing.assert_array_equal(frames[0].velocity, v)
        assert f"velocity from {re.sub('[0-9]', '#', velocity)}.{format}" in frames[0].reading
        assert frames.notes == ()
        assert tmp_path / f"{velocity}.{format}" in frames.sources(0)


@pytest.mark.parametrize("format", ["npz", "npy", "vdb", "uni", "vol"])
@pytest.mark.parametrize(
    ("density", "components"),
    [
        ("density_0001", "vel_{}_0001"),
        ("density.0001", "velocity.{}.0001"),
        ("density_0001", "vel{}_0001"),
        ("smoke_density_0001", "smoke_{}_vel_0001"),
        ("density_0001", "{}_0001"),
    ],
)
def test_a_velocity_in_three_files_beside_its_density(
    tmp_path: Path, format: str, density: str, components: str
) -> None:
    rng = np.random.default_rng(0)
    d, v = rng.random(SHAPE).astype(np.float32), rng.normal(size=(*SHAPE, 3)).astype(np.float32)
    letters = "uvw" if components.startswith("{}_0") else "XYZ" if "vel{}" in components else "xyz"
    names = [density, *(components.format(letter) for letter in letters)]
    for name, array in zip(names, (d, *np.moveaxis(v, -1, 0)), strict=True):
        path = tmp_path / f"{name}.{format}"
        match format:
            case "npy":
                np.save(path, array)
            case "npz":
                write_arrays(path, {"data": array})
            case "vdb":
                write_vdb(
                    path, [DenseGrid("density" if array is d else "data", array)], {"tnst_mi_up": ("string", "y")}
                )
            case "uni":
                write_uni(path, array, REAL, OURS + Y_UP)
            case _:
                write_vol(path, array)
    given = Conventions(velocity_units="cells-per-frame")
    for path in (tmp_path, tmp_path / f"{density}.{format}"):
        frames = open_frames(path, given=given)
        assert (len(frames), frames.notes) == (1, ())
        np.testing.assert_array_equal(frames[0].density, d)
        np.testing.assert_array_equal(frames[0].velocity, v)
        first = re.sub("[0-9]", "#", names[1])
        assert f"velocity from {first}.{format}, " in frames[0].reading
        assert {tmp_path / f"{name}.{format}" for name in names} <= set(frames.sources(0))
    without = open_frames(tmp_path, given=Conventions(names=Wanted(velocity="none")))
    assert without[0].velocity is None
    (tmp_path / f"{names[-1]}.{format}").unlink()
    if "u" not in letters:  # a lone v is the velocity, whatever it holds
        assert load_frames(tmp_path)[0].velocity is None


def test_components_in_files_of_their_own_may_lie_on_faces_and_reach_beyond_the_smoke(tmp_path: Path) -> None:
    d = np.zeros(SHAPE, np.float32)
    d[1:, 1:3, 2:4] = 1.0
    z, y, x = np.indices(SHAPE).astype(np.float32)
    for axis, (letter, values) in enumerate(zip("xyz", (2 * x, 3 * y, 4 * z), strict=True)):
        place = -0.25 * np.eye(3)[axis]
        write_vdb(tmp_path / f"vel_{letter}_0001.vdb", [DenseGrid("a", values + 1, (0, 0, 0), 0.5, tuple(place))], {})
    write_vdb(tmp_path / "density_0001.vdb", [DenseGrid("density", d, (0, 0, 0), 0.5)], {})
    frames = open_frames(tmp_path, given=Conventions(velocity_units="cells-per-frame"))
    # As a velocity in one file does, they make room around the smoke where their voxels are those of the density.
    smoke = frames[0].density > 0
    inside = np.stack([2 * x + 2.0, 3 * y + 2.5, 4 * z + 3.0], axis=-1)[d > 0]
    # The last faces have no upper one.
    kept = (z < SHAPE[0] - 1)[d > 0]
    np.testing.assert_allclose(frames[0].velocity[smoke][kept], inside[kept], rtol=1e-6)


def test_components_that_are_none_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "density_0001.npy", np.ones(SHAPE))
    for letter in "xyz":
        np.savez(tmp_path / f"vel_{letter}_0001.npz", a=np.ones(SHAPE), b=np.ones(SHAPE))
    (tmp_path / "density_0001.npy").unlink()
    write_arrays(tmp_path / "density_0001.npz", {"density": np.ones(SHAPE, np.float32)})
    with pytest.raises(
        InputError, match=r"vel_x_0001.npz: expected one array, a component of the velocity, found a, b"
    ):
        load_frames(tmp_path)
    write_vol(tmp_path / "vol" / "density_0001.vol", np.ones(SHAPE, np.float32))
    for letter, shape in zip("xyz", (SHAPE, SHAPE, SHAPE[::-1]), strict=True):
        write_vol(tmp_path / "vol" / f"vel_{letter}_0001.vol", np.ones(shape, np.float32))
    with pytest.raises(InputError, match=r"vel_z_0001.vol: has shape \(5, 4, 3\), expected a component"):
        load_frames(tmp_path / "vol")


def test_an_obstacle_beside_its_density(tmp_path: Path) -> None:
    solid = np.random.default_rng(1).random(SHAPE) < 0.3
    np.save(tmp_path / "density_0001.npy", np.ones(SHAPE, np.float32))
    np.save(tmp_path / "obstacle_0001.npy", solid)
    (frame,) = load_frames(tmp_path)
    np.testing.assert_array_equal(frame.obstacle, solid)


def test_a_frame_that_has_its_own_velocity_keeps_it(tmp_path: Path) -> None:
    own = np.full((*SHAPE, 3), 2.0, np.float32)
    save_frames(tmp_path / "density_0001.npz", Frame(np.ones(SHAPE), own))
    write_arrays(tmp_path / "vel_0001.npz", {"velocity": own * 3})
    np.testing.assert_array_equal(load_frames(tmp_path)[0].velocity, own)


def test_a_velocity_that_is_none_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "density_0001.npy", np.ones(SHAPE))
    np.save(tmp_path / "vel_0001.npy", np.ones(SHAPE))
    with pytest.raises(
        InputError, match=r"vel_0001.npy: velocity has shape \(3, 4, 5\), expected .*--velocity none goes without it"
    ):
        load_frames(tmp_path)


def test_other_grids_are_named_as_left(tmp_path: Path) -> None:
    for name in ("density", "velx", "vel_y", "temperature"):
        for number in (1, 2):
            np.save(tmp_path / f"{name}_{number}.npy", np.ones(SHAPE))
    frames = open_frames(tmp_path)
    assert frames.numbers == [1, 2]
    assert frames.notes == (f"left alone in {tmp_path}: temperature_#.npy, vel_y_#.npy, velx_#.npy",)


# --- npy --------------------------------------------------------------------------------------------------


def test_npy_is_read_and_not_written(tmp_path: Path) -> None:
    density = np.random.default_rng(2).random(SHAPE)
    np.save(tmp_path / "s.npy", np.asfortranarray(density))
    np.testing.assert_array_equal(load_frames(tmp_path / "s.npy")[0].density, density.astype(np.float32))
    with pytest.raises(InputError, match=r"unknown format '.npy', expected one of .npz, .vol, .uni, .vdb"):
        save_frames(tmp_path / "t.npy", Frame(density))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"nothing", "not an npy file"),
        (
            b"\x93NUMPY\x01\x00v\x00{'descr': '<f4', 'fortran_order': False, 'shape': (9999, 9999), }",
            "not an npy|more",
        ),
    ],
)
def test_damaged_npy_files(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "s.npy").write_bytes(content.ljust(128, b" ") if len(content) > 20 else content)
    with pytest.raises(InputError, match=message) as error:
        load_frames(tmp_path / "s.npy")
    assert "\n" not in str(error.value)


def test_npy_is_never_unpickled(tmp_path: Path) -> None:
    np.save(tmp_path / "s.npy", np.array([{}], object), allow_pickle=True)
    with pytest.raises(InputError, match="pickled objects, which are never unpickled"):
        load_frames(tmp_path / "s.npy")


# --- Names that are not UTF-8 -----------------------------------------------------------------------------


def test_names_that_are_not_utf_8(tmp_path: Path) -> None:
    for number in (1, 2):
        save_frames(tmp_path / "s.npz", Frame(np.ones(SHAPE)))
        os.rename(tmp_path / "s.npz", os.fsencode(tmp_path) + b"/r\xe9sum_%d.npz" % number)
    frames = load_frames(tmp_path)
    assert [(frame.name, frame.number) for frame in frames] == [("r\ufffdsum_1", 1), ("r\ufffdsum_2", 2)]
