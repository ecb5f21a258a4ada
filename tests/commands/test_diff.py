"""`tnst-mi diff`: numbers in closed form, what is said of what differs, pictures, and what cannot be compared."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from command_line import Run as RunCommand
from command_line import refused, run, smoke
from jobs import optimiser
from PIL import Image

import tnst_mi
from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.job import Run
from tnst_mi.run.prepare import prepare

__all__ = ["optimiser", "run", "smoke"]

RECIPE = Recipe(style=("spirals",), gamma=0.3, octaves=1, iterations=1)


def stylized(source: Path, out: Path, recipe: Recipe = RECIPE) -> Path:
    """A run that doubles densities."""
    list(Run(prepare(source, recipe, out), progress=False))
    return out


def changed(out: Path, source: Path, factor: float) -> Path:
    """The run with its changes, d* − d = d, multiplied by a factor."""
    for frame in tnst_mi.load_frames(source):
        save_frames(out / "density", replace(frame, density=(1 + factor) * frame.density, velocity=None))
    return out


def difference(run: RunCommand, *arguments: object) -> tuple[dict, str]:
    """diff.json and what was said."""
    ran = run("diff", *arguments)
    assert ran.code == 0, ran.errors
    out = Path(str(arguments[arguments.index("--out") + 1]))
    return json.loads((out / "diff.json").read_text()), ran.out


@pytest.mark.usefixtures("optimiser")
def test_two_runs_of_one_input(run: RunCommand, smoke: Path, tmp_path: Path) -> None:
    a = stylized(smoke, tmp_path / "a")
    b = changed(stylized(smoke, tmp_path / "b", replace(RECIPE, iterations=3, lam=0.25)), smoke, -0.5)
    out = tmp_path / "out"
    found, said = difference(run, a, b, "--out", out)
    assert found["recipe"] == {"iterations": [1, 3], "lam": [0.0, 0.25]} or set(found["recipe"]) == {
        "iterations",
        "lam",
    }
    assert "recipe    2 keys differ\n" in said and "iterations: 1 → 3" in said
    assert found["only_a"] == found["only_b"] == []
    inputs = tnst_mi.load_frames(smoke)
    for frame, source in zip(found["frames"], inputs, strict=True):
        assert frame["names"] == [source.name, source.name] and frame["same_input"]
        # d* is 2 d and d / 2.
        assert frame["relative_difference"] == pytest.approx(0.75, rel=1e-6)
        assert frame["changes"] == pytest.approx([1.0, 0.5], rel=1e-6)
        assert frame["masses"] == pytest.approx([2 * source.mass, 0.5 * source.mass], rel=1e-6)
        # These frames are constant, and so are their changes.
        assert frame["change_correlation"] is None
        assert frame["largest_displacement"] == [5.0, 5.0]
        assert (frame["loss_before"], frame["loss_after"]) == ([4.0, 4.0], [3.0, 3.0])
    assert "density   ‖B − A‖/‖A‖ = 0.75 (0.75 to 0.75)" in said
    assert "loss      A 4 → 3, B 4 → 3" in said
    about = next(imageio_ffmpeg.read_frames(str(out / "diff.mp4")))
    with Image.open(out / "f_08_side.png") as side, Image.open(out / "f_08_wipe.png") as wiped:
        assert tuple(size + size % 2 for size in side.size) == about["size"]
        left, right = (np.asarray(wiped)[-200, x, 0] for x in (wiped.width // 4, 3 * wiped.width // 4))
    # One exposure for both: A is brighter, and the brightest of all frames is white.
    assert left > right > 0
    assert set(found["pictures"]["files"]) | {"diff.json"} == {path.name for path in out.iterdir()}


@pytest.mark.usefixtures("optimiser")
def test_changes_are_correlated_where_the_input_is_the_same(run: RunCommand, tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    density, other = random.random((2, 4, 6, 5)).astype(np.float32)
    sources = [tmp_path / f"source{index}.npz" for index in range(2)]
    for source, shown in zip(sources, (density, density + 0.1), strict=True):
        save_frames(source, Frame(shown, name="source0"))
    runs = [stylized(sources[0], tmp_path / "a"), stylized(sources[0], tmp_path / "b")]
    runs.append(stylized(sources[1], tmp_path / "c"))
    # Of b, d* − d is a mixture of that of a and of something else.
    mixed = density + 0.3 * density + 0.7 * other
    save_frames(tmp_path / "b" / "density", Frame(mixed, name="source0"))
    found, said = difference(run, *runs[:2], "--out", tmp_path / "ab")
    expected = np.corrcoef(density.ravel(), (0.3 * density + 0.7 * other).ravel())[0, 1]
    assert found["frames"][0]["change_correlation"] == pytest.approx(expected, rel=1e-5)
    assert found["mean"]["change_correlation"] == pytest.approx(expected, rel=1e-5)
    norm = np.linalg.norm
    assert found["frames"][0]["relative_difference"] == pytest.approx(
        norm(mixed - 2 * density) / norm(2 * density), rel=1e-5
    )
    assert f"change    correlation {expected:.3g}" in said and "recipe    the same" in said
    assert not (tmp_path / "ab" / "diff.mp4").exists()
    found, said = difference(run, runs[0], runs[2], "--out", tmp_path / "ac")
    assert found["frames"][0]["change_correlation"] is None and not found["frames"][0]["same_input"]
    assert "the frames of the inputs differ" in said


@pytest.mark.usefixtures("optimiser")
def test_a_run_that_goes_on_is_compared_as_far_as_it_is(run: RunCommand, smoke: Path, tmp_path: Path) -> None:
    job = Run(prepare(smoke, RECIPE, tmp_path / "a"), progress=False)
    next(job)
    ran = run("diff", tmp_path / "a", smoke)
    job.close()
    assert ran.code == 0, ran.errors
    assert "1 frame finished" in ran.out and "frames    1 in both; only in B: f_08, f_09" in ran.out
    assert "density   ‖B − A‖/‖A‖ = 0.5\n" in ran.out
    # Without --out, nothing is written.
    assert {path.name for path in tmp_path.iterdir()} == {"a", "smoke"}


@pytest.mark.usefixtures("optimiser")
def test_a_run_whose_input_is_gone(run: RunCommand, smoke: Path, tmp_path: Path) -> None:
    out = stylized(smoke, tmp_path / "a")
    smoke.rename(tmp_path / "elsewhere")
    ran = run("diff", out, tmp_path / "elsewhere")
    assert ran.code == 0 and "density   ‖B − A‖/‖A‖ = 0.5 (0.5 to 0.5)" in ran.out
    assert any("its input cannot be read again" in line for line in ran.errors)


def test_finer_densities_of_the_same_scene_look_the_same(run: RunCommand, tmp_path: Path) -> None:
    """Twice the cells in each direction: no numbers by cells, and equal pictures at equal optical thickness."""
    z, y, x = np.mgrid[:6, :10, :8] + 0.5
    coarse = np.exp(-(((z - 3) / 2) ** 2 + ((y - 5) / 3) ** 2 + ((x - 4) / 2) ** 2)).astype(np.float32)
    fine = np.repeat(np.repeat(np.repeat(coarse, 2, 0), 2, 1), 2, 2)
    for name, density in (("coarse", coarse), ("fine", fine), ("flat", coarse[:, :6])):
        save_frames(tmp_path / f"{name}.npz", Frame(density, name=name))
    found, said = difference(run, tmp_path / "coarse.npz", tmp_path / "fine.npz", "--out", tmp_path / "out")
    assert found["frames"][0]["relative_difference"] is None
    assert "grids differ (6×10×8 and 12×20×16, z y x): not compared cell by cell" in said
    assert "coarse is compared with fine" in said
    # Exposed pictures differ by less than a quarter, at edges: as much as trilinear interpolation blurs the coarse one.
    assert found["pictures"]["difference_scale"] > 4
    found, _ = difference(run, tmp_path / "coarse.npz", tmp_path / "flat.npz", "--out", tmp_path / "cut")
    with Image.open(tmp_path / "cut" / "coarse_side.png") as side:
        assert side.height > 400


def test_what_cannot_be_compared(run: RunCommand, smoke: Path, tmp_path: Path) -> None:
    save_frames(tmp_path / "other", Frame(np.ones((4, 6, 5)), name="g_20"))
    save_frames(tmp_path / "other", Frame(np.ones((4, 6, 5)), name="g_21"))
    for arguments, message in (
        ([smoke], "diff: expected two runs or densities, got 1"),
        ([smoke, tmp_path / "nowhere"], "nowhere"),
        ([smoke, tmp_path / "other"], "no frame is in all of them: .*smoke has 7 to 9; .*other has 20 to 21"),
        ([smoke, smoke, "--out", smoke], "smoke: is not empty; give another folder, or .* --overwrite"),
    ):
        refused(run, tmp_path, ["diff", *arguments], message)


@pytest.mark.usefixtures("optimiser")
def test_a_run_that_has_not_finished_a_frame(run: RunCommand, smoke: Path, tmp_path: Path) -> None:
    out = stylized(smoke, tmp_path / "a")
    record = json.loads((out / "run.json").read_text())
    (out / "run.json").write_text(json.dumps(record | {"frames": []}))
    refused(run, tmp_path, ["diff", out, smoke], "its run has not finished a frame")
    (out / "run.json").write_text("{")
    refused(run, tmp_path, ["diff", out, smoke], r"run\.json: not the record of a run, truncated, or damaged")
    for damage in ({"density_scale": "a"}, {"density_scale": -1}, {"inputs": [1]}, {"frames": [{"name": "a"}]}):
        (out / "run.json").write_text(json.dumps(record | damage))
        refused(run, tmp_path, ["diff", out, smoke], r"run\.json: damaged, so it does not tell")
    (out / "run.json").write_text("[]")
    refused(run, tmp_path, ["diff", out, smoke], r"run\.json: not the record of a run, truncated, or damaged")


@pytest.mark.usefixtures("optimiser")
def test_colours_that_runs_show_are_compared(run: RunCommand, tmp_path: Path) -> None:
    """Red smoke and smoke that is red in its thin half and blue in the other, which has three quarters of the mass."""
    red, blue = np.float32([1, 0, 0]), np.float32([0, 0, 1])
    density = np.ones((4, 6, 8), np.float32)
    density[..., 4:] = 3
    right = (np.arange(8) >= 4)[:, None] & np.ones((4, 6, 1, 1), bool)
    source = Frame(density, name="s", grids={"Cd": np.broadcast_to(red, (*density.shape, 3))})
    save_frames(tmp_path / "s.npz", source)
    a, grey = (stylized(tmp_path / "s.npz", tmp_path / c, replace(RECIPE, colour=c)) for c in ("keep", "off"))
    b = stylized(tmp_path / "s.npz", tmp_path / "b", replace(RECIPE, colour="keep"))
    save_frames(b / "density", replace(source, density=2 * density, grids={"Cd": np.where(right, blue, red)}))
    found, said = difference(run, a, b, "--out", tmp_path / "out")
    expected = np.sqrt(0.75 * 2 / 3)
    assert found["frames"][0]["colour_difference"] == pytest.approx(expected, rel=1e-6)
    assert found["mean"]["colour_difference"] == pytest.approx(expected, rel=1e-6)
    assert "colour    B − A over the smoke, root mean square of display values: 0.707" in said
    with Image.open(tmp_path / "out" / "s_side.png") as side:
        pixels = np.asarray(side.convert("RGB"), int)[-200]
    shown = [
        pixels[round(share * pixels.shape[0])].tolist() for share in (1 / 12, 3 / 12, 5 / 12, 7 / 12, 9 / 12, 11 / 12)
    ]
    assert [[value > 10 for value in colour] for colour in shown] == [
        *[[True, False, False]] * 3,
        *[[False, False, True], [False, False, False], [True, False, True]],
    ]
    # A run whose pictures are grey has no colours, and smoke without any is white.
    found, said = difference(run, grey, grey, "--out", tmp_path / "grey_out")
    assert found["frames"][0]["colour_difference"] is None and "colour  " not in said
    found, _ = difference(run, grey, a, "--out", tmp_path / "mixed")
    assert found["frames"][0]["colour_difference"] == pytest.approx(np.sqrt(2 / 3), rel=1e-6)


@pytest.mark.usefixtures("optimiser")
def test_a_record_of_temperatures_that_is_damaged(run: RunCommand, smoke: Path, tmp_path: Path) -> None:
    out = stylized(smoke, tmp_path / "a")
    record = json.loads((out / "run.json").read_text()) | {"temperature": ["heat", "hot"]}
    (out / "run.json").write_text(json.dumps(record))
    refused(run, tmp_path, ["diff", out, out], "run.json: damaged")
