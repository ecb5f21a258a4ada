"""The command line: its help, what it imports, exit codes, and failures of all kinds."""

from __future__ import annotations

import errno
import importlib
import inspect
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from command_line import Run, refused, run, smoke
from jobs import FakeOptimiser, optimiser
from networks import random_googlenet

from tnst_mi.cli import COMMANDS, READER_LEFT
from tnst_mi.commands import doctor
from tnst_mi.commands.arguments import ARGUMENTS
from tnst_mi.errors import InputError
from tnst_mi.recipe.keyframes import KEYABLE
from tnst_mi.recipe.recipe import KINDS, Recipe

__all__ = ["optimiser", "run", "smoke"]


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


def test_help_loads_no_torch_and_starts_no_variant() -> None:
    program = (
        "import sys; from tnst_mi.cli import main; code = main(['stylize', '--help']); "
        "import mitsuba; heavy = {'torch', 'matplotlib'} & set(sys.modules); "
        "sys.exit(code or mitsuba.variant() or ', '.join(heavy) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


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


def test_the_version(run: Run) -> None:
    assert [(ran.code, ran.out) for ran in (run("--version"), run("-V"))] == [(0, "tnst-mi 0.1.0\n")] * 2


def test_messages_are_plain(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(_: object) -> int:
        raise RuntimeError("\x1b[31mred\x1b[0m and \x07loud\x00 in\nmany lines")

    monkeypatch.setattr("tnst_mi.commands.doctor.run", fails)
    assert run("doctor").errors == ["tnst-mi: RuntimeError: red and loud in many lines (--debug shows where)"]
    ran = run("info", tmp_path / "a\x1b[31mb\udcff.vdb")
    assert ran.code == 2 and ran.errors[0].endswith("ab?.vdb: no such file or folder")
