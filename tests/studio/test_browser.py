"""The page in a headless browser, from its URL to a finished run.

TNST_MI_SHOTS may name a folder for pictures of it.
"""

from __future__ import annotations

import io
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tnst_mi.frame import Frame
from tnst_mi.io import save_frames

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
expect = playwright.expect

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
if BROWSER is None:
    pytest.skip("there is no Chromium (apt-get install chromium)", allow_module_level=True)

#: Nothing is asked of the internet, and nothing of a GPU.
FLAGS = (
    *("--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync"),
)

SIZES = ((1280, 720), (1920, 1080))

#: Milliseconds that anything on the page may take, such as a run on a busy machine.
PATIENCE = 60_000


@dataclass
class Page:
    """A page in the browser, and what went wrong on it."""

    page: Any
    troubles: list[str] = field(default_factory=list)
    hosts: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.page.set_default_timeout(PATIENCE)
        self.page.on("pageerror", lambda error: self.troubles.append(str(error)))
        self.page.on("console", lambda message: message.type == "error" and self.troubles.append(message.text))
        self.page.on("request", lambda request: self.hosts.add(request.url.split("/")[2].split(":")[0]))

    def view(self) -> np.ndarray:
        """The picture of the smoke, in [0, 1], without its edges, where there is text."""
        picture = Image.open(io.BytesIO(self.page.locator("#view").screenshot())).convert("L")
        return np.asarray(picture)[5:-40] / 255

    def settled(self) -> np.ndarray:
        """The picture once it is the one that is wanted."""
        # A page that has been resized hears of it with its next frame.
        self.page.wait_for_timeout(150)
        self.page.locator("#view[data-settled=yes]").wait_for()
        return self.view()

    def photographed(self, name: str) -> None:
        """Keep a picture of the page in the folder that TNST_MI_SHOTS names, in every size."""
        if folder := os.environ.get("TNST_MI_SHOTS"):
            for width, height in SIZES:
                self.page.set_viewport_size({"width": width, "height": height})
                self.settled()
                self.page.screenshot(path=f"{folder}/{name}_{width}x{height}.png")
            self.page.set_viewport_size({"width": SIZES[0][0], "height": SIZES[0][1]})
            self.settled()

    def dragged(self, selector: str, right: int, down: int) -> None:
        """Drag from the middle of the left half of something."""
        box = self.page.locator(selector).bounding_box()
        x, y = box["x"] + box["width"] / 4, box["y"] + box["height"] / 2
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        for step in range(1, 11):
            self.page.mouse.move(x + right * step / 10, y + down * step / 10)
            self.page.wait_for_timeout(20)
        self.page.mouse.up()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=BROWSER, args=list(FLAGS))
        yield started
        started.close()


@contextmanager
def studio_url(root: Path, out: Path, weights: Path) -> Iterator[str]:
    """The URL that the command prints; it ends as Ctrl-C would end it."""
    environment = os.environ | {"TNST_MI_WEIGHTS": str(weights)}
    command = [sys.executable, "-m", "tnst_mi", "studio", str(root), "--out", str(out)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        try:
            word, url = process.stdout.readline().split()
            assert word == "studio" and url.startswith("http://127.0.0.1:")
            yield url
        finally:
            process.send_signal(signal.SIGINT)
            assert process.wait(60) == 0


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A frame of smoke on the left side, that is no cube."""
    density = np.zeros((14, 20, 16), np.float32)
    density[3:11, 4:16, 2:8] = np.random.default_rng(0).random((8, 12, 6), np.float32)
    save_frames(tmp_path / "root", [Frame(density, name="smoke")])
    return tmp_path / "root"


@pytest.fixture
def opened(browser: Any) -> Iterator[Callable[[str], Page]]:
    """Opens pages at a URL, on which nothing may go wrong and which ask nobody but the studio."""
    contexts, pages = [], []

    def open_(url: str) -> Page:
        contexts.append(browser.new_context(viewport={"width": SIZES[0][0], "height": SIZES[0][1]}))
        pages.append(Page(contexts[-1].new_page()))
        pages[-1].page.goto(url)
        return pages[-1]

    yield open_
    for context in contexts:
        context.close()
    assert [page.troubles for page in pages] == [[] for _ in pages]
    assert {host for page in pages for host in page.hosts} <= {"127.0.0.1"}


def test_look_choose_try_and_compare(root: Path, tmp_path: Path, weights: Path, opened: Callable[[str], Page]) -> None:
    with studio_url(root / "smoke.npz", tmp_path / "out", weights) as url:
        shown = opened(url)
        page = shown.page
        # The token has left the address bar, and a tab without it sees nothing.
        assert page.url.endswith("/") and "token" not in page.url
        page.locator("#motifs img").first.wait_for()
        front = shown.settled()
        width = front.shape[1] // 2
        assert front[:, :width].sum() > 3 * front[:, width + 5 :].sum() > 0
        shown.photographed("1_opened")
        # Half a turn: what was on the left is on the right.
        shown.dragged("#view", 450, 0)
        back = shown.settled()
        assert back[:, width + 5 :].sum() > 3 * back[:, :width].sum()
        page.locator("#home").click()
        assert np.abs(shown.settled() - front).max() < 0.02
        page.locator("#cut").select_option("z")
        assert np.abs(shown.settled() - front).max() > 0.2
        page.locator("#cut").select_option("none")
        # Everything is in reach at both sizes, and nothing is wider than the page.
        for wide, high in SIZES:
            page.set_viewport_size({"width": wide, "height": high})
            for selector in ("#try", "#find", "#upload", "#home", "#knobs"):
                box = page.locator(selector).bounding_box()
                assert box["x"] >= 0 and box["x"] + box["width"] <= wide and box["y"] + box["height"] <= high, selector
            assert page.evaluate("document.documentElement.scrollWidth") == wide
        page.set_viewport_size({"width": SIZES[0][0], "height": SIZES[0][1]})
        # A motif, and a slider, which a second tab hears of.
        assert page.locator("#try").is_disabled()
        page.locator("#find").fill("sp")
        page.locator("#motifs [data-key=style][data-goal=spirals]").click()
        page.locator("#goals .goal", has_text="style spirals").wait_for()
        for key, value in (("iterations", 6), ("octaves", 2), ("views", 1)):
            page.locator(f"#knob-{key}").fill(str(value))
            page.locator(".knob.set", has_text=key).wait_for()
        other = opened(url)
        other.page.locator("#goals .goal", has_text="style spirals").wait_for()
        assert other.page.locator("#knob-iterations").input_value() == "6"
        other.page.locator("#knob-iterations").fill("5")
        page.locator(".knob output", has_text="5").wait_for()
        # A picture from outside.
        Image.fromarray(np.random.default_rng(1).integers(0, 255, (40, 60), np.uint8)).save(tmp_path / "my fire.jpg")
        page.locator("#find").fill("")
        page.locator("#picture").set_input_files(tmp_path / "my fire.jpg")
        page.locator("#motifs [data-key=style]", has_text="my_fire").click()
        page.locator("#goals .goal", has_text="style my_fire").locator("button").click()
        # A try, whose loss falls while one looks on.
        page.locator("#try").click()
        page.locator(".job.running").wait_for()
        page.locator(".job.done").wait_for()
        assert "loss" in page.locator(".job p").first.inner_text()
        assert other.page.locator(".job.done").count() == 1
        shown.photographed("2_tried")
        page.locator(".job button[data-action=open]").click()
        page.locator("#mode-wipe.on").wait_for()
        wiped = shown.settled()
        assert np.abs(wiped[:, : width - 10] - front[:, : width - 10]).max() < 0.05
        for mode in ("after", "difference", "movement"):
            page.locator(f"#mode-{mode}").click()
            assert np.abs(shown.settled() - wiped).max() > 0.1
            shown.photographed(f"3_{mode}")
        assert page.locator("#error").is_hidden()
        # Before the studio ends: pages would complain.
        for tab in (shown, other):
            tab.page.context.close()


def test_a_render_outlives_the_page_and_the_studio(
    root: Path, tmp_path: Path, weights: Path, opened: Callable[[str], Page]
) -> None:
    with studio_url(root / "smoke.npz", tmp_path / "out", weights) as url:
        page = opened(url).page
        page.locator("#motifs [data-key=style][data-goal=net]").click()
        for key, value in (("iterations", 40), ("octaves", 2), ("views", 1)):
            page.locator(f"#knob-{key}").fill(str(value))
            page.locator(".knob.set", has_text=key).wait_for()
        page.locator("#render").click()
        page.locator(".job.running p", has_text="loss").wait_for()
        page.context.close()
    with studio_url(root, tmp_path / "out", weights) as url:
        shown = opened(url)
        shown.page.locator(".job.done").wait_for()
        shown.photographed("4_outlived")
        shown.page.locator(".job button[data-action=open]").click()
        shown.page.locator("#mode-wipe.on").wait_for()
        shown.page.locator("#look").select_option("thick")
        shown.page.locator("#lit").check()
        shown.page.locator("#status", has_text="pass 4").wait_for()
        assert shown.view().std() > 0.05
        shown.page.locator("#lit").uncheck()
        shown.page.locator("#status", has_text="pass").wait_for(state="hidden")
        shown.photographed("5_reopened")
        shown.page.context.close()


def test_tries_are_gone_on_from_and_deleted(
    root: Path, tmp_path: Path, weights: Path, opened: Callable[[str], Page]
) -> None:
    with studio_url(root / "smoke.npz", tmp_path / "out", weights) as url:
        shown, other = opened(url), opened(url)
        page = shown.page
        page.locator("#motifs [data-key=style][data-goal=spirals]").click()
        for key, value in (("iterations", 6), ("octaves", 3), ("views", 1)):
            page.locator(f"#knob-{key}").fill(str(value))
            page.locator(".knob.set", has_text=key).wait_for()
        page.locator("#try").click()
        first, second = (page.locator(f".job[data-id='tries/000{number}']") for number in (1, 2))
        page.locator(".job.done").wait_for()
        # From the end of the first octave, with the settings that may differ.
        first.locator("[data-action=branch]").click()
        assert first.locator(".states button").count() == 2
        first.locator(".states img").last.wait_for()
        shown.photographed("6_states")
        first.locator(".states [data-octave='0']").click()
        for tab in (page, other.page):
            tab.locator("#start", has_text="goes on from try 1, end of octave 1").wait_for()
        assert page.locator("#knob-motif_size").is_disabled() and page.locator("#knob-eta").is_enabled()
        # An address that means no cluster is told at once; of one that does, all tabs hear.
        page.locator("#cluster").fill("local:many")
        page.locator("#cluster").blur()
        page.locator("#error", has_text="expected local:N").wait_for()
        shown.troubles.clear()  # the browser's own words of the refusal
        page.locator("#cluster").fill("local:2")
        page.locator("#cluster").blur()
        expect(other.page.locator("#cluster")).to_have_value("local:2", timeout=PATIENCE)
        assert page.locator("#error").is_hidden()
        shown.photographed("7_going_on")
        for key, value in (("iterations", 60), ("views", 8)):
            page.locator(f"#knob-{key}").fill(str(value))
            page.locator(".knob.set", has_text=key).wait_for()
        page.locator("#try").click()
        second.locator("p", has_text="from try 1, octave 2").wait_for()
        # All but the chosen, after a question; what runs is stopped first.
        first.locator("input[type=checkbox]").check()
        questions = []
        page.once("dialog", lambda dialog: questions.append(dialog.message) or dialog.dismiss())
        page.locator("#clear").click()
        page.once("dialog", lambda dialog: questions.append(dialog.message) or dialog.accept())
        assert second.count() == 1
        page.locator("#clear").click()
        second.wait_for(state="detached")
        question = "Delete the other try, all but the chosen? It is stopped first. This cannot be undone."
        assert questions == [question] * 2
        assert [other.page.locator(".job").count(), first.count()] == [1, 1]
        assert not (tmp_path / "out" / "tries" / "0002").exists()
        # Nothing goes on from what is gone.
        page.once("dialog", lambda dialog: dialog.accept())
        first.locator("[data-action=delete]").click()
        page.locator("#start").wait_for(state="hidden")
        shown.photographed("8_deleted")
        for tab in (shown, other):
            tab.page.context.close()
