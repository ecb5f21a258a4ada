"""`--from RUN`: what an earlier run has done is not done again, and the end is the same."""

from __future__ import annotations

import json
import shutil
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Run as RunCommand
from command_line import refused, run, tiny_weights
from moving_smoke import moving_smoke

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.io import save_frames
from tnst_mi.optimisation.gradient import OctaveProblem
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.job import Run
from tnst_mi.run.kept_octaves import kept_octaves, octave_folder
from tnst_mi.run.prepare import prepare

__all__ = ["run", "tiny_weights"]

SHAPE = (10, 14, 12)

GOAL = {"semantic": "inception_3a/3x3:2"}


@pytest.fixture(scope="module")
def keys(tiny_weights: Path) -> dict[str, Any]:
    """A recipe of two octaves."""
    goal = {"semantic": ["inception_3a/3x3:2"], "weights": str(tiny_weights)}
    return goal | {"octaves": 2, "iterations": 4, "views": 2, "eta": 0.004}


def stylized(keys: dict[str, Any], frames: int, out: Path, **others: Any) -> tnst_mi.Result:
    return tnst_mi.stylize(moving_smoke(frames, SHAPE), keys, out, progress=False, **others)


def iterations(result: tnst_mi.Result, frame: int = 0) -> list[tuple[int, int]]:
    return [(entry["octave"], entry["iteration"]) for entry in result.history[frame]]


def same(one: tnst_mi.Result, other: tnst_mi.Result) -> bool:
    pairs = zip((*one.densities, *one.velocities), (*other.densities, *other.velocities), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


@pytest.mark.parametrize(
    ("frames", "others"),
    [
        (1, {}),
        (3, {"window": 3, "coherence": 1.0}),
        (3, {"window": 3, "step_order": "align_first", "window_average": "plain", "lam": 0.5}),
        (2, {"parameterisation": "density", "eta": 0.02}),
        (1, {"motif_size": 1.0, "reach": "5%", "keep_silhouette": "2%"}),
        (1, {"semantic": [], "target": [GOAL | {"mask": {"height": [9, 4]}}, GOAL | {"mask": {"height": [4, 9]}}]}),
    ],
)
def test_draft_preview_and_final_are_one_run_in_three_parts(
    frames: int, others: dict[str, Any], keys: dict[str, Any], tmp_path: Path
) -> None:
    """Every iteration is done once, and the bits are those of a run that goes all the way."""
    keys = keys | others
    whole = stylized(keys, frames, tmp_path / "whole")
    done: dict[str, tnst_mi.Result] = {}
    for quality, begin in (("draft", None), ("preview", "draft"), ("final", "preview")):
        origin = None if begin is None else tmp_path / begin
        done[quality] = stylized(keys | {"quality": quality}, frames, tmp_path / quality, start_from=origin)
    for frame in range(frames):
        parts = [iterations(result, frame) for result in done.values()]
        assert [len(part) for part in parts] == [4, 3, 1]
        assert [step for part in parts for step in part] == iterations(whole, frame)
    assert same(done["final"], whole)
    assert not same(done["preview"], whole) and not same(done["draft"], done["preview"])


def test_the_chain_is_recorded(keys: dict[str, Any], tmp_path: Path) -> None:
    stylized(keys | {"quality": "draft"}, 1, tmp_path / "draft")
    stylized(keys | {"quality": "preview"}, 1, tmp_path / "preview", start_from=tmp_path / "draft")
    final = stylized(keys, 1, tmp_path / "final", start_from=tmp_path / "preview")
    begun = json.loads((tmp_path / "final" / "run.json").read_text())["from"]
    assert begun == final.run["from"]
    assert (begun["run"], begun["quality"], begun["octave"], begun["iterations"]) == (
        str(tmp_path / "preview"),
        "preview",
        1,
        3,
    )
    assert (begun["from"]["quality"], begun["from"]["iterations"], begun["from"]["from"]) == ("draft", 4, None)
    state = json.loads((tmp_path / "draft" / "run.json").read_text())["frames"][0]["state"]
    assert (state["octave"], state["iterations"]) == (0, 4)
    # Ψ in single precision on 7×6×5 cells, and less than a kilobyte of words.
    assert 0 <= (tmp_path / "draft" / "state" / "s_005.safetensors").stat().st_size - 12 * 7 * 6 * 5 < 1000


def test_more_iterations_and_other_views_may_follow(keys: dict[str, Any], tmp_path: Path) -> None:
    stylized(keys | {"quality": "draft", "iterations": 2}, 1, tmp_path / "draft")
    later = stylized(keys | {"views": 3}, 1, tmp_path / "later", start_from=tmp_path / "draft")
    assert iterations(later) == [(0, 2), (0, 3), (1, 0), (1, 1), (1, 2), (1, 3)]


def interrupted(monkeypatch: pytest.MonkeyPatch, after: int, keys: dict[str, Any], frames: int, out: Path) -> None:
    """A run that Ctrl-C ends after some steps."""
    gradient, calls = OctaveProblem.gradient, []

    def counted(*arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) == after:
            signal.raise_signal(signal.SIGINT)
        return gradient(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(OctaveProblem, "gradient", counted)
        result = stylized(keys, frames, out)
    assert result.run["status"] == "interrupted"


@pytest.mark.parametrize(("frames", "window", "after"), [(1, 1, 6), (2, 1, 10), (2, 3, 11), (2, 3, 12)])
def test_a_run_that_was_stopped_is_gone_on_from(
    frames: int, window: int, after: int, keys: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a window, from the latest moment at which all frames were equally far."""
    keys = keys | {"window": window}
    interrupted(monkeypatch, after, keys, frames, tmp_path / "stopped")
    left = sorted(path.relative_to(tmp_path) for path in (tmp_path / "stopped").rglob("*"))
    whole = stylized(keys, frames, tmp_path / "whole")
    later = stylized(keys, frames, tmp_path / "later", start_from=tmp_path / "stopped")
    assert same(later, whole)
    assert 0 < len(iterations(later)) < 8
    assert sorted(path.relative_to(tmp_path) for path in (tmp_path / "stopped").rglob("*")) == left


def test_a_run_that_was_stopped_too_early_is_refused(
    keys: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (out := tmp_path / "stopped").mkdir()
    interrupted(monkeypatch, 1, keys | {"window": 3}, 2, out)
    shutil.rmtree(out / ".work" / "fields.0")
    with pytest.raises(InputError, match="stopped too early to go on from it; resume it with --resume"):
        stylized(keys | {"window": 3}, 2, tmp_path / "later", start_from=out)


def test_a_run_that_has_gone_on_is_resumed(
    keys: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its items are those of what it began from: of another draft, they are not gone on with."""
    keys = keys | {"window": 3}
    stylized(keys | {"quality": "draft"}, 2, tmp_path / "draft")
    whole, frames, out = stylized(keys, 2, tmp_path / "whole"), moving_smoke(2, SHAPE), tmp_path / "final"
    gradient, calls = OctaveProblem.gradient, []

    def failing(*arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return gradient(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(OctaveProblem, "gradient", failing)
        stylized(keys, 2, out, start_from=tmp_path / "draft")
    begun = json.loads((out / "run.json").read_text())["from"]
    for _ in Run(prepare(frames, Recipe.from_dict(keys), out, resume=True), progress=False):
        pass
    record = json.loads((out / "run.json").read_text())
    assert record["status"] == "done" and record["from"] == begun
    for frame, density in zip(frames, whole.densities, strict=True):
        with np.load(out / "density" / f"{frame.name}.npz") as file:
            assert np.array_equal(file["density"], density)


def test_a_draft_that_is_another_now_is_not_resumed_from(
    keys: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stylized(keys | {"quality": "draft"}, 1, tmp_path / "draft")

    def failing(*arguments: Any) -> Any:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(OctaveProblem, "gradient", failing)
        stylized(keys, 1, tmp_path / "final", start_from=tmp_path / "draft")
    run = json.loads((tmp_path / "final" / "run.json").read_text())
    if run["frames"]:
        run["frames"] = []
        (tmp_path / "final" / "run.json").write_text(json.dumps(run))
    shutil.rmtree(tmp_path / "draft")
    stylized(keys | {"quality": "draft", "seed": 1}, 1, tmp_path / "draft")
    with pytest.raises(InputError, match="is not the run any more that this one went on from"):
        prepare(moving_smoke(1, SHAPE), Recipe.from_dict(keys), tmp_path / "final", resume=True)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"semantic": ["inception_3a/3x3:3"]},
            r"its run had semantic = .*:2.*, this one has .*:3.*; give the same to go on",
        ),
        ({"lam": 0.5}, r"its run had lam = 0\.0, this one has 0\.5; give the same to go on"),
        ({"motif_size": 0.5}, "its run had motif_size = 'auto', this one has 0.5; give the same"),
        ({"octaves": 3}, "its run had octaves = 2, this one has 3"),
        ({"iterations": 3}, r"its run has gone further \(octave 1, iteration 4\) than this one would; take a higher"),
    ],
)
def test_what_must_agree_is_said_in_one_line(
    changes: dict[str, Any], message: str, keys: dict[str, Any], tmp_path: Path
) -> None:
    draft, out = tmp_path / "draft", tmp_path / "out"
    stylized(keys | {"quality": "draft"}, 1, draft)
    with pytest.raises(InputError, match=f"^{draft}: {message}") as refusal:
        stylized(keys | changes, 1, out, start_from=draft)
    assert "\n" not in str(refusal.value) and not out.exists()


def test_another_input_is_refused(keys: dict[str, Any], tmp_path: Path) -> None:
    draft = tmp_path / "draft"
    stylized(keys | {"quality": "draft"}, 1, draft)
    with pytest.raises(InputError, match=f"^{draft}: its run had other frames than the input"):
        stylized(keys, 2, tmp_path / "out", start_from=draft)
    (frame,) = moving_smoke(1, SHAPE)
    frame.density[5, 7, 6] += 0.01
    with pytest.raises(InputError, match=f"^{draft}: its run had another s_005, expected the same"):
        tnst_mi.stylize(frame, keys, tmp_path / "out", progress=False, start_from=draft)


def test_states_that_are_gone_or_others_are_refused(keys: dict[str, Any], tmp_path: Path) -> None:
    draft = tmp_path / "draft"
    stylized(keys | {"quality": "draft"}, 1, draft)
    state = draft / "state" / "s_005.safetensors"
    state.write_bytes(state.read_bytes()[:-1] + b"?")
    with pytest.raises(InputError, match=f"^{state}: is not what the run wrote; make it again with --overwrite"):
        stylized(keys, 1, tmp_path / "out", start_from=draft)
    state.unlink()
    with pytest.raises(InputError, match=f"^{draft}: the state of s_005 is gone, so no run can go on from it"):
        stylized(keys, 1, tmp_path / "out", start_from=draft)


def test_the_command_takes_input_recipe_and_the_next_quality_from_the_run(
    run: RunCommand, keys: dict[str, Any], tmp_path: Path
) -> None:
    save_frames(tmp_path / "smoke", moving_smoke(1, SHAPE))
    (tmp_path / "r.toml").write_text(Recipe.from_dict(keys).to_toml(), "utf-8")
    given = ["stylize", tmp_path / "smoke", "--recipe", tmp_path / "r.toml"]
    assert run(*given, "--quality", "draft", "--out", tmp_path / "draft").code == 0
    ran = run("stylize", "--from", tmp_path / "draft", "--out", tmp_path / "next")
    assert ran.code == 0
    assert "quality: preview, which ends after iteration 3 of 4 in octave 2 of 2" in ran.errors
    assert f"from: {tmp_path / 'draft'} (draft), after 4 iterations in octave 1" in ran.errors
    assert run("stylize", "--from", tmp_path / "next", "--out", tmp_path / "last").code == 0
    assert json.loads((tmp_path / "last" / "run.json").read_text())["from"]["from"]["quality"] == "draft"
    assert run(*given, "--out", tmp_path / "whole").code == 0
    one, other = (np.load(tmp_path / name / "density" / "s_005.npz")["density"] for name in ("last", "whole"))
    assert np.array_equal(one, other)
    none, last = tmp_path / "none", tmp_path / "last"
    refused(run, tmp_path, ["stylize", "--from", none, "--out", tmp_path / "x"], "none: holds no run to go on from")
    refused(run, tmp_path, ["stylize", "--from", last, "--out", last, "--overwrite"], "is --from and --out")
    refused(run, tmp_path, ["stylize", "--from", last, "--out", last, "--resume"], "expected only one of them")


# ---------------------------------------------------------------- from the end of an octave


def files(folder: Path) -> dict[str, bytes]:
    """What a run leaves of smoke, and of what it moves by."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.glob("*/*.npz"))}


@pytest.mark.parametrize(
    ("frames", "others"), [(1, {}), (3, {"window": 3, "coherence": 1.0}), (2, {"parameterisation": "density"})]
)
def test_a_kept_octave_is_gone_on_from_to_the_same_bits(
    frames: int, others: dict[str, Any], keys: dict[str, Any], tmp_path: Path
) -> None:
    keys = keys | others | {"octaves": 3}
    whole = stylized(keys, frames, tmp_path / "whole")
    assert kept_octaves(tmp_path / "whole") == []
    kept = stylized(keys | {"keep_octaves": True}, frames, tmp_path / "kept")
    assert same(kept, whole)
    assert kept_octaves(tmp_path / "kept") == [0, 1]
    for octave in (0, 1):
        folder = octave_folder(tmp_path / "kept", octave)
        later = stylized(keys, frames, tmp_path / f"later_{octave}", start_from=folder)
        assert same(later, whole)
        begun = [(level, k) for level in range(octave + 1, 3) for k in range(4)]
        assert [iterations(later, frame) for frame in range(frames)] == [begun] * frames
        assert later.run["from"]["octave"] == octave and later.run["from"]["iterations"] == 4
        assert [path.name.endswith("_comparison.png") for path in (folder / "images").iterdir()] == [True]


def test_a_run_that_is_replaced_loses_its_kept_octaves(keys: dict[str, Any], tmp_path: Path) -> None:
    stylized(keys | {"keep_octaves": True}, 1, tmp_path / "run")
    recipe = Recipe.from_dict(keys | {"seed": 1})
    for _ in Run(prepare(moving_smoke(1, SHAPE), recipe, tmp_path / "run", overwrite=True), progress=False):
        assert kept_octaves(tmp_path / "run") == []


@pytest.mark.parametrize("after", [4, 5, 7])
def test_octaves_are_kept_whenever_a_run_is_stopped(
    after: int, keys: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys = keys | {"keep_octaves": True}
    interrupted(monkeypatch, after, keys, 1, tmp_path / "run")
    recipe = Recipe.from_dict(keys)
    for _ in Run(prepare(moving_smoke(1, SHAPE), recipe, tmp_path / "run", resume=True), progress=False):
        pass
    whole = stylized(keys, 1, tmp_path / "whole")
    later = stylized(keys, 1, tmp_path / "later", start_from=octave_folder(tmp_path / "run", 0))
    assert same(later, whole) and len(iterations(later)) == 4
