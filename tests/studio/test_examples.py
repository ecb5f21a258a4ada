"""Pictures of tags and channels: made once, by a process of its own, and only of what there is."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from studios import Studio, running

from tnst_mi.atlas.excitation import Ascent, excite
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.recipe.recipe import Recipe

CHANNEL = "inception_3a/pool_proj:1"


@pytest.fixture
def out() -> str:
    """The folder of the studio."""
    return "out"


@pytest.fixture
def studio(tmp_path: Path, weights: Path, out: str) -> Iterator[Studio]:
    (tmp_path / "root").mkdir()
    with running(tmp_path / "root", tmp_path / out) as started:
        started.session.settings.base = Recipe(weights=str(weights))
        yield started


def thumbnails(studio: Studio) -> dict[str, str]:
    motifs: list[dict[str, Any]] = [*studio.get("/motifs", find="").values, *studio.get("/motifs", find=CHANNEL).values]
    return {motif["goal"]: motif["thumbnail"] for motif in motifs if motif["thumbnail"] and motif["key"] != "style"}


def made(studio: Studio, *goals: tuple[str, str]) -> None:
    assert studio.post("/examples", goals=goals).status == 200
    end = time.monotonic() + 120
    while (told := studio.get("/examples").values)["busy"]:
        assert time.monotonic() < end
        time.sleep(0.1)
    assert told["error"] is None, told


@pytest.mark.parametrize("out", ["out", "root/tnst_mi-studio"])
def test_pictures_are_made_once_and_are_those_of_an_atlas(studio: Studio, network: GoogLeNet, tmp_path: Path) -> None:
    assert thumbnails(studio) == {}
    tag = next(motif["goal"] for motif in studio.get("/motifs", find="").values if motif["key"] == "tag")
    made(studio, ("tag", tag), ("semantic", CHANNEL))
    urls = thumbnails(studio)
    assert set(urls) == {tag, CHANNEL}
    for url in urls.values():
        assert studio.request("GET", f"/{url}").body.startswith(b"\x89PNG")
    files = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*_picture.png")}
    assert len(files) == 2
    expected = excite(network, "inception_3a/pool_proj", 1, Ascent())
    (of_channel,) = (file for file in files if "3a" in str(file))
    np.testing.assert_allclose(np.asarray(Image.open(of_channel)) / 255, expected, atol=0.51 / 255)
    made(studio, ("tag", tag), ("semantic", CHANNEL))
    assert files == {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*_picture.png")}


def test_what_is_no_motif_is_refused(studio: Studio) -> None:
    for goals in ([["tag", "no such tag"]], [["semantic", "../x:1"]], [["semantic", f"{CHANNEL}x"]], ["tag"], [[1, 2]]):
        refused = studio.post("/examples", goals=goals)
        assert refused.status == 400 and "expected a tag" in refused.error
    assert "no list" in studio.post("/examples", goals="tag").error
    assert "at most 256" in studio.post("/examples", goals=[["semantic", CHANNEL]] * 257).error
    assert studio.get("/examples").values == {"busy": False, "error": None}
    # A channel that a layer does not have is known when the network is there.
    assert studio.post("/examples", goals=[["semantic", "inception_3a/pool_proj:99999"]]).status == 200
    end = time.monotonic() + 60
    while (told := studio.get("/examples").values)["busy"] and time.monotonic() < end:
        time.sleep(0.1)
    assert "99999" in told["error"]


def test_only_pictures_of_atlases_are_shown(studio: Studio, tmp_path: Path) -> None:
    for path in ("../secret_picture.png", "/etc/passwd", "x/channels/001_picture.png", ""):
        refused = studio.get("/thumbnail", made=path)
        assert refused.status == 400, path
