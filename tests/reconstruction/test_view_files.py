"""The pictures of views: what of them is read, of which frame and layer, and what cannot be read or judge."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from render_views import write_views

import tnst_mi
from tnst_mi.cli import main
from tnst_mi.io.pictures.exr import write_exr
from tnst_mi.io.pictures.png import write_png
from tnst_mi.reconstruction.preparation import prepare

FLAGS = ["--iterations=2", "--levels=1", "--batch=3"]


@pytest.fixture
def copied(views, tmp_path) -> Path:
    shutil.copytree(views.parent, tmp_path / "views")
    return tmp_path / "views" / "cameras.toml"


def test_layers_count_in_masks_and_backgrounds_too(copied):
    """Also where the picture itself is a file of one."""
    layers = np.stack([np.full((20, 20, 1), value, np.float32) for value in (0.25, 0.75)])
    np.savez(copied.with_name("several.npz"), data=layers)
    beside = r'\1\nlayer = 1\nmask = "several.npz"\nbackground = "several.npz"'
    copied.write_text(re.sub(r"(image = .*)", beside, copied.read_text()))
    for photograph in prepare(copied, {}, None, None).photographs(None):
        assert (photograph.weights == 0.75).all() and photograph.background is not None
        assert (photograph.background == 0.75).all()


def test_backgrounds_may_be_those_of_frames(cloud, renderer, tmp_path):
    frames = [tnst_mi.Frame(cloud, name=f"f_{n:04d}", number=n) for n in (7, 8)]
    cameras = write_views(tmp_path, frames, renderer, (2, 0), 0.0, 0.3)
    for number in (7, 8):
        write_exr(tmp_path / f"empty_{number}.exr", np.full((20, 20), number, np.float32), {})
    cameras.write_text(re.sub(r"(image = .*)", r'\1\nbackground = "empty_#.exr"', cameras.read_text()))
    prepared = prepare(cameras, {}, "7:8", None)
    for index, number in enumerate((7, 8)):
        for photograph in prepared.photographs(number):
            assert photograph.background is not None and np.allclose(photograph.background, number)
        assert tmp_path / f"empty_{number}.exr" in prepared.sources(index)


def test_a_frame_without_smoke_is_named(cloud, renderer, tmp_path, capsys):
    frames = [tnst_mi.Frame(cloud * (n > 7), name=f"f_{n:04d}", number=n) for n in (7, 8)]
    cameras = write_views(tmp_path / "views", frames, renderer, (2, 0), 0.0, 0.3)
    assert main(["reconstruct", str(cameras), "--out", str(tmp_path / "out"), "--frames=7:8", *FLAGS]) == 2
    told = capsys.readouterr().err
    assert "view_00_0007.exr: it and all other pictures of frame 7 are black" in told
    assert "give --frames without 7" in told and told.count("\n") == 1


def test_a_view_of_which_nothing_is_left_does_not_judge(copied, tmp_path, capsys):
    """It counted as one that is shown without error."""
    out = tmp_path / "out"
    write_png(copied.with_name("none.png"), np.zeros((20, 20), np.float32))
    copied.write_text(copied.read_text().replace('"held_out_00.exr"', '"held_out_00.exr"\nmask = "none.png"'))
    found = tnst_mi.reconstruct(copied, out, {"iterations": 2, "levels": 1, "batch": 3}, progress=False)
    record = found.records[0]
    assert set(record["psnr_of_views"]) == {"held_out_01", "held_out_02"}
    errors = [10 ** (-psnr / 10) for psnr in record["psnr_of_views"].values()]
    assert record["psnr"] == pytest.approx(-10 * np.log10(np.mean(errors)), abs=1e-4)
    assert record["masked_views"] == ["held_out_00"]
    page = (out / "report.html").read_text()
    assert "2 views that were held out" in page and "held_out_00: masks leave nothing" in page
    assert main(["reconstruct", str(copied), "--out", str(out), *FLAGS, "--resume"]) == 0
    assert "dB; masks leave nothing of held_out_00, gamma" in capsys.readouterr().out


WRONG = {
    "alpha by brightness": ({"channel": "alpha", "brightness": 3.0}, "brightness = 3.0: with channel = alpha"),
    "alpha by auto": ({"channel": "alpha", "brightness": "auto"}, "brightness = auto: with channel = alpha"),
    "alpha, gamma": ({"channel": "alpha", "gamma": "auto"}, "gamma = auto: with channel = alpha"),
    "albedo": ({"albedo": 0.5}, "albedo = 0.5: is of scattered light"),
    "light": ({"light": "lamp.xml"}, "light = lamp.xml: is of scattered light"),
    "spp": ({"spp": 3}, "spp = 3: is of scattered light"),
}


@pytest.mark.parametrize(("settings", "told"), WRONG.values(), ids=WRONG)
def test_settings_without_effect_are_refused(views, settings, told):
    with pytest.raises(tnst_mi.InputError, match=re.escape(told)):
        prepare(views, settings, None, None)


def test_settings_that_agree_are_accepted(views):
    assert prepare(views, {"channel": "alpha", "brightness": 1.0}, None, None).settings.known_brightness == 1
    assert prepare(views, {"albedo": 0.9, "spp": 16}, None, None).settings.spp == 16
