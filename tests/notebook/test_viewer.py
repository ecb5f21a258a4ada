"""`tnst_mi.view`: the pictures of its page, its place in a notebook, and what a browser makes of it."""

from __future__ import annotations

import html
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from jobs import SHAPE, FakeOptimiser, optimiser
from PIL import Image
from shown_html import ShownHtml, pixels

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io.pictures.png import eight_bits
from tnst_mi.notebook.main_views import ShownFrame
from tnst_mi.notebook.viewer import Viewer, viewer_of

__all__ = ["optimiser"]

RECIPE = {"style": ["spirals"], "weights": "patterns", "octaves": 1, "iterations": 1, "views": 1}


def flat(*grey: float) -> tuple[np.ndarray, ...]:
    return tuple(np.full((40, 60), value) for value in grey)


FRAMES = [ShownFrame("one", flat(0.2, 0.8), "first"), ShownFrame("two", flat(0.4, 1.0), "second")]


def frames_of(viewer: Viewer) -> list[dict]:
    """What the page has of the frames, for its script."""
    shown = ShownHtml(viewer.page)
    place = next(i for i, script in enumerate(shown.attributes["script"]) if script.get("id") == "frames")
    assert shown.attributes["script"][place]["type"] == "application/json"
    return json.loads(next(text for text in shown.texts if text.startswith("[{")))


def test_a_result_has_the_pictures_before_and_after(optimiser: FakeOptimiser) -> None:
    random = np.random.default_rng(1)
    frames = [Frame(random.uniform(0, 1, SHAPE), name=f"f_{n}", number=n) for n in range(3)]
    result = tnst_mi.stylize(frames, RECIPE, progress=False)
    viewer = tnst_mi.view(result)
    contents = frames_of(viewer)
    assert [frame["name"] for frame in contents] == ["f_0", "f_1", "f_2"]
    scale = np.float32(result.run["density_scale"])
    for frame, content, record in zip(frames, contents, result.run["frames"], strict=True):
        assert content["told"] == "loss 4 → 3, mass +100.0%"
        for address, density in zip(content["pictures"], (frame.density, 2 * frame.density), strict=True):
            expected = record["exposure"] * tnst_mi.render(scale * density, gamma=record["gamma"])
            np.testing.assert_array_equal(pixels(address), eight_bits(expected))
    # Without scripts, the first frame is seen.
    after, before = ShownHtml(viewer.page).attributes["img"]
    assert [before["src"], after["src"]] == contents[0]["pictures"]


def test_frames_have_one_exposure() -> None:
    density = np.random.default_rng(1).uniform(0, 1, SHAPE)
    contents = frames_of(tnst_mi.view([Frame(density), Frame(0.25 * density)]))
    brighter, darker = (pixels(frame["pictures"][0]) for frame in contents)
    assert [len(frame["pictures"]) for frame in contents] == [1, 1]
    assert brighter.max() == 255 and 50 < darker.max() < 100


def test_it_stands_in_a_frame_of_its_own() -> None:
    viewer = viewer_of(FRAMES, 2)
    shown = ShownHtml(viewer._repr_html_())
    assert shown.tags == ["iframe"]
    (frame,) = shown.attributes["iframe"]
    assert frame["srcdoc"] == viewer.page
    assert frame["sandbox"] == "allow-scripts"
    assert "default-src 'none'" in viewer.page
    assert repr(viewer) == "Viewer(size=(376, 372), title='one to two')"


def test_names_are_text() -> None:
    name = "</script><script>alert(1)</script><!--"
    viewer = viewer_of([ShownFrame(name, flat(0.5), name)], 1)
    shown = ShownHtml(viewer.page)
    assert shown.tags.count("script") == 2
    assert frames_of(viewer)[0]["name"] == name
    assert html.escape(html.escape(name)) in viewer._repr_html_()


def test_of_many_frames_some_are_shown() -> None:
    frames = [Frame(np.full((1, 2, 2), n + 1.0), name=f"f_{n}") for n in range(60)]
    viewer = tnst_mi.view(frames)
    names = [frame["name"] for frame in frames_of(viewer)]
    assert len(names) == 48 and (names[0], names[-1]) == ("f_0", "f_59")
    assert viewer.title == "f_0 to f_59, 48 of 60 frames" and len(viewer.page) < 40_000


@pytest.mark.parametrize(
    ("shown", "message"),
    [
        (np.zeros(SHAPE), "view: a ndarray given, expected a result, a tnst_mi.Frame, or several"),
        ([1, 2], "view: a list given, expected a result, a tnst_mi.Frame, or several"),
        ([], "view: no frame given, expected one or more"),
    ],
)
def test_what_is_no_frame_is_refused(shown: object, message: str) -> None:
    with pytest.raises(InputError, match=f"^{message}$"):
        tnst_mi.view(shown)


def test_a_result_whose_pictures_are_gone_is_refused(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    result = tnst_mi.stylize(Frame(np.ones(SHAPE), name="smoke"), RECIPE, tmp_path, progress=False)
    (tmp_path / "images" / "smoke_before.exr").write_bytes(b"")
    with pytest.raises(InputError, match=r"smoke_before\.exr"):
        tnst_mi.view(result)


@pytest.fixture(scope="module")
def browser() -> str:
    """Chromium, or a skip where there is none."""
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if found is None:
        pytest.skip("there is no Chromium (Debian: apt-get install chromium)")
    return found


def screenshot(browser: str, folder: Path, page: str) -> np.ndarray:
    """The pixels (rows, columns, 3) of a page."""
    (folder / "page.html").write_text(page, "utf-8")
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--window-size=500,420"]
    profile, picture = f"--user-data-dir={folder / 'profile'}", f"--screenshot={folder / 'page.png'}"
    command = [browser, *flags, profile, picture, (folder / "page.html").as_uri()]
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    with Image.open(folder / "page.png") as image:
        return np.asarray(image.convert("RGB"))


def test_a_browser_shows_before_left_of_the_line_and_after_right(browser: str, tmp_path: Path) -> None:
    """In a page whose own styles must not reach it."""
    style = "<style>body { margin: 0 } img, #stage, #line { display: none } * { color: red }</style>"
    seen = screenshot(browser, tmp_path, f"<!DOCTYPE html>{style}{viewer_of(FRAMES, 2)._repr_html_()}")
    # The picture of 60×40 is shown six times as large, 8 pixels from the corner.
    row = seen[100, 8:368]
    assert (row[:178] == 51).all() and (row[182:] == 204).all()
    assert (row[178:182] != row[0]).any()


def test_sliders_and_dragging_move_the_frame_and_the_line(browser: str, tmp_path: Path) -> None:
    script = """<script>
        at("frame").value = 1;
        at("frame").dispatchEvent(new Event("input"));
        at("wipe").value = 90;
        at("wipe").dispatchEvent(new Event("input"));
        at("stage").dispatchEvent(new PointerEvent("pointermove", {clientX: 300, buttons: 0}));
        {drag}
        at("told").style.background = at("told").textContent === "two: second" ? "#0f0" : "#f00";
    </script>"""
    drag = 'at("stage").dispatchEvent(new PointerEvent("pointermove", {clientX: 98, buttons: 1}));'
    for moved, line in (("", 324), (drag, 90)):
        seen = screenshot(
            browser, tmp_path, viewer_of(FRAMES, 2).page.replace("</body>", script.replace("{drag}", moved) + "</body>")
        )
        row = seen[100, 8:368]
        assert (row[: line - 2] == 102).all() and (row[line + 2 :] == 255).all()
        assert (seen == (0, 255, 0)).all(axis=2).any()


def test_a_frame_alone_has_neither_slider(browser: str, tmp_path: Path) -> None:
    seen = screenshot(browser, tmp_path, viewer_of([ShownFrame("one", flat(0.6))], 1).page)
    assert (seen[8:248, 8:368] == 153).all()
    # The orange of sliders and of the line.
    assert not (seen == (255, 170, 51)).all(axis=2).any()
