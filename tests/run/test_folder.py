"""Whole runs with a stand-in optimiser: what is handed to it, what is written, resumed and overwritten."""

from __future__ import annotations

import dataclasses
import errno
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import OpenEXR
import pytest
from jobs import SHAPE, FakeOptimiser, frames, optimiser
from PIL import Image

import tnst_mi
from tnst_mi.errors import InputError, StoppedError
from tnst_mi.frame import Frame
from tnst_mi.io import load_frames, save_frames
from tnst_mi.io.grids.npz import read_headers
from tnst_mi.machine.disk import require_writable
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.folder import RunFolder
from tnst_mi.run.job import Run
from tnst_mi.run.memory import working_bytes
from tnst_mi.run.prepare import prepare
from tnst_mi.run.resuming import resumable_run

__all__ = ["optimiser"]

GAMMA = 0.3
RECIPE = Recipe(style=("spirals",), gamma=GAMMA, octaves=2, iterations=3)


def pixel(density: float) -> float:
    """The paper's inclusive sum over a uniform column, in closed form."""
    steps = np.exp(-GAMMA * density * np.arange(1, SHAPE[0] + 1))
    return float(density * steps.sum())


def files_of(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def test_exposure_and_step_scale_are_those_of_the_whole_run(optimiser: FakeOptimiser) -> None:
    recipe = dataclasses.replace(RECIPE, density_scale=1.0)
    tnst_mi.stylize(frames(0.2, 0.4, 0.0), recipe, progress=False)
    tnst_mi.stylize(frames(0.4), recipe, progress=False)
    call, alone = optimiser.calls
    assert call["exposures"] == alone["exposures"] * 3
    assert call["step_scales"] == pytest.approx([pixel(0.2) / pixel(0.4), 1.0, 0.0], rel=1e-4)


def test_the_device_is_said_first(optimiser: FakeOptimiser, capsys: pytest.CaptureFixture[str]) -> None:
    prepared = prepare(frames(0.2, 0.4), RECIPE)
    for _ in Run(prepared):
        pass
    assert optimiser.calls[0]["cache_bytes"] == prepared.cache_bytes > 0
    assert re.match(r"device: (CPU, \d+ threads \(llvm_ad_rgb\)|.* \(cuda_ad_rgb.*\))\n", capsys.readouterr().err)


@pytest.mark.parametrize(
    ("gamma", "others", "thickness"),
    [
        (14.0, {}, None),
        (16.0, {}, 3.2),
        (16.0, {"quadrature": "exact"}, None),
        ({7: 0.1, 8: 16.0}, {}, 3.2),
        ({7: 16.0, 8: 0.1}, {}, None),
        # Cells of a coarser octave are thicker; here they are all at the edge, where smoke is averaged with nothing.
        (12.0, {"octaves": 2}, 4.54),
        # In units of the sequence, the second frame has density 1.
        (3.2, {"density_scale": "auto"}, 3.2),
    ],
)
def test_cells_too_thick_for_the_inclusive_sum_are_told(
    gamma: float | dict[int, float],
    others: dict[str, str],
    thickness: float | None,
    optimiser: FakeOptimiser,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A cell's own emission is seen through its own γ d: at 3, exp(−3) = 5% of it. The second frame is the densest."""
    recipe = dataclasses.replace(RECIPE, gamma=gamma, **{"density_scale": 1.0, "octaves": 1} | others)
    for _ in Run(prepare(frames(0.1, 0.2), recipe)):
        pass
    lines = [line for line in capsys.readouterr().err.splitlines() if "inclusive sum" in line]
    assert len(lines) == (thickness is not None)
    if lines:
        assert lines[0].startswith(f"warning: gamma times density and size of a cell is up to {thickness}: ")
        assert 'quadrature = "exact" does not' in lines[0]


def test_an_empty_run_has_finite_numbers(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    result = tnst_mi.stylize(frames(0.0), RECIPE, tmp_path / "out", progress=False)
    (call,) = optimiser.calls
    assert (call["density_scale"], call["exposures"], call["step_scales"]) == (1.0, [1.0], [0.0])
    assert not result.densities[0].any()
    assert json.loads((tmp_path / "out" / "run.json").read_text())["frames"][0]["note"] == "empty: unchanged"


def test_everything_that_frames_can_be(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    (frame,) = frames(0.3)
    save_frames(tmp_path / "f_07.npz", frame)
    (tmp_path / "r.toml").write_text('style = ["spirals"]\ngamma = 0.3\n')
    for given in (frame, [frame], frame.density, tmp_path / "f_07.npz", str(tmp_path)):
        result = tnst_mi.stylize(given, tmp_path / "r.toml", progress=False)
        np.testing.assert_array_equal(result.densities[0], 2 * frame.density)
        assert result.out is None
    with pytest.raises(InputError, match="expected a path, a density grid, or frames"):
        tnst_mi.stylize([frame.density], RECIPE, progress=False)
    with pytest.raises(InputError, match="'f_07' is there more than once"):
        tnst_mi.stylize([frame, frame], RECIPE, progress=False)
    with pytest.raises(InputError, match="recipe: is a int, expected a recipe"):
        tnst_mi.stylize(frame, 5, progress=False)
    with pytest.raises(InputError, match="expected a path, a density grid, or frames"):
        tnst_mi.stylize(5, RECIPE, progress=False)
    with pytest.raises(InputError, match=r"'\.\./f' cannot name files"):
        tnst_mi.stylize(Frame(frame.density, name="../f"), RECIPE, progress=False)
    with pytest.raises(InputError, match="nothing to stylize towards"):
        tnst_mi.stylize(frame, {}, progress=False)


def test_the_results_of_a_run(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    before = frames(0.2, 0.4)
    recipe = dataclasses.replace(RECIPE, density_scale=1.0)
    result = tnst_mi.stylize(before, recipe, out, progress=False)

    pictures = {"before.png", "before.exr", "after.png", "after.exr", "comparison.png", "loss.png"}
    expected = {"recipe.toml", "run.json", "metrics.jsonl"}
    expected |= {f"images/{name}" for name in ("preview.mp4", "contact_sheet.png", "sequence.png")}
    for name in ("f_07", "f_08"):
        expected |= {f"density/{name}.npz", f"velocity/{name}.npz"}
        expected |= {f"images/{name}_{picture}" for picture in pictures}
    assert files_of(out) == expected

    for loaded, original, density in zip(load_frames(out / "density"), before, result.densities, strict=True):
        np.testing.assert_array_equal(loaded.density, 2 * original.density)
        np.testing.assert_array_equal(loaded.density, density)
    header = read_headers(out / "velocity" / "f_07.npz")["velocity"]
    assert (header.shape, header.dtype) == ((*SHAPE, 3), np.float32)
    # Who searches for arrays named density finds the right ones.
    holders = [path for path in out.rglob("*.npz") if "density" in read_headers(path)]
    assert {path.parent.name for path in holders} == {"density"}

    exposure = result.run["exposure"]
    assert 0.6 / pixel(0.4) < exposure < 1.0 / pixel(0.4)
    with OpenEXR.File(str(out / "images" / "f_07_after.exr")) as file:
        image = file.channels()["Y"].pixels
        np.testing.assert_allclose(image, np.full(SHAPE[1:], exposure * pixel(0.4)), rtol=1e-4)
        header = file.header()
        assert (header["gamma"], header["exposure"]) == pytest.approx((GAMMA, exposure), rel=1e-4)
        assert header["quadrature"] == "paper"
        np.testing.assert_array_equal(header["view"], [0, 0])
    grey = np.asarray(Image.open(out / "images" / "f_07_before.png"))
    np.testing.assert_array_equal(grey, np.full(SHAPE[1:], round(255 * exposure * pixel(0.2)), np.uint8))

    assert Recipe.from_toml(out / "recipe.toml") == optimiser.calls[0]["recipe"]
    run = json.loads((out / "run.json").read_text())
    assert run == result.run
    assert (run["status"], run["seed"], run["weights"]["sha256"]) == ("done", 0, "0" * 64)
    assert run["versions"]["tnst_mi"] == tnst_mi.__version__
    assert run["peak_memory_bytes"] > 1 << 20
    first = run["frames"][0]
    assert first["mass_before"] == pytest.approx(0.2 * np.prod(SHAPE), rel=1e-6)
    assert first["mass_after"] == pytest.approx(0.4 * np.prod(SHAPE), rel=1e-6)
    assert first["largest_displacement"] == pytest.approx(5.0)
    assert first["losses"] == [[0, -1, -2], [10, 9, 8]]
    sequence = run["sequence"]
    assert (sequence["window"], sequence["loss_reduction"]) == (1, 0.25)
    assert (sequence["terms_before"], sequence["terms_after"]) == ({"style": 8.0}, {"style": 6.0})
    assert sequence["relative_changes"] == pytest.approx([1.0, 1.0], rel=1e-6)
    assert sequence["mass_changes"] == pytest.approx([1.0, 1.0], rel=1e-6) and sequence["mass_drift"] < 1e-6
    assert (sequence["flicker"], sequence["flicker_pairs"]) == (None, [])  # the frames have no velocities
    lines = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    assert [(line["frame"], line["octave"], line["iteration"]) for line in lines] == [
        (name, octave, iteration) for name in ("f_07", "f_08") for octave in (0, 1) for iteration in (0, 1, 2)
    ]


def test_an_interrupted_run_is_resumed(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    out = tmp_path / "out"
    optimiser.interrupt_at = "f_08"
    result = tnst_mi.stylize(frames(0.2, 0.4, 0.3), RECIPE, out, progress=False)
    assert result.run["status"] == "interrupted"
    assert optimiser.names == ["f_07"]
    assert [len(entries) for entries in (result.densities, result.frames, result.history)] == [1, 1, 1]
    assert (out / ".work").exists()

    optimiser.interrupt_at = ""
    for _ in Run(prepare(frames(0.2, 0.4, 0.3), RECIPE, out, resume=True), progress=False, optimiser=optimiser):
        pass
    assert optimiser.names == ["f_07", "f_08", "f_09"]
    assert not (out / ".work").exists()
    run = json.loads((out / "run.json").read_text())
    assert run["status"] == "done"
    assert [(frame["name"], frame["complete"]) for frame in run["frames"]] == [
        ("f_07", True),
        ("f_08", True),
        ("f_09", True),
    ]
    lines = [json.loads(line)["frame"] for line in (out / "metrics.jsonl").read_text().splitlines()]
    assert lines == ["f_07"] * 6 + ["f_08"] * 6 + ["f_09"] * 6

    job = Run(prepare(frames(0.2, 0.4, 0.3), RECIPE, out, resume=True), progress=False, optimiser=optimiser)
    assert list(job) == [] and len(optimiser.calls) == 2
    assert job.record["status"] == "done"


def test_what_is_read_and_appended_for_a_frame_does_not_grow_with_their_number(
    optimiser: FakeOptimiser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """metrics.jsonl is neither read nor written anew for each frame."""
    parsed, loads = [], json.loads
    monkeypatch.setattr(json, "loads", lambda text: parsed.append(text) or loads(text))
    out, files, sizes = tmp_path / "out", set(), []
    for _ in Run(prepare(frames(*[0.2] * 12), RECIPE, out), progress=False, optimiser=optimiser):
        status = (out / "metrics.jsonl").stat()
        files.add(status.st_ino)
        sizes.append(status.st_size)
    # Once, what the lock of the folder holds, which is nothing.
    assert parsed == [b""] and len(files) == 1
    assert sizes == [n * sizes[0] for n in range(1, 13)], "equal frames add equally much"


def test_a_torn_line_of_a_killed_run_is_removed(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    """And the lines of a frame that run.json does not list: they come once, in the order of the frames."""
    out = tmp_path / "out"
    job = Run(prepare(frames(0.2, 0.4, 0.3), RECIPE, out), progress=False, optimiser=optimiser)
    next(job)
    whole = (out / "metrics.jsonl").read_text()
    torn = whole.replace("f_07", "f_08")[:-9]
    job.close()
    (out / "metrics.jsonl").write_text(whole + torn)
    for _ in Run(prepare(frames(0.2, 0.4, 0.3), RECIPE, out, resume=True), progress=False, optimiser=optimiser):
        pass
    lines = [json.loads(line)["frame"] for line in (out / "metrics.jsonl").read_text().splitlines()]
    assert lines == ["f_07"] * 6 + ["f_08"] * 6 + ["f_09"] * 6


def test_only_the_same_run_is_resumed(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    out = tmp_path / "out"
    tnst_mi.stylize(frames(0.2, 0.4), RECIPE, out, progress=False)
    before = {name: (out / name).read_bytes() for name in files_of(out)}

    def resume(densities: tuple[float, ...] = (0.2, 0.4), recipe: Recipe = RECIPE) -> None:
        Run(prepare(frames(*densities), recipe, out, resume=True), progress=False, optimiser=optimiser)

    resume()
    with pytest.raises(InputError, match=r"its run had gamma = 0\.3 and the recipe now has 0\.5"):
        resume(recipe=Recipe(style=("spirals",), gamma=0.5, octaves=2, iterations=3))
    with pytest.raises(InputError, match="its run had another f_08 than the input has now; resume with the same"):
        resume((0.2, 0.5))
    with pytest.raises(InputError, match="only its run has a frame f_08"):
        resume((0.2,))
    with pytest.raises(InputError, match="only the input now has a frame f_09"):
        resume((0.2, 0.4, 0.3))
    run = json.loads(before["run.json"])
    (out / "run.json").write_text(json.dumps(run | {"frames": run["frames"][:1]}))
    with pytest.raises(InputError, match="its run had another f_08"):
        resume((0.2, 0.5))
    with pytest.raises(InputError, match="only one of them"):
        Run(prepare(frames(0.2), RECIPE, out, resume=True, overwrite=True))
    (out / "run.json").write_text('{"frames": [{}]}')
    with pytest.raises(InputError, match="damaged"):
        resume()
    (out / "run.json").unlink()
    with pytest.raises(InputError, match="holds no run that could be resumed"):
        resume()
    (out / "run.json").write_bytes(before["run.json"])
    assert {name: (out / name).read_bytes() for name in files_of(out)} == before


@pytest.mark.parametrize("damage", [{"weights": {"sha256": "0\x1b[31m" * 1000}}, {"format": "n" * 5000}])
def test_values_in_a_damaged_record_do_not_flood_messages(damage: dict[str, object], tmp_path: Path) -> None:
    record = {"frames": [], "inputs": {}, "files": {}, "weights": {"sha256": "0"}, "format": "npz"}
    (tmp_path / "run.json").write_text(json.dumps(record | damage))
    (tmp_path / "recipe.toml").write_text(Recipe().to_toml())
    with pytest.raises(InputError, match="resume with the same") as caught:
        resumable_run(tmp_path, Recipe(), {"sha256": "0"})
    assert len(str(caught.value)) <= 300 and str(caught.value).isprintable()


def test_pictures_and_obstacles_belong_to_the_input(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    out, picture = tmp_path / "out", tmp_path / "fire.png"
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(picture)
    recipe = Recipe(style=(str(picture),), octaves=2, iterations=3)
    tnst_mi.stylize(frames(0.2), recipe, out, progress=False)
    (frame,) = frames(0.2)
    blocked = Frame(frame.density, obstacle=frame.density > 0, name=frame.name, number=frame.number)
    with pytest.raises(InputError, match="its run had another f_07 than the input has now"):
        Run(prepare(blocked, recipe, out, resume=True), progress=False, optimiser=optimiser)
    Image.fromarray(np.ones((4, 4), np.uint8)).save(picture)
    with pytest.raises(InputError, match=r"its run had another .*fire\.png than there is now"):
        Run(prepare(frame, recipe, out, resume=True), progress=False, optimiser=optimiser)


def test_fps_may_change_and_lost_results_are_made_again(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    out = tmp_path / "out"
    tnst_mi.stylize(frames(0.2, 0.4), RECIPE, out, progress=False)
    (out / "velocity" / "f_08.npz").unlink()
    faster = Recipe(style=("spirals",), gamma=GAMMA, octaves=2, iterations=3, fps=30)
    for _ in Run(prepare(frames(0.2, 0.4), faster, out, resume=True), progress=False, optimiser=optimiser):
        pass
    assert optimiser.names == ["f_07", "f_08", "f_08"]
    assert (out / "velocity" / "f_08.npz").exists()


def test_what_killed_runs_leave_is_cleaned_up(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    """Unfinished files; the working state of a run that had ended; a removal that had not."""
    out = tmp_path / "out"
    tnst_mi.stylize(frames(0.2, 0.4), RECIPE, out, progress=False)
    complete = files_of(out)
    unfinished = [
        out / "density" / ".tnst_mi-f_07.4242.npz",
        out / "images" / ".tnst_mi-preview.4242.mp4",
        out / ".tnst_mi-run.4242.json",
    ]
    for path in unfinished:
        path.write_bytes(b"PK")
    assert len(load_frames(out / "density")) == 2
    (out / ".work").mkdir()
    run = json.loads((out / "run.json").read_text())
    (out / "run.json").write_text(json.dumps(run | {"status": "running"}))
    list(Run(prepare(frames(0.2, 0.4), RECIPE, out, resume=True), progress=False, optimiser=optimiser))
    assert files_of(out) == complete and not (out / ".work").exists()
    assert json.loads((out / "run.json").read_text()) == run

    for left in ({"recipe.toml"}, {"recipe.toml", "run.json"}):
        for name in files_of(out) - left:
            (out / name).unlink()
        list(Run(prepare(frames(0.3), RECIPE, out, overwrite=True), progress=False, optimiser=optimiser))
        assert "density/f_07.npz" in files_of(out)


def test_overwriting_removes_frames_that_were_not_recorded_yet(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    out = tmp_path / "out"
    tnst_mi.stylize(frames(0.2, 0.4), RECIPE, out, progress=False)
    run = json.loads((out / "run.json").read_text())
    (out / "run.json").write_text(json.dumps(run | {"frames": run["frames"][:1]}))
    list(Run(prepare(frames(0.3), RECIPE, out, overwrite=True), progress=False, optimiser=optimiser))
    assert not any("f_08" in name for name in files_of(out))


def test_overwriting_removes_the_earlier_run_and_nothing_else(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    out = tmp_path / "out"
    tnst_mi.stylize(frames(0.2, 0.4), RECIPE, out, progress=False)
    mine = [out / "notes.txt", out / "images" / "photo.jpg", out / "images" / "f_08_notes.png", out / "density/my.npz"]
    for path in mine:
        path.write_text("mine")
    for _ in Run(prepare(frames(0.3), RECIPE, out, overwrite=True), progress=False, optimiser=optimiser):
        pass
    assert all(path.read_text() == "mine" for path in mine)
    assert [name for name in files_of(out) if "f_08" in name] == ["images/f_08_notes.png"]
    assert [frame["mass_before"] for frame in json.loads((out / "run.json").read_text())["frames"]] == [
        pytest.approx(0.3 * np.prod(SHAPE), rel=1e-6)
    ]


def test_only_a_run_is_overwritten(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    out = tmp_path / "out"

    def overwrite() -> None:
        list(Run(prepare(frames(0.3), RECIPE, out, overwrite=True), progress=False, optimiser=optimiser))

    (out / "images").mkdir(parents=True)
    (out / "images" / "photo.jpg").touch()
    with pytest.raises(InputError, match="holds no run that could be overwritten"):
        overwrite()
    (out / "run.json").write_text('{"frames": []}')
    with pytest.raises(InputError, match="holds no run that could be overwritten"):
        overwrite()
    (out / "recipe.toml").touch()
    (tmp_path / "victim.npz").touch()
    for name, message in ((r"../../victim", "expected a plain file name"), ("", "plain file name"), (7, "plain")):
        (out / "run.json").write_text(json.dumps({"frames": [{"name": name}]}))
        with pytest.raises(InputError, match=message):
            overwrite()
    for content in ("[]", "{", '{"frames": [1]}', '{"frames": 1}'):
        (out / "run.json").write_text(content)
        with pytest.raises(InputError, match="damaged, so it does not tell what to overwrite"):
            overwrite()
    assert files_of(tmp_path) == {"victim.npz", "out/run.json", "out/recipe.toml", "out/images/photo.jpg"}
    (out / "run.json").write_text('{"frames": []}')
    overwrite()
    assert {"images/photo.jpg", "density/f_07.npz"} <= files_of(out)


def test_folders_that_overwriting_leaves_empty_are_removed(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    out = tmp_path / "out"
    tnst_mi.stylize(frames(0.2), RECIPE, out, progress=False)
    RunFolder(out, RECIPE, overwrite=True)
    assert [path.name for path in out.iterdir()] == ["recipe.toml"]


def test_a_run_that_was_killed_at_once_is_resumed(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    """Between the first two files of the run."""
    out = tmp_path / "out"
    RunFolder(out, RECIPE)
    (out / ".tnst_mi-run.123.json").write_text('{"sta')
    for _ in Run(prepare(frames(0.2), RECIPE, out, resume=True), progress=False, optimiser=optimiser):
        pass
    assert optimiser.names == ["f_07"]


def test_potentials_are_not_kept_once_the_results_are_written(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    job = Run(prepare(frames(0.2), RECIPE, tmp_path / "out"), progress=False, optimiser=optimiser)
    assert [frame.stylized.potential for frame in job] == [(None, None)]
    job = Run(prepare(frames(0.2), RECIPE), progress=False, optimiser=optimiser)
    assert [frame.stylized.potential is optimiser.POTENTIAL for frame in job] == [True]


def test_a_refused_run_leaves_the_earlier_one(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    out = tmp_path / "out"
    tnst_mi.stylize(frames(0.2), RECIPE, out, progress=False)
    before = {name: (out / name).read_bytes() for name in files_of(out)}
    for bad in (Recipe(), Recipe(style=("spirals",), window=3)):
        with pytest.raises(InputError):
            list(Run(prepare(frames(0.3), bad, out, overwrite=True), progress=False, optimiser=optimiser))
    assert {name: (out / name).read_bytes() for name in files_of(out)} == before


def test_a_full_disk_stops_a_run_that_can_be_resumed(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    optimiser.failure = OSError(errno.ENOSPC, "No space left on device")
    out = tmp_path / "out"
    with pytest.raises(StoppedError, match="the disk is full; free some space and go on with --resume"):
        tnst_mi.stylize(frames(0.2), RECIPE, out, progress=False)
    optimiser.failure = None
    for _ in Run(prepare(frames(0.2), RECIPE, out, resume=True), progress=False, optimiser=optimiser):
        pass
    assert files_of(out) >= {"density/f_07.npz"}


def test_room_on_the_disk_is_checked_first(
    optimiser: FakeOptimiser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=5000))
    with pytest.raises(InputError, match=r"out: 0\.005 MB are free on its disk and the run needs up to 0\.009 MB"):
        Run(prepare(frames(0.2, 0.3), dataclasses.replace(RECIPE, lam=1.0), tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_where_results_may_not_go(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    source = tmp_path / "run" / "density"
    source.mkdir(parents=True)
    (tmp_path / "other" / "notes").mkdir(parents=True)
    for out, message in (
        (tmp_path / "file", "is a file"),
        (tmp_path / "file" / "below", "cannot be written to"),
        (Path("/proc/nowhere"), "cannot be written to"),
        (tmp_path / "other", "is not empty"),
        (tmp_path / "run", "contains the input"),
        (source, "contains the input"),
    ):
        if str(out).startswith("/proc") and not out.parent.exists():
            continue
        with pytest.raises(InputError, match=message):
            require_writable(out, source)
    require_writable(source / "out", source)
    require_writable(tmp_path / "a" / "b" / "c", source)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "other", "run"]


def test_working_bytes_counts_what_a_cell_needs() -> None:
    cells = 10 * 20 * 30
    scalar = working_bytes((10, 20, 30), 8, Recipe(style=("net",), lam=1.0))
    assert scalar == 1.25 * cells * 8 * (4 + 2 + 4 + 16)
    both = Recipe.from_dict({"style": ["net"], "lam": {"1": 0.0, "8": 1.0}, "window": 9})
    assert working_bytes((10, 20, 30), 8, both) == 1.25 * cells * 8 * (4 + 2 + 16 + 16 + 6 + 2 + 8 + 2)
