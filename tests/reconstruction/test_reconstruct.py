"""A density from pictures: how near it comes, what is found with it, and where it goes on after it was stopped."""

from __future__ import annotations

import json
import re
import signal
from pathlib import Path

import numpy as np
import pytest
from render_views import write_views

import tnst_mi
from tnst_mi.cli import main
from tnst_mi.io.pictures.exr import read_exr, write_exr
from tnst_mi.io.pictures.png import write_png
from tnst_mi.io.pictures.srgb import srgb
from tnst_mi.reconstruction.fitting.descent import Descent
from tnst_mi.reconstruction.reconstruct import reconstruct
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

GAMMA = 0.3
QUICK = {"iterations": 60, "levels": 1, "batch": 3}


def distance(found: tnst_mi.Reconstruction, density: np.ndarray, frame: int = 0) -> float:
    """Relative L2 distance of a density that was found."""
    with np.load(found.densities[frame]) as file:
        return float(np.linalg.norm(file["density"] - density) / np.linalg.norm(density))


def changed(views: Path, out: Path, picture) -> Path:
    """The same views with other pictures: `picture(image, name)` gives what is written, or writes it itself."""
    out.mkdir()
    for file in views.parent.glob("*.exr"):
        if (image := picture(read_exr(file), file.stem)) is not None:
            write_exr(out / file.name, image, {})
    (out / "cameras.toml").write_text(views.read_text())
    return out / "cameras.toml"


def test_the_density_is_found(views, cloud, tmp_path):
    found = reconstruct(views, tmp_path / "out", {"iterations": 80, "levels": 2}, progress=False)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert distance(found, cloud) < 0.1
    assert found.records[0]["psnr"] > 45 and report["frames"] == list(found.records)
    assert report["finished"] and report["held_out"] == ["held_out_00", "held_out_01", "held_out_02"]
    assert len(report["views"]) == 12 and report["shape"] == [12, 16, 10]
    # What report.json says can be measured again, by whoever has the pictures.
    seen = read_exr(tmp_path / "out" / "images" / "smoke_held_out_01.exr")
    picture, peak = read_exr(views.with_name("held_out_01.exr")), found.records[0]["peak"]
    again = -10 * np.log10(np.mean(((seen - picture) / peak) ** 2))
    assert again == pytest.approx(found.records[0]["psnr_of_views"]["held_out_01"], abs=1e-3)


def test_pictures_of_render_say_how_bright_their_smoke_is(views, cloud, tmp_path, capsys):
    (tmp_path / "exposed").mkdir()
    for file in views.parent.glob("*.exr"):
        attributes = {"gamma": GAMMA, "exposure": 0.2, "quadrature": "exact"}
        write_exr(tmp_path / "exposed" / file.name, 0.2 * read_exr(file), attributes)
    cameras = tmp_path / "exposed" / "cameras.toml"
    cameras.write_text(views.read_text())
    command = ["reconstruct", str(cameras), "--out", str(tmp_path / "out"), "--iterations", "60", "--levels", "1"]
    assert main(command) == 2
    told = capsys.readouterr().err
    assert "multiplied by the exposure 0.2, " in told and told.count("\n") == 1
    remedy = re.search("give (--gamma [0-9.]+ --brightness [0-9.]+),", told)[1].split()
    assert main([*command, *remedy]) == 0
    with np.load(tmp_path / "out" / "density" / "smoke.npz") as file:
        assert np.linalg.norm(file["density"] - cloud) < 0.15 * np.linalg.norm(cloud)


def test_a_background_is_found_or_given_as_a_picture(views, cloud, tmp_path):
    across = np.linspace(0.2, 0.6, 20, dtype=np.float32)[None, :].repeat(20, 0)
    even = changed(views, tmp_path / "even", lambda image, name: image + 0.5 * (1 - GAMMA * image))
    found = reconstruct(even, tmp_path / "a", {**QUICK, "background": "auto"}, progress=False)
    assert found.records[0]["background"] == pytest.approx(0.5, rel=0.02)
    assert distance(found, cloud) < 0.16
    uneven = changed(views, tmp_path / "uneven", lambda image, name: image + across * (1 - GAMMA * image))
    write_exr(uneven.with_name("empty.exr"), across, {})
    uneven.write_text(re.sub(r"(image = .*)", r'\1\nbackground = "empty.exr"', uneven.read_text()))
    assert distance(reconstruct(uneven, tmp_path / "b", QUICK, progress=False), cloud) < 0.16


def test_gamma_is_found(views, cloud, tmp_path):
    found = reconstruct(views, tmp_path / "out", {"iterations": 60, "levels": 2, "gamma": "auto"}, progress=False)
    assert found.records[0]["gamma"] == pytest.approx(GAMMA, rel=0.04)
    assert distance(found, cloud) < 0.1


def test_masks_leave_pixels_out(views, cloud, tmp_path):
    """A bright pole before the smoke in every picture is no smoke."""

    def with_pole(image, name):
        mask = np.ones((20, 20), np.float32)
        mask[:, 9:11] = 0
        write_png(tmp_path / "masked" / f"{name}.png", mask)
        return np.where(mask > 0, image, 3.0)

    masked = changed(views, tmp_path / "masked", with_pole)
    bare = distance(reconstruct(masked, tmp_path / "a", QUICK, progress=False), cloud)
    masked.write_text(re.sub(r'image = "(.*).exr"', r'image = "\1.exr"\nmask = "\1.png"', masked.read_text()))
    assert distance(reconstruct(masked, tmp_path / "b", QUICK, progress=False), cloud) < 0.3 < 0.6 < bare


def test_pictures_of_displays_are_linearised(views, cloud, tmp_path):
    shown = changed(
        views, tmp_path / "png", lambda image, name: write_png(tmp_path / "png" / f"{name}.png", srgb(image * GAMMA))
    )
    shown.write_text(shown.read_text().replace(".exr", ".png"))
    found = reconstruct(shown, tmp_path / "a", {**QUICK, "brightness": 1.0}, progress=False)
    assert distance(found, cloud) < 0.16
    wrong = reconstruct(shown, tmp_path / "b", {**QUICK, "brightness": 1.0, "transfer": "linear"}, progress=False)
    assert distance(wrong, cloud) > 0.3


def test_more_pixels_than_cells_are_averaged(cloud, tmp_path):
    fine = EmissionAbsorptionRenderer(cloud.shape, GAMMA, "exact", 1.0, size=(90, 90))
    views = write_views(tmp_path / "fine", [tnst_mi.Frame(cloud)], fine, (12, 2), 0.1, GAMMA)
    found = reconstruct(views, tmp_path / "out", QUICK, progress=False)
    # Nearly 4 × 4 pixels make one: a quarter of their noise of 10% is left.
    assert found.records[0]["noise"] == pytest.approx(0.1 / 4, rel=0.25)
    assert distance(found, cloud) < 0.2


def test_what_was_stopped_goes_on_to_the_same_bits(views, tmp_path, monkeypatch):
    keys = {"iterations": 30, "levels": 2, "batch": 3, "gamma": "auto"}
    whole = reconstruct(views, tmp_path / "whole", keys, progress=False)
    step, taken = Descent.step, []

    def stopped_now_and_then(descent):
        loss = step(descent)
        taken.append(descent.done)
        if len(taken) in (5, 30, 45):  # on both grids
            signal.raise_signal(signal.SIGINT)
        return loss

    monkeypatch.setattr(Descent, "step", stopped_now_and_then)
    for attempt in range(3):
        found = reconstruct(views, tmp_path / "parts", keys, progress=False, resume=attempt > 0)
        assert found.interrupted
        assert found.records[-1]["finished"] is False and found.densities[-1].is_file()
    found = reconstruct(views, tmp_path / "parts", keys, progress=False, resume=True)
    assert not found.interrupted
    with np.load(whole.densities[0]) as a, np.load(found.densities[0]) as b:
        assert np.array_equal(a["density"], b["density"])
    for key in ("gamma", "convergence"):
        assert found.records[0][key] == whole.records[0][key]
    with pytest.raises(tnst_mi.InputError, match="with other settings, cameras or frames"):
        reconstruct(views, tmp_path / "parts", {**keys, "seed": 1}, progress=False, resume=True)


def test_a_background_that_is_not_looked_for_yet_goes_on_to_the_same_bits(views, tmp_path, monkeypatch):
    """Pictures have what no background explains; stopped before it is looked for, it is not known yet either."""
    across = np.linspace(0.2, 0.9, 20, dtype=np.float32)[None, :].repeat(20, 0)
    uneven = changed(views, tmp_path / "uneven", lambda image, name: image + across * (1 - GAMMA * image))
    keys = {"iterations": 12, "levels": 1, "batch": 3, "background": "auto"}
    whole = reconstruct(uneven, tmp_path / "whole", keys, progress=False)
    step = Descent.step

    def stopped_in_the_first_third(descent):
        loss = step(descent)
        if descent.done == 2:
            signal.raise_signal(signal.SIGINT)
        return loss

    monkeypatch.setattr(Descent, "step", stopped_in_the_first_third)
    assert reconstruct(uneven, tmp_path / "parts", keys, progress=False).interrupted
    found = reconstruct(uneven, tmp_path / "parts", keys, progress=False, resume=True)
    with np.load(whole.densities[0]) as a, np.load(found.densities[0]) as b:
        assert np.array_equal(a["density"], b["density"])


def test_each_frame_starts_from_the_one_before(cloud, renderer, tmp_path):
    """Smoke that moves by 3 cells to +y: a few steps suffice for the second frame where the velocity is known."""
    moved = np.zeros_like(cloud)
    moved[:, 3:] = cloud[:, :-3]
    velocity = np.zeros((*cloud.shape, 3), np.float32)
    velocity[..., 1] = 3
    frames = [tnst_mi.Frame(d, velocity, name=f"f_{n:04d}", number=n) for n, d in ((7, cloud), (8, moved))]
    views = write_views(tmp_path / "views", frames, renderer, (8, 2), 0.0, GAMMA)
    tnst_mi.save_frames(tmp_path / "simulation", frames)
    keys = {**QUICK, "iterations": 16}
    found = reconstruct(views, tmp_path / "out", keys, frames="7:8", velocities=tmp_path / "simulation", progress=False)
    assert [file.name for file in found.densities] == ["smoke_0007.npz", "smoke_0008.npz"]
    assert distance(found, moved, 1) < 0.6 * distance(found, cloud)
