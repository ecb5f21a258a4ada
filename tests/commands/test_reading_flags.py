"""Reading flags on every command that reads; what was read is said; `info` fails where `stylize` does, in its words."""

from __future__ import annotations

import io
import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, refused, run, smoke
from jobs import SHAPE, FakeOptimiser, optimiser

from tnst_mi.io import load_frames, save_frames
from tnst_mi.io.grids.vdb import DenseGrid, read_vdb, write_vdb
from tnst_mi.io.interpretation.orientation import from_z_up
from tnst_mi.recipe.recipe import Recipe

__all__ = ["optimiser", "run", "smoke"]

DENSITY = np.random.default_rng(0).random(SHAPE).astype(np.float32) + 0.1
VELOCITY = np.random.default_rng(1).normal(size=(*SHAPE, 3)).astype(np.float32)


@pytest.fixture
def heat(tmp_path: Path) -> Path:
    """A file of another program, whose density and velocity have names that nobody expects."""
    grids = [DenseGrid("heat", DENSITY), DenseGrid("wind", VELOCITY), DenseGrid("flame", DENSITY)]
    write_vdb(tmp_path / "heat.vdb", grids, {})
    return tmp_path / "heat.vdb"


FLAGS = ("--density", "heat", "--velocity", "wind", "--up", "z", "--fps", "30", "--flip", "x", "--scale", "0.5")
SAID = (
    "read as: z up, velocity at centres in length-per-time, 0.03333 time units per frame, voxel size 1; "
    "density from 'heat', velocity from 'wind', no obstacle; other grids: 'flame'"
)


def commands(path: Path, out: Path) -> dict[str, list[object]]:
    return {
        "stylize": ["stylize", path, "--out", out / "s", "--style", "spirals"],
        "render": ["render", path, "--out", out / "r"],
        "convert": ["convert", path, out / "c", "--format", "vdb"],
        "info": ["info", path],
    }


def test_every_command_reads_as_it_is_told_and_says_so(
    run: Run, heat: Path, tmp_path: Path, optimiser: FakeOptimiser
) -> None:
    for name, arguments in commands(heat, tmp_path).items():
        ran = run(*arguments, *FLAGS)
        assert ran.code == 0, (name, ran.errors)
        assert sum(SAID in line for line in (*ran.errors, *ran.out.splitlines())) == 1, name
    (converted,) = load_frames(tmp_path / "c")
    np.testing.assert_allclose(converted.density, from_z_up(DENSITY)[..., ::-1] / 2, rtol=1e-6)
    expected = from_z_up(VELOCITY)[..., ::-1, :] * np.float32([-1, 1, 1]) / 30
    np.testing.assert_allclose(converted.velocity, expected, rtol=1e-5, atol=1e-7)
    # The results of the stand-in for an optimiser are twice what was read.
    grid = read_vdb(tmp_path / "s" / "density" / "heat.vdb").grids[0]
    assert grid.tree.leaf_values.max() == pytest.approx(DENSITY.max(), rel=1e-6)


def test_compare_reads_as_it_is_told(run: Run, heat: Path, tmp_path: Path) -> None:
    message = r"heat\.vdb: no grid 'density', the grids found are: 'heat', 'wind', 'flame'; choose with --density NAME"
    refused(run, tmp_path, ["compare", heat, "--out", tmp_path / "out"], message)
    np.savez(tmp_path / "a.npz", density=DENSITY, velocity=VELOCITY)
    message = "velocity is in cells-per-frame, which --dt does not change; give --units too"
    refused(run, tmp_path, ["compare", tmp_path / "a.npz", "--out", tmp_path / "out", "--dt", "2"], message)


def test_recipes_keep_how_files_were_read(run: Run, heat: Path, tmp_path: Path, optimiser: FakeOptimiser) -> None:
    (tmp_path / "r.toml").write_text(
        'style = ["spirals"]\ndensity = "heat"\nvelocity = "wind"\nup = "z"\norigin = [1, 2, 3]\n'
    )
    arguments = [
        "stylize",
        heat,
        "--recipe",
        tmp_path / "r.toml",
        "--out",
        tmp_path / "out",
        "--units",
        "cells-per-frame",
    ]
    assert run(*arguments).code == 0
    kept = Recipe.from_toml(tmp_path / "out" / "recipe.toml")
    assert (kept.density, kept.velocity, kept.up, kept.origin) == ("heat", "wind", "z", (1.0, 2.0, 3.0))
    assert kept.units == "cells-per-frame"
    ran = run("stylize", heat, "--recipe", tmp_path / "out" / "recipe.toml", "--out", tmp_path / "out", "--resume")
    assert ran.code == 0, ran.errors
    ran = run(*arguments, "--resume", "--up", "y")
    assert ran.code == 2 and "its run had up = 'z' and the recipe now has 'y'" in ran.errors[-1]


def test_an_earlier_name_of_a_flag_still_works(run: Run, heat: Path) -> None:
    ran = run("info", heat, "--density", "heat", "--velocity", "wind", "--velocity-units", "cells-per-frame")
    assert ran.code == 0 and "velocity at centres in cells-per-frame" in ran.out


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--up", "x"], "--up x: expected y or z"),
        (["--flip", "w"], "--flip w: expected axes out of x, y and z"),
        (["--units", "knots"], "--units knots: expected cells-per-frame, cells-per-time or length-per-time"),
        (["--dt", "0"], "--dt 0: expected a number above 0"),
        (["--fps", "0"], "--fps 0: expected a number above 0"),
        (["--scale", "-1"], "--scale -1: expected a number above 0"),
        (["--voxel-size", "nan"], "--voxel-size nan: expected a number above 0"),
        (["--origin", "1,2"], "--origin 1,2: expected three numbers X,Y,Z"),
        (["--velocity", "wind"], "a.npz: --velocity 'wind': no such array, those found are: density"),
    ],
)
def test_bad_flags_are_refused_by_all(flags: list[str], message: str, run: Run, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", density=DENSITY)
    for arguments in commands(tmp_path / "a.npz", tmp_path).values():
        refused(run, tmp_path, [*arguments, *flags], message)


def npz(**arrays: object) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def vdb(path: Path, *grids: DenseGrid) -> bytes:
    write_vdb(path, grids, {})
    content = path.read_bytes()
    path.unlink()
    return content


BAD: dict[str, Callable[[Path], tuple[str, bytes]]] = {
    "empty": lambda folder: ("a.vdb", b""),
    "another format": lambda folder: ("a.npz", b"no zip"),
    "cut short": lambda folder: ("a.npz", npz(density=DENSITY)[:300]),
    "no density": lambda folder: ("a.npz", npz(temp=DENSITY)),
    "only a temperature": lambda folder: ("a.vdb", vdb(folder / "t.vdb", DenseGrid("temperature", DENSITY))),
    "a velocity and a temperature": lambda folder: ("a.npz", npz(velocity=VELOCITY, temperature=DENSITY)),
    "a velocity and an obstacle": lambda folder: (
        "a.vdb",
        vdb(folder / "t.vdb", DenseGrid("velocity", VELOCITY), DenseGrid("obstacle", DENSITY)),
    ),
    "nameless": lambda folder: ("a.vdb", vdb(folder / "t.vdb", DenseGrid("", DENSITY))),
    "two densities": lambda folder: ("a.npz", npz(smoke=DENSITY, fog=DENSITY)),
    "no voxels": lambda folder: ("a.vdb", vdb(folder / "t.vdb", DenseGrid("density", 0 * DENSITY))),
    "no grids": lambda folder: ("a.vdb", vdb(folder / "t.vdb")),
    "pickled": lambda folder: ("a.npz", npz(density=np.array([{}], object))),
    "text": lambda folder: ("a.npz", npz(density=np.array([["a"]]))),
    "four axes": lambda folder: ("a.npz", npz(density=np.stack([DENSITY, DENSITY]))),
    "negative": lambda folder: ("a.npz", npz(density=DENSITY - 0.2)),
    "not a number": lambda folder: ("a.npz", npz(density=DENSITY * np.nan)),
    "infinite velocity": lambda folder: ("a.npz", npz(density=DENSITY, velocity=VELOCITY * np.inf)),
    "velocity of another shape": lambda folder: ("a.npz", npz(density=DENSITY, velocity=DENSITY)),
    "obstacle of another range": lambda folder: ("a.npz", npz(density=DENSITY, obstacle=7 * np.ones(SHAPE))),
    "velocity of other voxels": lambda folder: (
        "a.vdb",
        vdb(folder / "t.vdb", DenseGrid("density", DENSITY), DenseGrid("obstacle", DENSITY, (0, 0, 0), 0.5)),
    ),
}


@pytest.mark.parametrize("kind", BAD)
def test_info_fails_where_stylize_does_in_its_words(
    kind: str, run: Run, tmp_path: Path, optimiser: FakeOptimiser
) -> None:
    name, content = BAD[kind](tmp_path)
    (tmp_path / name).write_bytes(content)
    ran = {command: run(*arguments) for command, arguments in commands(tmp_path / name, tmp_path).items()}
    assert {answer.code for answer in ran.values()} == {2}
    assert {answer.errors[-1] for answer in ran.values()} == {ran["stylize"].errors[-1]}
    assert str(tmp_path / name) in ran["stylize"].errors[-1]
    assert len(ran["stylize"].errors[-1].replace(str(tmp_path), "")) <= 300
    assert not any((tmp_path / out).exists() for out in "src")


def test_info_fails_on_sequences_as_stylize_does(run: Run, tmp_path: Path, optimiser: FakeOptimiser) -> None:
    for number in range(4):
        np.savez(tmp_path / f"f_{number}.npz", density=DENSITY)
    (tmp_path / "f_1.npz").write_bytes(b"")
    (tmp_path / "f_3.npz").write_bytes(b"PK")
    answers = [run(*arguments) for arguments in commands(tmp_path, tmp_path.parent / f"{tmp_path.name}_out").values()]
    assert {answer.code for answer in answers} == {2}
    assert len({answer.errors[-1] for answer in answers}) == 1
    assert "2 of 4 frames cannot be read: " in answers[0].errors[-1]
    skipping = run("info", tmp_path, "--skip-bad")
    assert skipping.code == 0 and "  f_0.npz: shape" in skipping.out and "  f_1.npz" not in skipping.out
    assert "  note: left out, since they cannot be read: f_1.npz: is empty" in skipping.out
    ran = run("convert", tmp_path, tmp_path.parent / f"{tmp_path.name}_out", "--format", "vol", "--skip-bad")
    assert ran.code == 0 and [line.split("/")[-1] for line in ran.out.splitlines()] == ["f_0.vol", "f_2.vol"]
    assert any(line.startswith("note: left out, since they cannot be read: f_1.npz: is empty") for line in ran.errors)


def test_info_tells_what_can_be_chosen(run: Run, heat: Path, tmp_path: Path) -> None:
    ran = run("info", heat)
    assert ran.code == 2 and "'heat', 'wind', 'flame'; choose with --density NAME" in ran.errors[-1]
    for name in ("heat", "wind", "flame"):
        assert f"grid {name!r}: " in ran.out
    assert f"{DENSITY.min():g} to {DENSITY.max():g}" in ran.out
    np.savez(tmp_path / "a.npz", density=np.uint8([[[0, 255]]]), notes=np.array([{}], object), title=np.array("smoke"))
    ran = run("info", tmp_path / "a.npz")
    assert ran.code == 0
    assert "array 'density': uint8, shape (1, 1, 2), 0 to 255" in ran.out
    assert "array 'notes': object, shape (1,), pickled objects, which are never read" in ran.out
    assert "density times 1/255 (uint8, as in pictures; --scale)" in ran.out
    np.savez(tmp_path / "b.npz", density=np.int16([[[0, 1177]]]))
    assert "density as stored (int16; --scale)" in run("info", tmp_path / "b.npz").out
    assert "as stored" not in run("info", tmp_path / "b.npz", "--scale", "0.1").out
    assert "not read: notes, title" in ran.out


def test_what_looks_like_a_velocity_is_said(run: Run, tmp_path: Path) -> None:
    note = "note: looks like a velocity, which --velocity NAME takes it for: 'wind': a"
    np.savez(tmp_path / "a.npz", rho=DENSITY, wind=VELOCITY)
    write_vdb(tmp_path / "a.vdb", [DenseGrid("density", DENSITY), DenseGrid("wind", VELOCITY)], {})
    for name in ("a.npz", "a.vdb"):
        ran = run("convert", tmp_path / name, tmp_path / "b.npz")
        assert ran.code == 0 and note in ran.errors
        ran = run("convert", tmp_path / name, tmp_path / "b.npz", "--velocity", "wind")
        assert ran.code == 0 and note not in ran.errors and load_frames(tmp_path / "b.npz")[0].velocity is not None


@pytest.mark.parametrize("word", ["density", "dens", "rho", "d", "smoke", "fog", "Rho"])
def test_names_of_densities_are_the_same_for_grids_and_files(word: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "whole.npz", **{word: DENSITY, "velocity": VELOCITY})
    np.savez(tmp_path / f"{word}_0001.npz", data=DENSITY)
    np.savez(tmp_path / "velocity_0001.npz", data=VELOCITY)
    for name in ("whole.npz", f"{word}_0001.npz"):
        (frame,) = load_frames(tmp_path / name)
        np.testing.assert_array_equal(frame.density, DENSITY)
        np.testing.assert_array_equal(frame.velocity, VELOCITY)


def test_frames_without_smoke_are_said(run: Run, tmp_path: Path, optimiser: FakeOptimiser) -> None:
    for number, arrays in enumerate(({"density": DENSITY}, {"velocity": VELOCITY}, {"density": 0 * DENSITY})):
        np.savez(tmp_path / f"f_{number}.npz", **arrays)
    for arguments in itertools.islice(commands(tmp_path, tmp_path.parent / f"{tmp_path.name}_out").values(), 3):
        ran = run(*arguments)
        assert ran.code == 0, ran.errors
        assert "note: has no density, so it is taken as a frame without smoke: f_1" in ran.errors
        assert "note: no smoke in it: f_2" in ran.errors
    assert load_frames(tmp_path)[1].velocity is not None


def test_results_are_read_again_without_being_told_how(
    run: Run, heat: Path, tmp_path: Path, optimiser: FakeOptimiser
) -> None:
    """Results keep the names of their source, which only the user could tell; they tell them from then on."""
    out = tmp_path / "out"
    assert run("stylize", heat, "--out", out, "--style", "spirals", *FLAGS).code == 0
    assert [grid.name for grid in read_vdb(out / "density" / "heat.vdb").grids] == ["heat", "wind", "flame"]
    ran = run("info", out)
    assert ran.code == 0 and "density from 'heat', velocity from 'wind'" in ran.out
    assert f"note: {out}: is the folder of a run; the frames are read from {out / 'density'}" in ran.out
    again = tmp_path / "again"
    assert run("stylize", out, "--out", again, "--style", "spirals").code == 0
    np.testing.assert_allclose(load_frames(again)[0].density, 2 * load_frames(out)[0].density)  # the fake's doing
    # What the user names goes before what the file tells.
    assert run("convert", heat, tmp_path / "all.vdb", *FLAGS).code == 0
    (converted,) = load_frames(tmp_path / "all.vdb")
    assert converted.velocity is not None
    assert "density from 'heat', velocity from 'wind'" in converted.reading
    wrong = ["render", tmp_path / "all.vdb", "--out", tmp_path / "pictures", "--density", "fog"]
    refused(run, tmp_path, wrong, "--density 'fog': no such grid")


def test_results_of_npy_files_are_npz(run: Run, tmp_path: Path, optimiser: FakeOptimiser) -> None:
    np.save(tmp_path / "a.npy", DENSITY)
    assert run("stylize", tmp_path / "a.npy", "--out", tmp_path / "out", "--style", "spirals").code == 0
    assert [path.name for path in (tmp_path / "out" / "density").iterdir()] == ["a.npz"]
    save_frames(tmp_path / "b.npz", load_frames(tmp_path / "a.npy"))
    np.testing.assert_array_equal(load_frames(tmp_path / "b.npz")[0].density, DENSITY)
