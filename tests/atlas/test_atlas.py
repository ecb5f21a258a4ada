"""The atlas: ascent on pixels, the ball of smoke, what is kept and resumed, sheet and page, and the command."""

from __future__ import annotations

import re
import signal
from collections import Counter
from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
import torch
from command_line import Run, refused, run, tiny_weights
from PIL import Image

from tnst_mi import GoogLeNet, InputError
from tnst_mi.atlas.excitation import Ascent, excite, noise
from tnst_mi.atlas.layer_atlas import AtlasSettings, LayerAtlas, channel_numbers
from tnst_mi.atlas.smoke_patch import PatchSettings, ball, stylized_ball
from tnst_mi.fields.pyramid import normalise
from tnst_mi.losses.evaluation import as_rgb

__all__ = ["run", "tiny_weights"]

LAYER = "inception_3b/3x3_reduce"
ASCENT = Ascent(size=32, octaves=1, iterations=10, rate=0.06, shift=3)
QUICK = AtlasSettings(
    Ascent(size=16, octaves=1, iterations=2),
    PatchSettings((2, 16, 16), {"octaves": 1, "iterations": 2, "views": 1, "eta": 0.02}),
)


@pytest.fixture(scope="module")
def network(tiny_weights: Path) -> GoogLeNet:
    return GoogLeNet.load(tiny_weights)


def means(network: GoogLeNet, picture: np.ndarray, layer: str = LAYER) -> np.ndarray:
    """Mean of every channel for a picture."""
    with torch.no_grad():
        values = network(as_rgb(torch.from_numpy(picture)[None]), layers=[layer])[layer]
    return values.mean((0, 2, 3)).numpy()


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# --- the picture that excites a channel ------------------------------------------------------------------


def test_no_other_picture_excites_a_channel_as_much(network: GoogLeNet) -> None:
    channels = [0, 5, 9, 15]
    pictures = [excite(network, LAYER, channel, ASCENT) for channel in channels]
    for picture in pictures:
        assert picture.shape == (32, 32) and picture.dtype == np.float32
        assert picture.min() >= 0.0 and picture.max() <= 1.0 and picture.std() > 0.1
    reached = np.array([means(network, picture)[channels] for picture in pictures])
    assert np.array_equal(reached.argmax(axis=0), range(4)), reached


@pytest.mark.parametrize("channel", [3, 20])
def test_a_picture_excites_its_channel_among_many(channel: int) -> None:
    network, layer = GoogLeNet.load("patterns"), "inception_4b/pool_proj"
    start = means(network, noise(ASCENT, channel, ASCENT.size), layer)
    gains = means(network, excite(network, layer, channel, ASCENT), layer) - start
    assert gains[channel] > 5.0 * abs(start[channel])
    assert gains[channel] > 2.0 * np.abs(np.delete(gains, channel)).mean()
    assert (gains > gains[channel]).mean() < 0.1


def test_a_picture_depends_on_its_channel_and_seed_alone(network: GoogLeNet) -> None:
    first = excite(network, LAYER, 3, ASCENT)
    other = excite(network, LAYER, 4, ASCENT)
    assert np.array_equal(excite(network, LAYER, 3, ASCENT), first)
    assert not np.array_equal(other, first)
    reseeded = excite(network, LAYER, 3, replace(ASCENT, seed=1))
    assert not np.array_equal(reseeded, first)


def test_a_picture_is_normalised_like_a_grid_that_is_even_in_depth() -> None:
    plane = np.random.default_rng(0).standard_normal((1, 21, 18)).astype(np.float32)
    flat = normalise(mi.TensorXf(plane), 3).numpy()
    deep = normalise(mi.TensorXf(np.repeat(plane, 6, axis=0)), 3).numpy()
    assert np.allclose(deep, flat, rtol=0, atol=1e-5)


# --- the ball of smoke -----------------------------------------------------------------------------------


def test_the_ball_is_uneven_smoke_within_its_grid() -> None:
    density = ball((12, 24, 24), seed=0)
    assert density.shape == (12, 24, 24) and density.min() == 0.0
    assert np.array_equal(ball((12, 24, 24), seed=0), density)
    assert not np.array_equal(ball((12, 24, 24), seed=1), density)
    z, y, x = (((np.arange(n) + 0.5) / n - 0.5) / 0.48 for n in density.shape)
    inside = z[:, None, None] ** 2 + y[None, :, None] ** 2 + x**2 < 1.0
    assert np.array_equal(density > 0.0, inside)
    assert density[6, 10:14, 10:14].std() > 0.05


def test_smoke_moves_towards_the_channel(network: GoogLeNet) -> None:
    settings = PatchSettings((4, 24, 24), {"octaves": 1, "iterations": 4, "views": 1, "eta": 0.02})
    patch = stylized_ball(network, LAYER, 5, settings)
    assert patch.image.shape == (24, 24)
    assert patch.after > patch.before
    opposite = stylized_ball(network, LAYER, 6, settings)
    assert not np.array_equal(opposite.image, patch.image)
    assert np.array_equal(stylized_ball(network, LAYER, 5, settings).image, patch.image)


# --- what is kept ----------------------------------------------------------------------------------------


def test_an_interrupted_atlas_goes_on_to_the_same_bits(network: GoogLeNet, tmp_path: Path) -> None:
    whole = LayerAtlas(network, LAYER, tmp_path / "whole", QUICK)
    whole.make([0, 1, 2])
    whole.publish()

    def interrupt(channel: int, what: str) -> None:
        if (channel, what) == (1, "smoke"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        LayerAtlas(network, LAYER, tmp_path / "parts", QUICK).make([0, 1, 2], interrupt)
    again = LayerAtlas(network, LAYER, tmp_path / "parts", QUICK)
    assert again.missing([0, 1, 2]) == [1, 2]
    made: Counter[tuple[int, str]] = Counter()
    again.make([0, 1, 2], lambda channel, what: made.update([(channel, what)]))
    assert set(made) == {(1, "smoke"), (2, "picture"), (2, "smoke")}
    again.publish()
    assert files(tmp_path / "parts") == files(tmp_path / "whole")


def test_what_a_kill_leaves_behind_is_made_anew(network: GoogLeNet, tmp_path: Path) -> None:
    atlas = LayerAtlas(network, LAYER, tmp_path, QUICK)
    atlas.make([0, 1])
    expected = files(tmp_path)
    file = tmp_path / "channels" / "001_picture.png"
    file.write_bytes(file.read_bytes()[:-40])
    (tmp_path / "channels" / ".tnst_mi-001_smoke.4711.png").write_bytes(b"half")
    again = LayerAtlas(network, LAYER, tmp_path, QUICK)
    assert again.missing([0, 1]) == [1]
    again.make([0, 1])
    assert files(tmp_path) == expected


def test_an_atlas_is_of_one_layer_one_network_and_one_way(network: GoogLeNet, tmp_path: Path) -> None:
    out = tmp_path / "atlas"
    LayerAtlas(network, "mixed3b_3x3_bottleneck_pre_relu", out, QUICK)
    LayerAtlas(network, LAYER, out, QUICK)  # the same layer by its other name
    with pytest.raises(InputError, match="atlas of another layer; give another --out"):
        LayerAtlas(network, "inception_3b/1x1", out, QUICK)
    with pytest.raises(InputError, match="made with other settings"):
        LayerAtlas(network, LAYER, out)
    (out / "atlas.json").write_text("{")
    with pytest.raises(InputError, match=r"atlas\.json: damaged"):
        LayerAtlas(network, LAYER, out, QUICK)
    (tmp_path / "else").mkdir()
    (tmp_path / "else" / "file").touch()
    with pytest.raises(InputError, match="is not empty; give"):
        LayerAtlas(network, LAYER, tmp_path / "else", QUICK)


@pytest.mark.parametrize(
    ("text", "numbers"),
    [("0:3", [0, 1, 2, 3]), ("5", [5]), ("7,2:4,3", [2, 3, 4, 7]), ("9:9", [9])],
)
def test_channels_include_both_ends(text: str, numbers: list[int]) -> None:
    assert channel_numbers(text, 10) == numbers


@pytest.mark.parametrize("text", ["", "x", "-1", "3:", ":3", "1:2:3", "4:3", "10", "0:10", "1,,2", "٣"])
def test_no_channels(text: str) -> None:
    with pytest.raises(InputError, match=re.escape(f"--channels {text}: expected numbers")):
        channel_numbers(text, 10)


# --- the command -----------------------------------------------------------------------------------------


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tnst_mi.atlas.layer_atlas.AtlasSettings", lambda: QUICK)


def test_the_command_writes_a_sheet_and_a_page(run: Run, tiny_weights: Path, tmp_path: Path, quick: None) -> None:
    command = ("atlas", "--layer", LAYER, "--weights", tiny_weights, "--out", tmp_path / "out")
    ran = run(*command, "--channels", "0:2")
    assert ran.code == 0, ran.errors
    assert "channels  3 of 16" in ran.out and str(tmp_path / "out" / "atlas.html") in ran.out
    assert any("channel 2 (3/3) smoke" in line for line in ran.errors)
    # Those that were there stay in sheet and page.
    assert run(*command, "--channels", "9").code == 0
    page = (tmp_path / "out" / "atlas.html").read_text("utf-8")
    assert re.findall(r'data-channel="(\d+)"', page) == ["0", "1", "2", "9"]
    assert f'data-flag="--semantic {LAYER}:9"' in page
    assert set(re.findall(r'(?:src|href)="([^"]{0,22})', page)) == {"data:image/png;base64,"}
    assert not re.search(r"https?:|url\(|@import", page)
    with Image.open(tmp_path / "out" / "atlas.png") as sheet:
        assert sheet.mode == "L" and sheet.width > 4 * 16 and sheet.height > 2 * 16
    before = files(tmp_path / "out")
    ran = run(*command, "--channels", "0:2")
    assert (ran.code, ran.errors) == (0, [])
    assert files(tmp_path / "out") == before


def test_ctrl_c_keeps_what_is_finished(
    run: Run, tiny_weights: Path, tmp_path: Path, quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = ("atlas", "--layer", LAYER, "--weights", tiny_weights, "--out", tmp_path / "out", "--channels", "0:2")

    def pressed(*arguments: object) -> np.ndarray:
        if arguments[2] == 1:
            signal.raise_signal(signal.SIGINT)
        return excite(*arguments)

    monkeypatch.setattr("tnst_mi.atlas.layer_atlas.excite", pressed)
    ran = run(*command)
    assert ran.code == 3
    assert "interrupted with 2 of 3 channels to go; the same command goes on in" in ran.errors[-1]
    assert (tmp_path / "out" / "atlas.html").is_file()
    monkeypatch.setattr("tnst_mi.atlas.layer_atlas.excite", excite)
    ran = run(*command)
    assert ran.code == 0 and "channels  3 of 16" in ran.out


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--layer", "inception_9z"), "layer 'inception_9z': unknown; the nearest are"),
        (("--channels", "5:3"), "--channels 5:3: expected numbers from 0 to 15"),
        (("--channels", "0:16"), "--channels 0:16: expected numbers from 0 to 15"),
        (("--weights", "nowhere"), "weights nowhere: no such file or folder"),
        (("--variant", "scalar_rgb"), "--variant scalar_rgb: expected"),
    ],
)
def test_bad_input(run: Run, tiny_weights: Path, tmp_path: Path, flags: tuple[str, ...], message: str) -> None:
    arguments = ["atlas", "--layer", LAYER, "--weights", tiny_weights, "--out", tmp_path / "out", *flags]
    refused(run, tmp_path, arguments, message)
