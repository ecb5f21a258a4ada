"""The Blender add-on in a Blender with a window: panels, thumbnails, Undo, windows that are closed, runs that end.

Blender is shown by Xvfb, and a stand-in for tnst-mi runs until the tests end it. `helpers/window_walks.py` has the steps.
"""

from __future__ import annotations

import json
import shutil
import sys
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import build_blender_addon
import numpy as np
import psutil
import pytest
from jobs import frames
from PIL import Image
from windowed_blender import marked, run, screen

from tnst_mi.io import save_frames

HELPERS = Path(__file__).parents[2] / "helpers"

pytestmark = [
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Xvfb and /proc are of Linux"),
    pytest.mark.skipif(shutil.which("blender") is None, reason="the program blender is not installed"),
    pytest.mark.skipif(shutil.which("Xvfb") is None, reason="the program Xvfb is not installed"),
]

Walk = Callable[[str], dict[str, Any]]


@pytest.fixture(scope="module")
def user(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A user's folder, with the add-on and the scenes that are opened."""
    folder = tmp_path_factory.mktemp("user")
    build_blender_addon.write_zip(build_blender_addon.contents(None), folder / "addon.zip")
    with zipfile.ZipFile(folder / "addon.zip") as archive:
        archive.extractall(folder / "scripts" / "addons")
    save_frames(folder / "smoke", frames(0.2, 0.4, 0.3), format="vdb")
    for number, file in enumerate(sorted((folder / "smoke").glob("*.vdb")), 7):
        file.rename(file.with_name(f"smoke_{number:04}.vdb"))
    script = str(HELPERS / "window_scenes.py")
    said = run(
        ["--background", "--python", script, "--", str(folder / "smoke"), str(folder)],
        folder,
        str(folder),
    )
    assert (folder / "scene.blend").is_file() and "Traceback" not in said, said
    return folder


@pytest.fixture
def walk(user: Path, tmp_path: Path) -> Iterator[Walk]:
    """Goes through a walk in a new Blender, and returns what that tells; no process is left, however it ends."""
    program = tmp_path / "tnst-mi"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} {HELPERS / "slow_stylization.py"} {tmp_path} "$@"\n')
    program.chmod(0o755)

    def through(name: str) -> dict[str, Any]:
        given = json.dumps({"walk": name, "out": str(tmp_path)})
        script = str(HELPERS / "inside_window.py")
        arguments = ["--enable-event-simulate", str(user / "scene.blend")]
        with screen() as display:
            said = run(
                [*arguments, "--python", script, "--", given],
                user,
                str(tmp_path),
                display,
                TNST_MI_PROGRAM=str(program),
            )
        told = tmp_path / "told.json"
        assert told.is_file(), said
        seen = json.loads(told.read_text("utf-8"))
        assert "failed" not in seen, f"{seen['failed']}\n{said}"
        assert "Traceback" not in said and "rror:" not in said, said
        return seen

    try:
        yield through
    finally:
        for process in marked(str(tmp_path)):
            process.kill()


def test_x(walk):
    print(walk("panels"))


def test_y(walk):
    print(walk("runs"))


def test_z(walk):
    print(walk("stops"))
