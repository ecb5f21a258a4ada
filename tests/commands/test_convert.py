"""`tnst-mi convert` and `info` on every format, and every format as input and output of a run."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from command_line import refused, run, smoke
from jobs import FakeOptimiser, optimiser

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame, Placement
from tnst_mi.io import load_frames, save_frames
from tnst_mi.io.grids.vdb import DenseGrid, read_vdb, write_vdb
from tnst_mi.io.interpretation.orientation import from_z_up
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.job import Run
from tnst_mi.run.prepare import prepare

__all__ = ["optimiser", "run", "smoke"]

FORMATS = ("npz", "vol", "uni", "vdb")
SHAPE = (4, 6, 5)


@pytest.fixture
def moving(tmp_path: Path) -> Path:
    """A folder of three frames with velocities and an obstacle, 7 to 9."""
    rng = np.random.default_rng(0)
    frames = [
        Frame(rng.random(SHAPE), rng.normal(size=(*SHAPE, 3)), rng.random(SHAPE) < 0.2, f"f_{number:02d}", number)
        for number in (7, 8, 9)
    ]
    save_frames(tmp_path / "moving", frames)
    return tmp_path / "moving"


@pytest.mark.parametrize("format", FORMATS)
def test_folders_there_and_back(format: str, run: Run, moving: Path, tmp_path: Path) -> None:
    there, back = tmp_path / "there", tmp_path / "back"
    ran = run("convert", moving, there, "--format", format)
    assert ran.code == 0 and ran.out.splitlines() == [f"frame     {there}/f_0{n}.{format}" for n in (7, 8, 9)]
    ran = run("convert", there, back, "--frames", "8:9")
    assert ran.code == 0 and not any("note" in line for line in ran.errors if format != "vdb")
    originals, loaded = load_frames(moving)[1:], load_frames(back)
    assert [frame.name for frame in loaded] == ["f_08", "f_09"]
    for frame, original in zip(loaded, originals, strict=True):
        for key in ("density", "velocity", "obstacle"):
            np.testing.assert_array_equal(getattr(frame, key), getattr(original, key))


@pytest.mark.parametrize("format", FORMATS)
def test_other_grids_there_and_back(format: str, run: Run, tmp_path: Path) -> None:
    """With names and types as far as a format has them; what it does not hold is said."""
    rng = np.random.default_rng(0)
    grids = {"flame": rng.random(SHAPE), "Cd": rng.random((*SHAPE, 3)), "ids": rng.integers(0, 9, SHAPE)}
    kinds = {"flame": np.float32, "Cd": np.float32, "ids": np.int32}
    arrays = {name: values.astype(kinds[name]) for name, values in grids.items()}
    save_frames(tmp_path / "a.npz", Frame(rng.random(SHAPE), grids=arrays))
    ran = run("convert", tmp_path / "a.npz", tmp_path / f"f_01.{format}")
    held = {"flame", "Cd"} if format in ("vol", "uni") else {"flame", "Cd", "ids"}
    dropped = [f"note: .{format} files do not hold grids of such names: ids"] if "ids" not in held else []
    assert ran.code == 0 and [line for line in ran.errors if "do not hold" in line] == dropped
    assert run("convert", tmp_path / f"f_01.{format}", tmp_path / "b.npz").code == 0
    (again,) = load_frames(tmp_path / "b.npz")
    assert set(again.grids) == held
    for name in held:
        np.testing.assert_array_equal(again.grids[name], arrays[name])
        assert again.grids[name].dtype == arrays[name].dtype


def test_what_files_do_not_say_is_said_by_flags(run: Run, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    density, velocity = rng.random(SHAPE), rng.normal(size=(*SHAPE, 3)).astype(np.float32)
    np.savez(tmp_path / "a.npz", density=density, velocity=velocity)

    def converted(*flags: str) -> Frame:
        ran = run("convert", tmp_path / "a.npz", tmp_path / "b.vdb", *flags)
        assert ran.code == 0, ran.errors
        return load_frames(tmp_path / "b.vdb")[0]

    np.testing.assert_array_equal(converted("--up", "z").density, from_z_up(density).astype(np.float32))
    np.testing.assert_array_equal(converted("--up", "z").velocity, from_z_up(velocity))
    flipped = converted("--flip", "x,z")
    np.testing.assert_array_equal(flipped.density, density[::-1, :, ::-1].astype(np.float32))
    np.testing.assert_array_equal(flipped.velocity, velocity[::-1, :, ::-1] * np.float32([-1, 1, -1]))
    for flags, factor in (
        (("--velocity-units", "cells-per-time"), 0.1),
        (("--velocity-units", "cells-per-time", "--dt", "0.5"), 0.5),
        (("--velocity-units", "length-per-time", "--voxel-size", "0.25"), 1 / 24 / 0.25),
        (("--velocity-units", "length-per-time", "--voxel-size", "0.25", "--dt", "0.04"), 0.04 / 0.25),
    ):
        np.testing.assert_allclose(converted(*flags).velocity, velocity * factor, rtol=1e-6)
    assert converted("--voxel-size", "0.25").placement == Placement(0.25)
    # Of npz the axis that is up is read, not the one of the scene that it goes to.
    assert converted("--voxel-size", "0.25", "--up", "y").placement == Placement(0.25)


@pytest.mark.parametrize("format", FORMATS)
def test_the_velocity_of_a_run_is_no_frame(
    format: str, run: Run, moving: Path, tmp_path: Path, optimiser: FakeOptimiser
) -> None:
    out = tmp_path / "run"
    tnst_mi.stylize(moving, Recipe(style=("spirals",), format=format), out, progress=False)
    message = (
        rf"^tnst-mi: 3 of 3 frames cannot be read \(f_07\.{format}, f_08\.{format}, f_09\.{format}\): "
        r"holds the velocity v\* of a run and is no frame; its frames are in .*density$"
    )
    refused(run, tmp_path, ["convert", out / "velocity", tmp_path / "frames"], message)
    ran = run("info", out / "velocity")
    assert (ran.code, ran.errors) == (0, []) and ran.out.count("no frame") == 3


def test_where_the_grid_lies_is_told_once_before_it_is_lost(run: Run, tmp_path: Path) -> None:
    frames = [Frame(np.ones(SHAPE), None, None, f"f_{n}", n, Placement(0.5, (1.0, 2.0, 3.0), "y")) for n in (1, 2)]
    save_frames(tmp_path / "in", frames, format="vdb")
    ran = run("convert", tmp_path / "in", tmp_path / "out", "--format", "uni")
    notes = [line for line in ran.errors if line.startswith("note: ")]
    place = "where the grid lies in its scene: voxel size 0.5, corner (1, 2, 3), y up"
    assert ran.code == 0 and notes == [f"note: .uni files do not hold {place}"]
    ran = run("convert", tmp_path / "in", tmp_path / "again", "--format", "vdb")
    assert load_frames(tmp_path / "again")[0].placement == Placement(0.5, (1.0, 2.0, 3.0), "y")
    assert not [line for line in ran.errors if line.startswith("note: ")]


def test_bad_requests(run: Run, moving: Path, tmp_path: Path) -> None:
    file = moving / "f_07.npz"
    for arguments, message in (
        ([moving, tmp_path / "a.vdb"], "a file holds one frame and there are 3; give a folder"),
        ([file, tmp_path / "a.abc"], "unknown format '.abc', expected one of .npz, .vol, .uni, .vdb"),
        ([file, tmp_path / "a.vdb", "--format", "uni"], "is named as a .vdb file"),
        ([file, file], "is the input, or would replace a part of it; give another name"),
        ([file, moving], "contains the input"),
        ([tmp_path / "nothing", tmp_path / "a.vdb"], "nothing: no such file or folder"),
        ([file, tmp_path / "a.vdb", "--flip", "w"], "--flip w: expected axes out of x, y and z"),
        ([file, tmp_path / "a.vdb", "--dt", "0"], "--dt 0: expected a number above 0"),
        ([file, tmp_path / "a.vdb", "--voxel-size", "-1"], "--voxel-size -1: expected a number above 0"),
        ([moving, tmp_path / "out", "--frames", "7:12"], "has the frames 7 to 9"),
        ([moving, tmp_path / "out", "--frames", "7:"], "--frames 7:: expected a range of frame numbers"),
    ):
        refused(run, tmp_path, ["convert", *arguments], message)
    for flags, message in (
        (("--velocity-units", "length-per-time"), "f_07.npz: velocity in length-per-time needs the size of a cell"),
        (("--dt", "0.5"), "f_07.npz: velocity is in cells-per-frame, which --dt does not change"),
    ):
        ran = run("convert", file, tmp_path / "a.vdb", *flags)
        assert ran.code == 2 and message in ran.errors[-1]
    assert not (tmp_path / "a.vdb").exists()


def test_a_file_is_not_converted_onto_a_part_of_itself(run: Run, moving: Path, tmp_path: Path) -> None:
    whole, plain = tmp_path / "c_001.vol", tmp_path / "p_001.uni"
    save_frames(whole, load_frames(moving)[0])
    save_frames(plain, Frame(np.ones(SHAPE)))
    (tmp_path / "link").symlink_to(tmp_path)
    for given, output in (
        (whole, tmp_path / "c_velocity_001.vol"),
        (whole, tmp_path / "link" / "c_obstacle_001.vol"),
        (plain, tmp_path / "p_vel_001.uni"),  # would be read as the velocity of its input
    ):
        refused(run, tmp_path, ["convert", given, output], "is the input, or would replace a part of it")
    flags = tmp_path / "f_flags_001.vol"
    save_frames(flags, Frame(np.ones(SHAPE)))
    refused(run, tmp_path, ["convert", flags, tmp_path / "f_001.vol"], "is the input, or would replace a part of it")


def test_where_a_file_cannot_be(run: Run, moving: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    refused(run, tmp_path, ["convert", moving / "f_07.npz", tmp_path / "file" / "x.vdb"], "file: is a file, expected")
    if Path("/proc").is_dir():
        refused(run, tmp_path, ["convert", moving / "f_07.npz", "/proc/x.vdb"], "/proc: cannot be written to")


def test_what_was_written_before_a_bad_frame_is_told(run: Run, moving: Path, tmp_path: Path) -> None:
    save_frames(moving / "f_09.npz", Frame(np.ones((2, 3, 4))))
    ran = run("convert", moving, tmp_path / "out", "--format", "vol")
    assert ran.code == 2 and len(ran.out.splitlines()) == 2
    assert re.search(r"f_09: density has shape .*; the frames before it have been written: empty .*out", ran.errors[-1])
    (moving / "f_07.npz").write_bytes(b"PK")
    ran = run("convert", moving, tmp_path / "other")
    assert ran.code == 2 and "empty" not in ran.errors[-1]


def test_info_describes_every_file_of_a_mixed_folder(run: Run, moving: Path) -> None:
    save_frames(moving / "f_10.uni", load_frames(moving)[0])
    out = run("info", moving).out
    assert out.count("read as: z up") == out.count("f_10.uni: shape (z, y, x) (4, 6, 5)") == 1


def test_info_describes_every_sequence_of_a_folder_and_asks_as_the_others_do(
    run: Run, moving: Path, tmp_path: Path
) -> None:
    for frame in load_frames(moving):
        save_frames(moving / f"{frame.name}.vol", frame)
        save_frames(moving / f"g_{frame.number}.npz", frame)
    ran = run("info", moving)
    described = {line.split(":")[0][2:] for line in ran.out.splitlines() if ": shape (z, y, x)" in line}
    assert described == {f"f_{number:02}.{kind}" for number in (7, 8, 9) for kind in ("npz", "vol")} | {
        f"g_{number}.npz" for number in (7, 8, 9)
    }
    other = run("convert", moving, tmp_path / "out")
    assert ran.code == other.code == 2 and ran.errors == other.errors
    assert "has 3 sequences: f_##.npz (7 to 9), f_##.vol (7 to 9), g_#.npz (7 to 9); give one" in ran.errors[0]


def test_info_describes_every_format(run: Run, moving: Path, tmp_path: Path) -> None:
    (frame,) = load_frames(moving / "f_07.npz")
    contents = f"mass {frame.mass:g}, 0.0% of cells empty"
    for format, expected in (
        (
            "vol",
            ["f_velocity_##.vol: float32, shape (4, 6, 5, 3)", "read as: y up, velocity at centres in cells-per-frame"],
        ),
        ("uni", ["f_##.uni: float32, shape (6, 4, 5) in its own axes", "read as: z up"]),
        ("vdb", ["grid 'velocity': vec3s, unknown, blosc, from (0, 0, 0)", "voxel size 1, 120 active voxels"]),
    ):
        save_frames(tmp_path / f"f_07.{format}", frame)
        ran = run("info", tmp_path / f"f_07.{format}")
        assert (ran.code, ran.errors) == (0, [])
        for words in (*expected, contents, "shape (z, y, x) (4, 6, 5)", "velocity at most", "obstacle of "):
            assert words in ran.out


@pytest.mark.parametrize("given", FORMATS)
def test_results_come_in_the_format_of_the_input(
    given: str, optimiser: FakeOptimiser, moving: Path, tmp_path: Path
) -> None:
    place = Placement(0.25, (1.0, 2.0, 3.0), "y")
    frames = [Frame(f.density, f.velocity, None, f.name, f.number, place) for f in load_frames(moving)]
    save_frames(tmp_path / "in", frames, format=given)
    result = tnst_mi.stylize(tmp_path / "in", Recipe(style=("spirals",)), tmp_path / "out", progress=False)
    names = {path.name for path in (tmp_path / "out" / "density").iterdir()}
    # The velocity of the simulation moves with the smoke.
    beside = [] if given in ("npz", "vdb") else ["velocity_"]
    assert names == {f"f_{part}0{number}.{given}" for number in (7, 8, 9) for part in ("", *beside)}
    for index, frame in enumerate(frames):
        np.testing.assert_array_equal(result.densities[index], 2 * frame.density)
    written = load_frames(tmp_path / "out" / "density")
    assert written[0].placement == (place if given == "vdb" else None)
    assert result.velocities[0].shape == (*SHAPE, 3)


def test_another_format_is_asked_for_resumed_and_overwritten(
    optimiser: FakeOptimiser, moving: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"

    def written() -> set[str]:
        return {str(path.relative_to(out)) for kind in ("density", "velocity") for path in (out / kind).iterdir()}

    recipe = Recipe(style=("spirals",), format="vdb")
    optimiser.interrupt_at = "f_08"
    list(Run(prepare(moving, recipe, out), progress=False))
    assert written() == {"density/f_07.vdb", "velocity/f_07.vdb"}
    optimiser.interrupt_at, optimiser.names[:] = None, []
    list(Run(prepare(moving, recipe, out, resume=True), progress=False))
    assert optimiser.names == ["f_08", "f_09"]
    assert written() == {f"{kind}/f_0{number}.vdb" for kind in ("density", "velocity") for number in (7, 8, 9)}
    assert [grid.name for grid in read_vdb(out / "velocity" / "f_07.vdb").grids] == ["velocity"]
    list(Run(prepare(moving, Recipe(style=("spirals",)), out, overwrite=True), progress=False))
    assert written() == {f"{kind}/f_0{number}.npz" for kind in ("density", "velocity") for number in (7, 8, 9)}


def test_a_run_is_resumed_in_its_format_only(optimiser: FakeOptimiser, moving: Path, tmp_path: Path) -> None:
    frames, recipe = load_frames(moving), Recipe(style=("spirals",))
    for format in ("vdb", "vol"):
        save_frames(tmp_path / format, frames, format)
    tnst_mi.stylize(tmp_path / "vdb", recipe, tmp_path / "out", progress=False)
    with pytest.raises(InputError, match="its run wrote vdb files, in the format of its input, which now is vol"):
        Run(prepare(tmp_path / "vol", recipe, tmp_path / "out", resume=True), progress=False)
    assert len(load_frames(tmp_path / "out" / "density")) == 3


@pytest.mark.parametrize("format", FORMATS)
def test_results_have_the_obstacles_of_their_frames(
    format: str, optimiser: FakeOptimiser, moving: Path, tmp_path: Path
) -> None:
    out, recipe = tmp_path / "out", Recipe(style=("spirals",), format=format)
    tnst_mi.stylize(moving, recipe, out, progress=False)
    for result, frame in zip(load_frames(out / "density"), load_frames(moving), strict=True):
        np.testing.assert_array_equal(result.obstacle, frame.obstacle)
    # Overwriting knows of the files that they are in.
    list(Run(prepare(load_frames(moving)[:1], recipe, out, overwrite=True), progress=False))
    assert not [path for path in out.rglob("*") if "08" in path.name]


def test_a_houdini_sequence_keeps_its_box_and_axes(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    density = np.ones((4, 4, 4), np.float32)
    (tmp_path / "in").mkdir()
    for number, first in ((1, (0, 0, 0)), (2, (2, 0, 0))):
        write_vdb(tmp_path / "in" / f"pyro_{number}.vdb", [DenseGrid("density", density, first, 0.5)], {})
    tnst_mi.stylize(tmp_path / "in", Recipe(style=("spirals",)), tmp_path / "out", progress=False)
    (grid,) = read_vdb(tmp_path / "out" / "density" / "pyro_2.vdb").grids
    low, high = grid.tree.active_box()
    assert (low.tolist(), high.tolist(), grid.voxel_size) == ([2, 0, 0], [5, 3, 3], 0.5)
    assert [frame.density.shape for frame in load_frames(tmp_path / "out" / "density")] == [(4, 4, 6)] * 2
