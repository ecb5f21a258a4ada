"""How a run ends that something outside of it ends, or changes under its hands."""

from __future__ import annotations

import errno
import json
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import Run as RunCommand
from command_line import refused, run, smoke, tiny_weights
from faults import Undisturbed, begun, quick, results, undisturbed
from jobs import FakeOptimiser, frames, optimiser

from tnst_mi.errors import InputError, StoppedError
from tnst_mi.io import atomic, save_frames
from tnst_mi.machine.lock import LOCK
from tnst_mi.optimisation.gradient import Evaluation, OctaveProblem
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.job import Run
from tnst_mi.run.prepare import prepare

__all__ = ["begun", "optimiser", "quick", "run", "smoke", "tiny_weights", "undisturbed"]

RECIPE = Recipe(style=("spirals",), gamma=0.3, octaves=1, iterations=1)


def one_frame_done(out: Path) -> Run:
    """A run that goes on."""
    job = Run(prepare(frames(0.2, 0.4), RECIPE, out), progress=False)
    assert next(job).record["name"] == "f_07"
    return job


def resumed(out: Path) -> dict[str, object]:
    """The results of a run that is continued to its end."""
    list(Run(prepare(frames(0.2, 0.4), RECIPE, out, resume=True), progress=False))
    return results(out)


@pytest.fixture
def expected(optimiser: FakeOptimiser, tmp_path: Path) -> dict[str, object]:
    """The results of a run that nothing disturbs."""
    return resumed(tmp_path / "expected")


# --- Signals ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_that_end_programs_end_a_run_after_its_step(
    number: signal.Signals,
    run: RunCommand,
    begun: list[str],
    undisturbed: Undisturbed,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out, gradient, calls = tmp_path / "out", OctaveProblem.gradient, []

    def signalled(*arguments: object) -> Evaluation:
        calls.append(arguments)
        if len(calls) == 3:  # the first frame's step in the second octave
            signal.raise_signal(number)
        return gradient(*arguments)

    before = signal.getsignal(number)
    monkeypatch.setattr(OctaveProblem, "gradient", signalled)
    ran = run(*begun, out)
    assert ran.code == 3 and len(calls) == 3
    assert ran.errors[-1] == f"tnst-mi: interrupted; --resume continues the run in {out} where it stopped"
    assert signal.getsignal(number) is before and not (out / LOCK).exists()
    # The step that was being found is not found again: there is one for each frame and octave.
    assert run(*begun, out, "--resume").code == 0 and len(calls) == 4
    assert results(out) == undisturbed.results


def test_signals_that_are_ignored_stay_so(
    run: RunCommand, begun: list[str], undisturbed: Undisturbed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """nohup ignores SIGHUP, so that a run goes on when its terminal closes."""
    gradient = OctaveProblem.gradient

    def hung_up(*arguments: object) -> Evaluation:
        signal.raise_signal(signal.SIGHUP)
        return gradient(*arguments)

    monkeypatch.setattr(OctaveProblem, "gradient", hung_up)
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert run(*begun, tmp_path / "out").code == 0
    finally:
        signal.signal(signal.SIGHUP, before)
    assert results(tmp_path / "out") == undisturbed.results


# --- The folder of the results ----------------------------------------------------------------------------


@pytest.mark.parametrize("what", ["moved", "removed", "replaced"])
def test_a_folder_that_goes_ends_the_run(what: str, expected: dict[str, object], tmp_path: Path) -> None:
    """Nothing is written where the folder was; one that comes back is continued."""
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    job = one_frame_done(out)
    out.rename(elsewhere)
    if what == "replaced":
        out.mkdir()
    with pytest.raises(StoppedError, match=r"has been moved, removed or replaced during its run.* bring it back"):
        next(job)
    assert list(out.iterdir()) == [] if what == "replaced" else not out.exists()
    if what != "removed":
        if what == "replaced":
            out.rmdir()
        elsewhere.rename(out)
    assert resumed(out) == expected


def test_a_folder_that_becomes_read_only_ends_the_run(
    expected: dict[str, object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    job = one_frame_done(out)

    def read_only(*_: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    with monkeypatch.context() as patch:
        patch.setattr(atomic, "_publish", read_only)
        with pytest.raises(
            StoppedError, match=r"f_08\.npz cannot be written \(Read-only file system\).* --resume"
        ) as told:
            next(job)
    assert str(told.value).startswith(f"{out}: ")
    assert resumed(out) == expected


def test_a_second_run_into_a_folder_is_refused(
    optimiser: FakeOptimiser, expected: dict[str, object], run: RunCommand, smoke: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    late = Run(prepare(frames(0.2, 0.4), RECIPE, out), progress=False)
    job = one_frame_done(out)
    told = rf"out: another run is writing there \(process {os.getpid()} on {platform.node()}\); wait for its end"
    for flags in ([], ["--resume"], ["--overwrite"]):
        refused(run, out, ["stylize", smoke, "--out", out, "--tag", "x", *flags], told)
    with pytest.raises(InputError, match=told):
        next(late)
    list(job)
    with pytest.raises(InputError, match="another run has written there since this one began"):
        next(Run(late.prepared, progress=False))
    assert results(out) == expected


# --- The input --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("what", ["changed", "removed"])
def test_an_input_that_changes_is_not_mixed_into_the_results(
    what: str, optimiser: FakeOptimiser, tmp_path: Path
) -> None:
    save_frames(tmp_path / "smoke", frames(0.2, 0.4))
    path, other = tmp_path / "smoke" / "f_08.npz", tmp_path / "other.npz"
    save_frames(other, frames(0.4, 0.3)[1])
    out = tmp_path / "out"
    job = Run(prepare(tmp_path / "smoke", RECIPE, out), progress=False)
    next(job)
    whole = path.read_bytes()
    if what == "changed":
        path.write_bytes(other.read_bytes())
        told = "f_08: has changed since the run began; restore it and go on with --resume"
    else:
        path.unlink()
        told = r"f_08\.npz: no such file"
    with pytest.raises(InputError, match=told):
        next(job)
    assert "f_08" not in {path.stem for path in (out / "density").iterdir()}
    with pytest.raises(InputError, match=r"its run had another f_08|only its run has a frame f_08"):
        prepare(tmp_path / "smoke", RECIPE, out, resume=True)
    path.write_bytes(whole)
    list(Run(prepare(tmp_path / "smoke", RECIPE, out, resume=True), progress=False))
    with np.load(out / "density" / "f_08.npz") as file:
        np.testing.assert_array_equal(file["density"], 2 * frames(0.2, 0.4)[1].density)


def test_an_input_that_changes_while_it_is_measured_is_noticed(
    tmp_path: Path, optimiser: FakeOptimiser, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the reading for its identity and that for its brightness."""
    (frame,) = frames(0.2)
    exposed = "tnst_mi.run.prepare.brightness"

    def changed(given: list[object], *_: object) -> object:
        frame.density.setflags(write=True)
        frame.density[0] = 0.7
        return given[0]

    monkeypatch.setattr(exposed, changed)
    with pytest.raises(InputError, match="f_07: has changed since the run began"):
        prepare(frame, RECIPE, tmp_path / "out")


def test_results_that_are_lost_are_made_again(expected: dict[str, object], tmp_path: Path) -> None:
    """Of a run that has not ended: its arrays, and the pictures of which the contact sheet is made."""
    out = tmp_path / "out"
    one_frame_done(out).close()
    for name in ("density/f_07.npz", "images/f_07_before.exr"):
        (out / name).unlink()
        made = resumed(out)
        # A frame that is made again is logged after the others.
        made["metrics.jsonl"] = sorted(made["metrics.jsonl"], key=lambda line: line["frame"])
        assert made == expected
        (out / "run.json").write_text((out / "run.json").read_text().replace('"done"', '"running"'))


# --- The clock, the output, the surroundings --------------------------------------------------------------


def test_a_clock_that_is_set_back_changes_nothing(
    expected: dict[str, object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By an hour at every reading; files have times in the future."""
    out, now = tmp_path / "out", [time.time()]

    def backwards() -> float:
        now[0] -= 3600
        return now[0]

    one_frame_done(out).close()
    for path in out.rglob("*"):
        os.utime(path, (4e9, 4e9))
    with monkeypatch.context() as patch:
        patch.setattr(time, "time", backwards)
        patch.setattr("tqdm.std.time", backwards)
        list(Run(prepare(frames(0.2, 0.4), RECIPE, out, resume=True)))
    assert results(out) == expected
    bar = capsys.readouterr().err
    assert "[00:00<00:00" in bar and not re.search(r"[\[<]-", bar)


def a_command(arguments: str) -> list[str]:
    return ["sh", "-c", f'exec "$0" -m tnst_mi {arguments}', sys.executable]


@pytest.mark.skipif(os.name != "posix", reason="limits of other systems")
def test_a_limit_on_file_sizes_is_named(tmp_path: Path) -> None:
    """Of what is written as a file, and where the output is one."""
    np.savez(tmp_path / "a.npz", density=np.random.default_rng(0).random((30, 30, 30)).astype(np.float32))
    for command, said in (
        ("convert a.npz out --format vol", "a.vol: File too large; raise the limit on file sizes (ulimit -f)\n"),
        (
            "stylize --help >help",
            "the output cannot be written (File too large); raise the limit on file sizes (ulimit ",
        ),
    ):
        shell = f"ulimit -f 4; {sys.executable} -m tnst_mi {command}"
        done = subprocess.run(shell, shell=True, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 1 and said in done.stderr.splitlines(keepends=True)[-1]
    assert not list(tmp_path.rglob("*.vol"))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize(
    ("redirection", "code", "told"),
    [
        (">/dev/full", 1, "tnst-mi: the output cannot be written (No space left on device)\n"),
        (">&-", 0, ""),
        ("nowhere 2>/dev/full", 2, ""),
    ],
)
def test_an_output_that_cannot_be_written(redirection: str, code: int, told: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", density=np.ones((2, 2, 2)))
    command = a_command(f"info {tmp_path / 'a.npz'} {redirection}")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (code, told)


def test_nowhere_to_keep_caches_and_temporary_files_is_no_failure(tmp_path: Path) -> None:
    """Dr.Jit's kernels cannot be kept then, which it says."""
    np.savez(tmp_path / "a.npz", density=np.full((4, 6, 5), 0.5, np.float32))
    nowhere = {name: "/proc/nowhere" for name in ("HOME", "TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME")}
    command = a_command(f"render {tmp_path / 'a.npz'} --out {tmp_path / 'out'}")
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ | nowhere)
    assert done.returncode == 0, done.stderr
    assert sorted(path.suffix for path in (tmp_path / "out").iterdir()) == [".exr", ".png"]
    assert "Traceback" not in done.stderr


# --- Results that are damaged -----------------------------------------------------------------------------

RESULTS = ("density/f_07.npz", "velocity/f_07.npz", "images/f_07_after.exr", "images/f_07_loss.png", "metrics.jsonl")


def emptied(path: Path) -> None:
    path.write_bytes(b"")


def cut_short(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def not_text(path: Path) -> None:
    path.write_bytes(b"\xff\x00\x80" + path.read_bytes())


def replaced(path: Path) -> None:
    """By a file that is whole, in the same format."""
    other = path.with_name(path.name.replace("f_07", "f_08"))
    path.write_bytes(other.read_bytes().replace(b'"loss": 0.0', b'"loss": 7.0'))


@pytest.mark.parametrize("damage", [emptied, cut_short, not_text, replaced, Path.unlink])
def test_results_that_are_damaged_are_made_again(
    damage: Callable[[Path], object],
    expected: dict[str, object],
    tmp_path: Path,
) -> None:
    """Of a run that has not ended: of a frame that is done, every kind of file."""
    out = tmp_path / "out"
    job = Run(prepare(frames(0.2, 0.4), RECIPE, out), progress=False)
    assert [next(job).record["name"], next(job).record["name"]] == ["f_07", "f_08"]
    job.close()
    # Frames of the stand-in have the same velocity and the same plot.
    for name in ("density/f_07.npz", "images/f_07_after.exr", "metrics.jsonl") if damage is replaced else RESULTS:
        damaged = tmp_path / name.replace("/", "_")
        shutil.copytree(out, damaged)
        damage(damaged / name)
        job = Run(prepare(frames(0.2, 0.4), RECIPE, damaged, resume=True), progress=False)
        (told,) = job.prepared.reading
        assert told.startswith(f"note: {damaged}: made again, since files are damaged or lost: f_0")
        assert f" ({name})" in told
        list(job)
        made = results(damaged)
        made["metrics.jsonl"] = sorted(made["metrics.jsonl"], key=lambda line: line["frame"])
        assert made == expected, name


@pytest.mark.parametrize("name", [*RESULTS, "images/contact_sheet.png"])
def test_results_of_a_run_that_has_ended_are_not_replaced(name: str, optimiser: FakeOptimiser, tmp_path: Path) -> None:
    """They may have been changed on purpose."""
    resumed(tmp_path)
    cut_short(tmp_path / name)
    kept = (tmp_path / name).read_bytes()
    told = rf"{name}: is not what the run wrote; restore it, or begin the run anew with --overwrite$"
    with pytest.raises(InputError, match=told):
        prepare(frames(0.2, 0.4), RECIPE, tmp_path, resume=True)
    assert (tmp_path / name).read_bytes() == kept


def test_pictures_of_all_frames_that_are_lost_are_made_again(
    optimiser: FakeOptimiser, expected: dict[str, object], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    resumed(out)
    (out / "images" / "contact_sheet.png").unlink()
    calls = len(optimiser.names)
    assert resumed(out) == expected and len(optimiser.names) == calls


def test_a_record_names_no_files_elsewhere(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    """It is untrusted: a hash of a file elsewhere must not be taken."""
    out = tmp_path / "out"
    resumed(out)
    run = json.loads((out / "run.json").read_text())
    run["frames"][0]["results"]["../victim"] = {"bytes": 1, "sha256": ""}
    (out / "run.json").write_text(json.dumps(run))
    with pytest.raises(InputError, match=r"run\.json: damaged, so the run cannot be resumed"):
        prepare(frames(0.2, 0.4), RECIPE, out, resume=True)


@pytest.mark.parametrize("text", ["", "gamma = 0.4\n", "gamma = \n"])
def test_a_damaged_recipe_is_told_as_what_it_is(
    text: str, optimiser: FakeOptimiser, run: RunCommand, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    save_frames(tmp_path / "smoke", frames(0.2, 0.4))
    one_frame_done(out).close()
    before = results(out)
    (out / "recipe.toml").write_text(text)
    told = r"recipe\.toml: is not the recipe of the run there; restore it, or begin the run anew with --overwrite$"
    refused(run, out, ["stylize", tmp_path / "smoke", "--out", out, "--resume"], told)
    with pytest.raises(InputError, match=told):
        prepare(frames(0.2, 0.4), replace(RECIPE, gamma=0.5), out, resume=True)
    # With the recipe of the run, nothing is amiss.
    assert prepare(frames(0.2, 0.4), RECIPE, out, resume=True).record["frames"]
    assert results(out) == before | {"recipe.toml": text.encode()}
