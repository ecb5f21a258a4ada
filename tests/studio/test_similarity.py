"""Search by a picture: what was made to excite a channel, or to be of a class, finds it."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, PngImagePlugin
from studios import Studio, running

from tnst_mi.atlas.excitation import Ascent, excite
from tnst_mi.io.pictures.png import eight_bits
from tnst_mi.machine.backend import torch_device
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.network.shipped import PATTERNS
from tnst_mi.recipe.paths import STYLES
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.studio.choices.motifs import MotifBrowser
from tnst_mi.studio.choices.settings import StudioSettings
from tnst_mi.studio.choices.similarity import COMPARED, PictureAnswers
from tnst_mi.studio.places import Places

LAYER = "inception_4b/pool_proj"
CHANNELS = (0, 14, 28, 63)


def encoded(picture: np.ndarray) -> bytes:
    png = io.BytesIO()
    Image.fromarray(eight_bits(picture)).save(png, "PNG")
    return png.getvalue()


@pytest.fixture(scope="module")
def shipped() -> GoogLeNet:
    return GoogLeNet.load(PATTERNS).to(torch_device())


@pytest.fixture(scope="module")
def exciting(shipped: GoogLeNet) -> dict[int, bytes]:
    """Pictures that excite channels, by their numbers."""
    ascent = Ascent(iterations=8)
    return {channel: encoded(excite(shipped, LAYER, channel, ascent)) for channel in CHANNELS}


@pytest.fixture(scope="module")
def answers() -> PictureAnswers:
    return PictureAnswers()


@pytest.fixture
def browser(tmp_path: Path) -> MotifBrowser:
    return MotifBrowser(Places(tmp_path), tmp_path / "out")


def found(browser: MotifBrowser, answers: PictureAnswers, body: bytes, text: str, kind: str) -> list[str]:
    motifs = browser.alike(text, PATTERNS, answers.answer("picture", body, PATTERNS))
    return [motif["goal"] for motif in motifs if motif["kind"].startswith(kind)]


def test_a_picture_that_excites_a_channel_finds_it(
    exciting: dict[int, bytes], browser: MotifBrowser, answers: PictureAnswers
) -> None:
    ranks, by_mean = [], []
    for channel, body in exciting.items():
        ranks.append(found(browser, answers, body, LAYER, "channels").index(f"{LAYER}:{channel}"))
        means = answers.answer("picture", body, PATTERNS).means[LAYER]
        by_mean.append(int((means > means[channel]).sum()))
    # Of 64 channels; it is their scales that do this: some have large means for all pictures.
    assert max(ranks) <= 2 and ranks.count(0) >= 2
    assert max(by_mean) > 2


def test_a_style_finds_the_tag_of_its_motif(browser: MotifBrowser, answers: PictureAnswers) -> None:
    for style, tag in (("spirals", "spiral"), ("flames", "fire"), ("cells", "cells")):
        assert found(browser, answers, (STYLES / f"{style}.png").read_bytes(), "", "tags")[0] == tag
    # The text counts too.
    assert found(browser, answers, (STYLES / "flames.png").read_bytes(), "spira", "tags") == ["spiral"]


def test_the_order_is_that_of_the_scores(shipped: GoogLeNet, browser: MotifBrowser, answers: PictureAnswers) -> None:
    body = (STYLES / "net.png").read_bytes()
    answer, tags = answers.answer("net.png", body, PATTERNS), browser.tags(PATTERNS)
    scores = dict(zip(tags, answer.means["logits"].tolist(), strict=True))
    listed = found(browser, answers, body, "", "tags")
    assert listed == sorted(tags, key=lambda tag: -scores[tag])[: len(listed)] and len(listed) == 64
    channels = found(browser, answers, body, "", "channels")
    values = [answer.deviations[layer][int(number)] for layer, number in (goal.split(":") for goal in channels)]
    assert values == sorted(values, reverse=True)
    assert values[0] == max(float(answer.deviations[layer].max()) for layer in COMPARED)


def test_the_same_picture_gives_the_same_order(browser: MotifBrowser, exciting: dict[int, bytes]) -> None:
    orders = [PictureAnswers().answer("a", exciting[14], PATTERNS) for _ in range(2)]
    for layer in COMPARED:
        np.testing.assert_array_equal(orders[0].deviations[layer], orders[1].deviations[layer])
    first, second = (browser.alike("", PATTERNS, answer) for answer in orders)
    assert first == second


def test_channels_of_an_atlas_have_its_scale(tmp_path: Path, browser: MotifBrowser, answers: PictureAnswers) -> None:
    body = (STYLES / "net.png").read_bytes()
    mean = answers.answer("net.png", body, PATTERNS).means[LAYER]
    (tmp_path / "atlas" / "channels").mkdir(parents=True)
    (tmp_path / "atlas" / "atlas.json").write_text(json.dumps({"layer": LAYER, "flavour": PATTERNS}))
    # By how they are made, the picture raises channel 5 by a fifth of what is possible, 7 by half, 6 by nothing.
    for channel, share in ((5, 0.2), (6, 0.0), (7, 0.5)):
        text = PngImagePlugin.PngInfo()
        text.add_text("before", repr(float(mean[channel]) - share))
        text.add_text("after", repr(float(mean[channel]) - share + 1.0))
        file = tmp_path / "atlas" / "channels" / f"{channel:03d}_picture.png"
        Image.new("L", (8, 8), 128).save(file, pnginfo=text)
    motifs = browser.alike("", PATTERNS, answers.answer("net.png", body, PATTERNS))
    titles = [motif["title"] for motif in motifs if motif["kind"].startswith("channels of atlases")]
    assert titles == ["7 50% · 4b/pool_proj", "5 20% · 4b/pool_proj", "6 0% · 4b/pool_proj"]
    goals = [(motif["key"], motif["goal"]) for motif in motifs]
    assert len(goals) == len(set(goals))


@pytest.fixture
def studio(tmp_path: Path) -> Iterator[Studio]:
    with running(tmp_path, tmp_path / "out") as started:
        # Not those of ImageNet, where there are some.
        started.session.settings = StudioSettings(Recipe(weights=PATTERNS))
        yield started


def test_pictures_to_compare_with_are_bounded_and_not_trusted(studio: Studio, tmp_path: Path) -> None:
    ordered = studio.request("POST", "/alike?name=x.png&find=sp", (STYLES / "spirals.png").read_bytes())
    assert ordered.status == 200 and ordered.values[0]["goal"] == "spiral"
    for body, message in (
        (b"", "not a picture"),
        (b"\x89PNG\r\n\x1a\n broken", "picture"),
        (b"<svg/>", "not a picture"),
    ):
        refused = studio.request("POST", "/alike?name=../x.png", body)
        assert refused.status == 400 and message in refused.error and str(tmp_path) not in refused.error
    assert studio.request("POST", "/alike", b"", Content_Length=str(17 << 20)).status == 413
    assert studio.request("POST", "/alike", b"", Cookie="").status == 403
    # Nothing of what was only compared with is kept.
    assert not (tmp_path / "out").exists()
