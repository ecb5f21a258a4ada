"""`tnst-mi stylize` and `demo`: precedence of flags, what is said, and how runs are resumed; not what they compute."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import Run, refused, run, smoke
from jobs import FakeOptimiser, frames, optimiser

from tnst_mi.io import save_frames
from tnst_mi.recipe.paths import STYLES

__all__ = ["optimiser", "run", "smoke"]


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
