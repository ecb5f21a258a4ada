"""The command line: help, usage, precedence of flags, exit codes, and what the commands answer."""

from __future__ import annotations

import errno
import importlib
import inspect
import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from command_line import Run, refused, run, smoke
from jobs import FakeOptimiser, frames, optimiser
from networks import random_googlenet

from tnst_mi.cli import COMMANDS, READER_LEFT
from tnst_mi.commands import doctor
from tnst_mi.commands.arguments import ARGUMENTS
from tnst_mi.errors import InputError
from tnst_mi.io import save_frames
from tnst_mi.io.grids.vdb import DenseGrid, write_vdb
from tnst_mi.recipe.keyframes import KEYABLE
from tnst_mi.recipe.paths import STYLES
from tnst_mi.recipe.recipe import KINDS, Recipe

__all__ = ["optimiser", "run", "smoke"]


# --- Commands, help and usage -----------------------------------------------------------------------------


def test_help_names_every_command_and_every_flag(run: Run) -> None:
    ran = run("--help")
    assert ran.code == 0 and ran.errors == []
    assert all(name in ran.out for name in COMMANDS)
    assert run().out == ran.out
    ran = run("stylize", "--help")
    assert ran.code == 0 and ran.errors == []
    for name in (*(name for name in KINDS if name != "target"), "out", "recipe", "resume", "overwrite", "debug"):
        assert f"--{name.replace('_', '-')} " in ran.out
    for name in COMMANDS:
        ran = run(name, "--help")
        assert ran.code == 0 and "(default: )" not in ran.out


def test_help_says_how_to_write_keyframes_where_they_are_taken(run: Run) -> None:
    def flags(*command: str) -> dict[str, str]:
        lines = [line.strip("│ ") for line in run(*command, "--help").out.splitlines()]
        texts = re.split(r" (?=--[a-z])", " ".join(lines))
        return {text.split()[0][2:].replace("-", "_"): text for text in texts if text.startswith("--")}

    of_stylize = flags("stylize")
    keyed = {key for key, text in of_stylize.items() if "Keyframes, in quotes: {49 = " in text}
    assert keyed == set(KEYABLE) and set(of_stylize) >= set(KINDS) - {"target"}, "which is for recipe files alone"
    assert not any("Keyframes" in text for text in flags("render").values())


def test_info_takes_a_part_of_a_sequence(run: Run, smoke: Path) -> None:
    ran = run("info", smoke, "--frames", "8:9")
    assert ran.code == 0 and "f_08" in ran.out and "f_09" in ran.out and "f_07" not in ran.out


@pytest.mark.parametrize(("text", "value"), [("on", True), ("true", True), ("off", False), ("false", False)])
def test_switches_are_on_or_off(text: str, value: bool) -> None:
    recipe = Recipe().updated_by_flags({"crop": text, "fit": text})
    assert (recipe.crop, recipe.fit) == (value, value)
    assert KINDS["crop"].show(value) == ("on" if value else "off")


def test_the_overview_says_what_the_help_of_each_command_says(run: Run) -> None:
    """It is a table, so that it needs not import the commands."""
    assert list(COMMANDS) == list(ARGUMENTS)
    overview = " ".join(run("--help").out.split())
    for name, summary in COMMANDS.items():
        assert " ".join(inspect.getdoc(ARGUMENTS[name]).split("\n\n")[0].split()) == summary
        assert f"{name} {summary}" in overview
        assert callable(importlib.import_module(f"tnst_mi.commands.{name}").run)


def test_what_is_not_needed_is_not_imported(tmp_path: Path) -> None:
    """The overview and wrong names need no command, those that only read and write no torch."""
    np.savez(tmp_path / "a.npz", density=np.ones((2, 2, 2)))
    program = (
        "import sys; from tnst_mi.cli import main; main(sys.argv[1:]); "
        "print([name for name in ('tyro', 'torch', 'matplotlib') if name in sys.modules])"
    )
    for line, imported in (("--help", "[]"), ("styliz", "[]"), (f"info {tmp_path / 'a.npz'}", "['tyro']")):
        done = subprocess.run(
            [sys.executable, "-c", program, *line.split()], capture_output=True, text=True, check=True
        )
        assert done.stdout.splitlines()[-1] == imported


@pytest.mark.parametrize(
    "line",
    [
        "stylize smoke --out b --style nett",
        "stylize smoke --out b --tag x --iterations 3.5",
        "stylize smoke --out b --tag x --window 4",
        "stylize smoke --out b --tag x --frames 40:50",
        "stylize smoke --out b --tag x --transport flow --steps 2",
        "stylize smoke --out b",
        "stylize smoke --out b --recipe bad.toml",
        "stylize smoke --out full --tag x",
        "stylize nowhere --out b --tag x",
        "demo --out full",
        "render smoke --out full",
        "render smoke --out b --frames 40:50",
        "compare smoke --out full",
        "convert smoke full",
        "info smoke --frames 40:50",
    ],
)
def test_mistakes_in_flags_are_found_before_anything_large_is_imported(line: str, smoke: Path, tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text("eta")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes").touch()
    program = (
        "import sys; from tnst_mi.cli import main; code = main(sys.argv[1:]); import mitsuba; "
        "sys.exit(f'{code} {mitsuba.variant()} ' + ', '.join({'torch', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, *line.split()], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.stderr.splitlines()[-1] == "2 None "


def test_help_loads_no_torch_and_starts_no_variant() -> None:
    program = (
        "import sys; from tnst_mi.cli import main; code = main(['stylize', '--help']); "
        "import mitsuba; heavy = {'torch', 'matplotlib'} & set(sys.modules); "
        "sys.exit(code or mitsuba.variant() or ', '.join(heavy) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("styliz a --out b", "no command 'styliz'; did you mean stylize?"),
        (
            "frobnicate",
            "expected one of demo, stylize, train, batch, reconstruct, render, show, diff, compare, convert, atlas, "
            "studio, info, weights, doctor",
        ),
        ("stylize", "Missing from tnst-mi stylize: --out FOLDER"),
        ("stylize a", "Missing from tnst-mi stylize: --out FOLDER"),
        ("stylize a --out", "Missing value for argument .*--out"),
        ("stylize a --out b --lamm 1", "unexpected '--lamm'; did you mean --lam?"),
        ("stylize a --out b --lamm=1", "unexpected '--lamm'; did you mean --lam?"),
        ("stylize a --out b c", "unexpected 'c'"),
        ("stylize --out b --tag x", "stylize: expected INPUT: a density file, a folder of numbered ones, or a pattern"),
        ("stylize --out b --resume", "b: no run to resume there; leave out --resume to begin one"),
        ("info", "expected one or more files"),
        ("render a --out b --views 1,2,3", "--views 1,2,3: expected AZIMUTH,ELEVATION"),
        ("render a --out b --views nan,0", "--views nan,0: expected"),
        ("render a --out b --gamma 0", "--gamma 0: expected a number above 0"),
        ("stylize a --out b --gamma x", "--gamma x: expected a number above 0"),
        ("stylize a --out b --azimuth 10,-10", "--azimuth 10,-10: expected two numbers LOW,HIGH, in this order, from"),
        ("stylize a --out b --azimuth -10", "--azimuth -10: expected two numbers"),
        ("stylize a --out b --quadrature Paper", "--quadrature Paper: expected paper, exact"),
        ("stylize a --out b --steps 0", "--steps 0: expected an integer"),
        ("stylize a --out b --semantic conv2", "--semantic conv2: expected a list of layers"),
        ("stylize a --out b --style nowhere.png", "--style: style = 'nowhere.png': no such picture"),
        ("stylize a --out b", "nothing to stylize towards"),
        ("stylize a --out b --tag x --light lamp.xml", "--light: light = 'lamp.xml': no such file, nor one of"),
        ("stylize a --out b --tag x --resume --overwrite", "expected only one of them"),
        ("stylize nowhere.npz --out b --tag x", "nowhere.npz: no such file"),
        ("stylize nowhere --out b --tag x", "nowhere: no such file or folder"),
        ("stylize nowhere.vdb --out b --tag x", "nowhere.vdb: no such file or folder"),
        ("info nowhere.npz", "nowhere.npz: no such file"),
        ("render nowhere.npz --out b", "nowhere.npz: no such file"),
    ],
)
def test_wrong_usage(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, message: str) -> None:
    monkeypatch.chdir(tmp_path)
    refused(run, tmp_path, line.split(), message)


# --- stylize ----------------------------------------------------------------------------------------------


def test_flags_win_over_the_recipe_and_the_recipe_over_the_defaults(
    run: Run, smoke: Path, tmp_path: Path, optimiser: FakeOptimiser
) -> None:
    recipe = tmp_path / "r.toml"
    recipe.write_text('style = ["net"]\neta = 0.01\ngamma = 0.5\nazimuth = [0, 1]\niterations = 1\nframes = "8:9"\n')
    ran = run(
        *("stylize", smoke, "--recipe", recipe, "--out", tmp_path / "out", "--gamma", "0.7"),
        *("--style", "spirals", "--style=cells", "--azimuth", "-20,20", "--semantic", "conv2/3x3:1,2"),
    )
    assert ran.code == 0, ran.errors
    assert optimiser.names == ["f_08", "f_09"]
    used = optimiser.calls[0]["recipe"]
    assert (used.eta, used.gamma, used.octaves, used.azimuth) == (0.01, 0.7, 3, (-20.0, 20.0))
    assert [Path(path).stem for path in used.style] == ["spirals", "cells"]
    assert used.semantic == ("conv2/3x3:1,2",)
    assert str(tmp_path / "out") in ran.out
    assert "mass 48 → 96 (+100.0%), largest displacement 5 cells" in ran.out
    assert any("octave 3/3" in line for line in ran.errors)


@pytest.mark.parametrize("flags", [("--azimuth", "-10,-.5"), ("--azimuth=-10,-.5",)])
def test_values_that_start_with_a_minus(
    run: Run, smoke: Path, tmp_path: Path, optimiser: FakeOptimiser, flags: tuple[str, ...]
) -> None:
    ran = run("stylize", smoke / "f_07.npz", "--out", tmp_path / "out", "--tag", "volcano", *flags)
    assert ran.code == 0, ran.errors
    assert optimiser.calls[0]["recipe"].azimuth == (-10.0, -0.5)


def test_an_interrupted_run_says_where_its_results_are(
    run: Run, smoke: Path, tmp_path: Path, optimiser: FakeOptimiser
) -> None:
    optimiser.interrupt_at = "f_08"
    arguments = ("stylize", smoke, "--out", tmp_path / "out", "--tag", "volcano", "--iterations", "1")
    ran = run(*arguments)
    assert ran.code == 3
    assert f"interrupted; --resume continues the run in {tmp_path / 'out'} where it stopped" in ran.errors[-1]
    assert json.loads((tmp_path / "out" / "run.json").read_text())["status"] == "interrupted"
    refused(run, tmp_path, list(arguments), "is not empty; continue its run with --resume")
    optimiser.interrupt_at = ""
    assert run(*arguments, "--resume").code == 0
    assert optimiser.names == ["f_07", "f_08", "f_09"]


def test_ctrl_c_before_the_work_says_that_nothing_has_changed(
    run: Run, smoke: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tnst_mi.run.prepare.brightness", interrupt)
    ran = run("stylize", smoke, "--out", tmp_path / "out", "--tag", "spiral", "--weights", "patterns")
    told = "tnst-mi: interrupted before the run began: nothing has changed, the same command begins anew"
    assert (ran.code, ran.errors[-1]) == (3, told)
    assert not (tmp_path / "out").exists()


def test_a_preset_that_the_recipe_overrules_says_so(
    run: Run, smoke: Path, tmp_path: Path, optimiser: FakeOptimiser
) -> None:
    arguments = ("stylize", smoke, "--out", tmp_path / "out", "--overwrite", "--tag", "volcano", "--preset", "paper")
    (room,) = (line for line in run(*arguments).errors if line.startswith(("note", "warning")))
    assert room == (
        "note: the smoke is seen in 6 rows, and a motif is drawn over some 24: finer smoke, or motif_size = 0.25, has "
        "room for more than one (docs/motifs.md)"
    )
    notes = [line for line in run(*arguments, "--sigma", "step", "--steps", "1").errors if line.startswith("note")]
    assert notes == ['note: preset = "paper" leaves sigma as the recipe gives them', room]
    finer = run(*arguments, "--motif-size", "0.25").errors
    assert not any("rows" in line for line in finer)
    thin = ("--density-scale", "0.1")
    assert any(line.startswith("warning: the density of thick smoke is 0.04") for line in run(*arguments, *thin).errors)


def test_failures_of_other_kinds(run: Run, smoke: Path, tmp_path: Path, optimiser: FakeOptimiser) -> None:
    arguments = ("stylize", smoke, "--out", tmp_path / "out", "--tag", "volcano", "--overwrite")
    optimiser.failure = RuntimeError("two\nlines")
    ran = run(*arguments)
    assert ran.errors[5].startswith("note: the smoke is seen in 6 rows")
    assert (ran.code, ran.errors[6:]) == (1, ["tnst-mi: RuntimeError: two lines (--debug shows where)"])
    said = [line.split(": ")[0] for line in ran.errors[:5]]
    assert said == ["device", "network", "read as", "memory", "density"] and ran.errors[1] == "network: bvlc, none"
    ran = run(*arguments, "--debug")
    assert ran.code == 1
    assert ran.errors[6].startswith("Traceback") and ran.errors[-1] == "tnst-mi: RuntimeError: two lines"
    optimiser.failure = KeyboardInterrupt()
    ran = run(*arguments)
    assert ran.code == 3 and "--resume continues" in ran.errors[-1] and len(ran.errors) == 7
    optimiser.failure = OSError(errno.ENOSPC, "No space left on device")
    ran = run(*arguments)
    assert ran.code == 3 and "the disk is full; free some space" in ran.errors[-1]


def test_wrapped_failures_tell_their_cause(run: Run, smoke: Path, tmp_path: Path, optimiser: FakeOptimiser) -> None:
    def wrapped(cause: Exception) -> RuntimeError:
        outer = RuntimeError("outer")
        outer.__cause__ = RuntimeError("middle")
        outer.__cause__.__cause__ = cause
        return outer

    arguments = ("stylize", smoke, "--out", tmp_path / "out", "--tag", "volcano", "--overwrite")
    optimiser.failure = wrapped(OSError("the disk"))
    ran = run(*arguments)
    told = "tnst-mi: RuntimeError: outer, caused by OSError: the disk (--debug shows where)"
    assert (ran.code, ran.errors[-1]) == (1, told)
    optimiser.failure = wrapped(InputError("the picture"))
    ran = run(*arguments)
    assert (ran.code, ran.errors[-1]) == (2, "tnst-mi: the picture")


def test_a_reader_that_leaves_early_is_no_failure(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", density=np.ones((2, 2, 2)))
    program = "import sys; from tnst_mi.cli import main; sys.stdin.read(); sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", program, "info", str(tmp_path / "a.npz")]
    streams = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **streams) as process:
        process.stdout.close()
        process.stdin.close()
        assert process.stderr.read() == b""
    assert process.returncode == READER_LEFT == 128 + signal.SIGPIPE


def test_only_stylize_offers_to_resume(run: Run, smoke: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tnst_mi.io.sequence.read_stored", interrupt)
    for arguments in (("info", smoke), ("render", smoke, "--out", tmp_path / "out")):
        ran = run(*arguments)
        assert (ran.code, ran.errors) == (3, ["tnst-mi: interrupted"])


def test_frames_that_render_black_are_warned_of(run: Run, tmp_path: Path, optimiser: FakeOptimiser) -> None:
    """Of a wall in units of its own no light gets out. In the wall's units, the other frame is next to nothing."""
    save_frames(tmp_path / "smoke", frames(1e6, 3e-4, 0.0))

    def warnings(*flags: str) -> list[str]:
        arguments = ("stylize", tmp_path / "smoke", "--out", tmp_path / "out", "--overwrite", "--tag", "volcano")
        ran = run(*arguments, "--gamma", "0.5", *flags)
        assert ran.code == 0, ran.errors
        return [line for line in ran.errors if line.startswith("warning")]

    black = "warning: f_07 renders black at this gamma in the main view"
    assert warnings("--density-scale", "1")[1:] == [black]
    faint = "warning: f_08: hardly changed, since in view is less than 0.1% of the smoke of another frame"
    assert warnings() == [faint]
    save_frames(tmp_path / "smoke", frames(1e30, 0.3, 0.0))
    arguments = ("stylize", tmp_path / "smoke", "--out", tmp_path / "out", "--overwrite", "--tag", "volcano")
    ran = run(*arguments, "--density-scale", "1")
    assert ran.code == 2 and "makes the density of 1e+30 larger than 1e+15" in ran.errors[-1]


def test_demo_replaces_an_earlier_demo_only(
    run: Run, tmp_path: Path, optimiser: FakeOptimiser, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        ran = run("demo")
        assert ran.code == 0, ran.errors
    assert optimiser.names == ["frame_0010", "frame_0010"]
    assert "picture   tnst_mi-demo/images/frame_0010_comparison.png" in ran.out
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").touch()
    refused(run, tmp_path, ["demo", "--out", "mine"], "mine: is not empty; give an empty or new folder")
    save_frames(tmp_path / "smoke", frames(0.3))
    assert run("stylize", "smoke", "--out", "other", "--tag", "volcano").code == 0
    refused(run, tmp_path, ["demo", "--out", "other"], "other: holds a run that is no demo")


# --- The other commands -----------------------------------------------------------------------------------


def test_render_uses_one_exposure_for_all_pictures(run: Run, smoke: Path, tmp_path: Path) -> None:
    ran = run("render", smoke, "--out", tmp_path / "out", "--views", "0,0", "-90,0", "--gamma", "0.5")
    assert ran.code == 0, ran.errors
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {f"f_{n:02d}_view_{v}.{e}" for n in (7, 8, 9) for v in ("0_0", "-90_0") for e in ("png", "exr")}

    def pixels(name: str) -> tuple[np.ndarray, dict[str, object]]:
        with OpenEXR.File(str(tmp_path / "out" / name)) as file:
            header = {key: file.header()[key] for key in ("exposure", "gamma")}
            return np.array(file.channels()["Y"].pixels), header

    def column(density: float) -> float:
        return density * sum(np.exp(-0.5 * density * k) for k in range(1, 5))

    # Uniform grids: f_08 is the brightest, and every picture is a column sum over that of f_08.
    for name, density in (("f_07", 0.2), ("f_08", 0.4), ("f_09", 0.3)):
        image, header = pixels(f"{name}_view_0_0.exr")
        np.testing.assert_allclose(image, np.full((6, 5), column(density) / column(0.4)), rtol=1e-4)
        assert header["exposure"] == pytest.approx(1 / column(0.4), rel=1e-4)
        assert header["gamma"] == 0.5


def test_info_describes_frames(run: Run, tmp_path: Path) -> None:
    density = np.zeros((2, 2, 2))
    density[0, 0] = 1.5, 0.5
    velocity = np.full((2, 2, 2, 3), [3.0, 4.0, 0.0])
    velocity[density == 0.0] *= 7.0  # what moves without smoke is not of it
    np.savez(tmp_path / "a.npz", density=density, velocity=velocity)
    ran = run("info", tmp_path / "a.npz")
    assert ran.code == 0 and ran.errors == []
    assert "array 'velocity': float64, shape (2, 2, 2, 3)" in ran.out
    lines = ran.out.splitlines()
    assert (lines[0], lines[1][:12], lines[2][:20]) == (str(tmp_path / "a.npz"), "  read as: y", "  reference density:")
    assert lines[3] == (
        "  a.npz: shape (z, y, x) (2, 2, 2), density 0 to 1.5, mass 2, 75.0% of cells empty, "
        "velocity at most 5 cells per frame"
    )
    np.savez(tmp_path / "v.npz", velocity=np.full((2, 2, 2, 3), [0.0, 3.0, 4.0], np.float32))
    ran = run("info", tmp_path / "v.npz")
    assert (ran.code, ran.errors) == (0, [])
    assert ran.out.splitlines()[1:] == [
        "  read as: y up, velocity at centres in cells-per-frame; no density, velocity from velocity, no obstacle",
        "  v.npz: no frame, no array 'density' (or 'x'), the arrays found are: velocity, "
        "velocity at most 5 cells per frame",
        "    array 'velocity': float32, shape (2, 2, 2, 3), 0 to 4",
    ]


def test_info_says_once_what_is_true_of_all_frames(run: Run, tmp_path: Path) -> None:
    folder = tmp_path / "smoke"
    folder.mkdir()
    for number in range(5):
        density = np.full((2, 3, 4), 0.1 * (number + 1), np.float32)
        density[0, 0, 0] = -1e-9
        other = {"heat": density} if number in (2, 3) else {}
        np.savez(folder / f"f_{number}.npz", density=density, **other)
    lines = run("info", folder).out.splitlines()
    assert lines[0] == f"{folder}: 5 frames, 0 to 4"
    assert [line.partition(":")[0] for line in lines[1:5]] == [
        "  read as",
        "  read as",
        "  note",
        "  reference density",
    ]
    assert lines[1].endswith(" (f_0, f_1, f_4)") and lines[2].endswith("; other grids: heat (f_2, f_3)")
    assert "f_0 (1 cell down to -1e-09), f_1 (1 cell" in lines[3] and lines[3].endswith("and 2 more")
    # A line for each frame, and the arrays only where they are others than before.
    assert [line.split(":")[0] for line in lines[5:]] == [
        *("  f_0.npz", "    array 'density'", "  f_1.npz"),
        *("  f_2.npz", "    array 'density'", "    array 'heat'", "  f_3.npz"),
        *("  f_4.npz", "    array 'density'"),
    ]


def test_info_keeps_the_box_of_every_frame(run: Run, tmp_path: Path) -> None:
    for number in (1, 2):
        grid = DenseGrid("density", np.ones((2, 3, 4), np.float32), (number, 0, 0), 0.5)
        write_vdb(tmp_path / f"s_{number}.vdb", [grid], {})
    lines = run("info", tmp_path).out.splitlines()
    assert [line.split(":")[0] for line in lines if "grid" in line] == ["    grid 'density'"]
    assert "s_1.vdb: shape (z, y, x) (2, 3, 5), active from (1, 0, 0) to (4, 2, 1)" in lines[3]
    assert "s_2.vdb: shape (z, y, x) (2, 3, 5), active from (2, 0, 0) to (5, 2, 1)" in lines[5]


def test_weights_says_where_they_come_from(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TNST_MI_WEIGHTS", str(tmp_path / "nowhere"))
    refused(run, tmp_path, ["weights"], "nowhere: no such file")
    monkeypatch.setenv("TNST_MI_WEIGHTS", str(random_googlenet(tmp_path / "tiny.safetensors", narrow=8)))
    ran = run("weights")
    assert ran.code == 0
    assert f"{tmp_path / 'tiny.safetensors'} (not a published file)" in ran.out
    assert "6f7101e3a2183738a7125a0c5021ba82a1feb4228c5ca0924d991b6daf6f6fad" in ran.out and "https://" in ran.out


def test_an_interruption_inside_a_callback_is_one(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Dr.Jit and Mitsuba raise errors of their own where Ctrl-C came while they called back."""

    def interrupted(_: object) -> int:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as cause:
            raise RuntimeError("drjit.custom(): error while performing a custom operation") from cause

    monkeypatch.setattr(doctor, "run", interrupted)
    ran = run("doctor")
    assert ran.code == 3 and ran.errors == ["tnst-mi: interrupted"]


# --- Everyday usage ---------------------------------------------------------------------------------------


def test_the_version(run: Run) -> None:
    assert [(ran.code, ran.out) for ran in (run("--version"), run("-V"))] == [(0, "tnst-mi 0.1.0\n")] * 2


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("stylize a --out b --angle 10", "unexpected '--angle'; did you mean --azimuth?"),
        ("stylize a --out b --intensity=2", "unexpected '--intensity'; did you mean --strength?"),
        ("stylize a --out b --learning-rate 2", "did you mean --eta?"),
        ("stylize a --out b --style-image x.png", "did you mean --style?"),
        ("stylize a --out b --device cuda", "did you mean --variant?"),
        (
            "stylize a --out b --preview",
            "unexpected '--preview'; a single octave gives a quick preview .*--octaves 1",
        ),
        ("stylize a --out b --output c", "did you mean --out?"),
        ("convert a b --time-step 2", "unexpected '--time-step'; did you mean --dt?"),
        ("convert a b --camera 2", "unexpected '--camera'; tnst-mi convert --help lists what is known"),
        # A guess that is unlike is worse than none, and one that the command refuses too.
        ("info a --bogus", "unexpected '--bogus'; tnst-mi info --help lists what is known"),
        ("stylize a --files x --out b", "unexpected '--files'; INPUT is given without a flag"),
        ("stylize --input a --out b", "unexpected '--input'; INPUT is given without a flag"),
        ("convert --input=a b", "unexpected '--input'; INPUT is given without a flag"),
        ("convert a --out b", "unexpected '--out'; OUTPUT is given without a flag"),
        ("info --files a", "unexpected '--files'; FILE… is given without a flag"),
        ("info a --frame 9:12", "unexpected '--frame'; did you mean --frames?"),
        ("stylize a -o b", "unexpected '-o'; did you mean --out?"),
        # Choices are listed alike, with the likeliest; other words for a range and a table are seen through.
        ("render a --out b --look thcik", "--look thcik: expected thin, medium or thick; did you mean thick?"),
        ("render a --out b --integrator volpth", "--integrator volpth: expected .* or volpath; did you mean volpath?"),
        ("convert a b --format vbd", "--format vbd: expected npz, vol, uni or vdb; did you mean vdb?"),
        ("render a --out b --spp x --look thin", "--spp x: expected an integer from 1 to 1000000$"),
        ("render a --out b --turntable 1.5", "--turntable 1.5: expected an integer from 1 to 100000$"),
        ("info a --frames 1-2", '--frames 1-2: expected a range of frame numbers, such as "70:89"; write 1:2$'),
        ("stylize a --out b --tag x --frames -3..-1", "; write -3:-1$"),
        ("compare a --out b --frames 1,2", "; write 1:2$"),
        ("info a --crop maybe", r"--crop maybe: expected on or off \(true or false in a recipe\)$"),
        (
            "stylize a --out b --tag x --gamma 0=0.1,3=1.0",
            "--gamma 0=0.1,3=1.0: .*; keyframes are written in braces: '{0=0.1,3=1.0}'$",
        ),
        ("stylize a --out b --tag x --gamma 0:0.1", "keyframes are written in braces: '{0:0.1}'$"),
        ("render a --out b --gamma {0:0.1,3:1}", "--gamma {0:0.1,3:1}: render takes one value, keyframes are of styl"),
        ("stylize a --out b --tag x --eta {0:1", "--eta {0:1: expected a value for each frame, such as '{49: 0.1, 72"),
        ("stylize a --out b --tag x --octaves {0:1}", "--octaves: octaves = .*: cannot be keyframed"),
        ("stylize a --out b --tag x --eta {0:-1}", "--eta: frame 0: eta = -1: expected a number above 0"),
    ],
)
def test_what_was_meant(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, message: str) -> None:
    monkeypatch.chdir(tmp_path)
    refused(run, tmp_path, line.split(), message)


def test_a_pattern_without_quotes(run: Run, smoke: Path, tmp_path: Path) -> None:
    files = [smoke / f"f_0{number}.npz" for number in (7, 8, 9)]
    refused(run, tmp_path, ["stylize", *files, "--out", tmp_path / "out"], "as a pattern in quotes, such as 'smoke_")


@pytest.mark.parametrize("flag", [("--frames", "-3:-2"), ("--frames=-3:-2",)])
def test_negative_frames(run: Run, tmp_path: Path, optimiser: FakeOptimiser, flag: tuple[str, ...]) -> None:
    for number in (1, 2, 3):
        save_frames(tmp_path / "smoke" / f"s.-00{number}.npz", frames(0.1 * number)[0])
    ran = run("stylize", tmp_path / "smoke", "--out", tmp_path / "out", "--tag", "x", *flag)
    assert ran.code == 0, ran.errors
    assert optimiser.names == ["s.-003", "s.-002"]
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert [frame["number"] for frame in record["frames"]] == [-3, -2]


@pytest.mark.parametrize("table", ["{7: 0.001, 9: 0.002}", "{7 = 0.001, 9 = 0.002}", '{"7" = 0.001, 9: 0.002}'])
def test_tables_of_keyframes_as_flags(
    run: Run, smoke: Path, tmp_path: Path, optimiser: FakeOptimiser, table: str
) -> None:
    ran = run(
        *("stylize", smoke, "--out", tmp_path / "out", "--eta", table),
        *("--azimuth", "{7: [-10, 10], 9: [0, 20]}", "--style", "{7: 'net', 9: ['spirals']}"),
    )
    assert ran.code == 0, ran.errors
    recipe = optimiser.calls[0]["recipe"]
    assert recipe.keyframes["eta"] == ((7, 0.001), (9, 0.002))
    assert recipe.at(8).azimuth == (-5.0, 15.0)
    assert [[Path(path).stem for path in paths] for _, paths in recipe.keyframes["style"]] == [["net"], ["spirals"]]


def test_resuming_needs_the_folder_alone(
    run: Run, smoke: Path, tmp_path: Path, optimiser: FakeOptimiser, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    optimiser.interrupt_at = "f_08"
    flags = ("--tag", "x", "--octaves", "2", "--frames", "7:8", "--gamma", "{7: 0.1, 8: 0.2}")
    assert run("stylize", "smoke", "--out", "out", *flags).code == 3
    optimiser.interrupt_at = ""
    monkeypatch.chdir(smoke)
    ran = run("stylize", "--out", tmp_path / "out", "--resume")
    assert ran.code == 0, ran.errors
    assert optimiser.names == ["f_07", "f_08"]
    assert optimiser.calls[0]["recipe"] == optimiser.calls[1]["recipe"]
    ran = run("stylize", "--out", tmp_path / "out", "--resume", "--octaves", "3")
    assert ran.code == 2 and "its run had octaves = 2 and the recipe now has 3" in ran.errors[-1]


def test_homes_are_found(
    run: Run, smoke: Path, tmp_path: Path, optimiser: FakeOptimiser, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "r.toml").write_text('style = ["~/net.png"]\n')
    (tmp_path / "net.png").write_bytes((STYLES / "net.png").read_bytes())
    ran = run("stylize", "~/smoke", "--out=~/out", "--recipe", "~/r.toml")
    assert ran.code == 0, ran.errors
    assert optimiser.calls[0]["recipe"].style == (str(tmp_path / "net.png"),)
    assert (tmp_path / "out" / "run.json").is_file()


def test_messages_are_plain(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(_: object) -> int:
        raise RuntimeError("\x1b[31mred\x1b[0m and \x07loud\x00 in\nmany lines")

    monkeypatch.setattr("tnst_mi.commands.doctor.run", fails)
    assert run("doctor").errors == ["tnst-mi: RuntimeError: red and loud in many lines (--debug shows where)"]
    ran = run("info", tmp_path / "a\x1b[31mb\udcff.vdb")
    assert ran.code == 2 and ran.errors[0].endswith("ab?.vdb: no such file or folder")


def test_there_has_to_be_a_run_to_resume(run: Run, smoke: Path, tmp_path: Path, optimiser: FakeOptimiser) -> None:
    """A run that was killed before its first record leaves a folder, in which it begins."""
    out, goal = tmp_path / "nothere", ["--tag", "volcano", "--iterations", "1"]
    told = rf"^tnst-mi: {out}: no run to resume there; leave out --resume to begin one$"
    for flags in ([], goal):
        refused(run, tmp_path, ["stylize", smoke, "--out", out, "--resume", *flags], told)
    out.mkdir()
    (out / "notes.txt").touch()
    for flags in ([], goal):
        refused(
            run, tmp_path, ["stylize", smoke, "--out", out, "--resume", *flags], "holds no run that could be resumed"
        )
    (out / "notes.txt").unlink()
    (out / ".lock").touch()
    ran = run("stylize", smoke, "--out", out, "--resume", *goal)
    assert ran.code == 0 and ran.errors[0] == f"note: {out}: its run was ended before it began, so it begins now"
