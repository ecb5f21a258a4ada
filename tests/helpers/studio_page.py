"""The page of the studio in a headless browser, where there is one: what uses this is skipped where there is none."""

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
from studios import Studio, running

from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.recipe.recipe import Recipe

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
expect.set_options(timeout=PATIENCE)


@dataclass
class Page:
    """A page in the browser, and what went wrong on it."""

    page: Any
    troubles: list[str] = field(default_factory=list)
    hosts: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.page.set_default_timeout(PATIENCE)
        self.page.on("pageerror", lambda error: self.troubles.append(str(error)))
        self.page.on("console", self._heard)
        self.page.on("request", lambda request: self.hosts.add(request.url.split("/")[2].split(":")[0]))

    def _heard(self, message: Any) -> None:
        if message.type == "error":
            self.troubles.append(f"{message.text} {message.location['url']}")

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


@contextmanager
def studio_url(root: Path, out: Path, weights: Path) -> Iterator[str]:
    """The URL that the command prints; it ends as Ctrl-C would end it."""
    command = [sys.executable, "-m", "tnst_mi", "studio", str(root), "--out", str(out), "--weights", str(weights)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
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


def address(studio: Studio) -> str:
    return f"http://127.0.0.1:{studio.server.server_port}/?token={studio.server.access.token}"


def sequence(folder: Path) -> None:
    values = np.random.default_rng(0).random((10, 16, 12), np.float32)
    save_frames(folder, [Frame(values * scale, name=f"f_{n}", number=n) for n, scale in ((7, 1.0), (8, 0.8), (9, 0.6))])


@pytest.fixture
def smoke(tmp_path: Path, weights: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Studio]:
    """A studio that shows a sequence with a sphere as its region; what is begun fails at once."""
    sequence(tmp_path / "root" / "smoke")
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with running(tmp_path / "root", tmp_path / "out") as studio:
        studio.post("/open", path="smoke")
        studio.session.settings.base = Recipe(weights=str(weights), octaves=1, iterations=2, views=1, gamma=0.2)
        studio.post("/goal", key="style", goal="net")
        studio.post("/mask", action="add", values={"shape": "sphere", "centre": [5, 7, 4], "radius": 3})
        yield studio
