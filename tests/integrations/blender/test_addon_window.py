"""The Blender add-on in a Blender with a window: panels, thumbnails, Undo, windows that are closed, runs that end.

Blender is shown by Xvfb, and a stand-in for tnst-mi runs until the tests end it. The steps are in
`helpers/window_walks.py`.
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
        arguments = ["--enable-event-simulate", "--window-geometry", "0", "0", "1000", "760", str(user / "scene.blend")]
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
        assert "Traceback" not in said, said
        return seen

    try:
        yield through
    finally:
        for process in marked(str(tmp_path)):
            process.kill()


def test_panels_are_drawn_and_motifs_have_their_thumbnails(walk: Walk, tmp_path: Path) -> None:
    """Whatever is selected, while something runs and while nothing does."""
    told = walk("panels")
    assert told["motifs"] == {"started with a file": 64, "File > Open": 64, "File > New": 64}
    # The thumbnail is larger than the name, which changes too.
    assert told["pixels of another motif"] > 4000
    drawn = told["drawn"]
    assert all(drawn.pop(goal) >= 1 for goal in ("MOTIF", "PICTURE", "CHANNEL"))
    of_volumes, of_domains = ["TNST_MI_PT_sidebar", "TNST_MI_PT_volume"], ["TNST_MI_PT_domain", "TNST_MI_PT_sidebar"]
    expected: dict[str, list[str]] = {"Smoke_stylized": of_volumes}
    for state in ("", ", running"):
        expected |= {f"{name}{state}": of_volumes for name in ("Smoke", "Linked")} | {f"Domain{state}": of_domains}
        # A run can be cancelled whatever is selected.
        of_others = ["TNST_MI_PT_sidebar"] if state else []
        expected |= {f"{name}{state}": of_others for name in ("Cube", "Camera", "Empty", "nothing")}
        expected[f"preferences{state}"] = ["TnstMiPreferences"]
    assert drawn == expected
    for name in ("motif_net", "preferences", "preferences, running"):
        assert np.asarray(Image.open(tmp_path / f"{name}.png").convert("L")).std() > 10


def test_a_run_outlives_its_window_and_its_result_is_a_step_of_undo(walk: Walk, tmp_path: Path) -> None:
    told = walk("runs")
    bars, result_alone, original_alone = told["status"], [True, False], [False, True]
    assert bars["second window, during"] != bars["second window, before"]
    for space in ("Layout", "Modeling"):
        assert bars[f"{space}, during"] != bars[f"{space}, before"] == bars[f"{space}, after"], space
    assert (told["before the end"], told["at the end"]) == (original_alone, result_alone)
    assert "Stylized: Smoke_stylized (frames 7 to 9)\n" in told["reported"]
    assert (told["undone"], told["redone"]) == (original_alone, result_alone)
    assert (told["moved"], told["undone during the run"]) == ([1.0, 0.0], result_alone)
    results = tmp_path / "Smoke_stylized" / "draft"
    assert told["of the deleted one"] == f"Smoke was deleted meanwhile; its results are in {results}"
    assert len(list((results / "density").glob("*.vdb"))) == 3


def test_whatever_stops_a_run_leaves_nothing_of_it(walk: Walk, tmp_path: Path) -> None:
    told = walk("stops")
    for how in ("Cancel", "disabled", "another file"):
        assert told[how]["status while it runs"], how
        assert told[how]["seconds"] < 10, how
        assert (told[how]["timer"], told[how]["status"]) == (False, False), how
    assert told["Cancel"]["shown"] == told["disabled"]["shown"] == [True, False]
    assert not told["operators of the disabled one"]
    assert told["opened"] == ["Camera", "Cube", "Light"]
    assert told["resumed in the first file"] == [False, True]
    new, resumed = ["stylize", told["started"][0][1]], ["stylize", "--resume"]
    assert told["started"] == [new, resumed, new, resumed, new, new, new]
    unknown = ["Not finished, or the scene was not saved since: Resume goes on"]
    assert told["run 5 replaces another"] == [True, unknown]
    shown, (stopped,) = told["run 6 replaces another"]
    assert shown and stopped.startswith("Stopped at octave 1/1")
    # Quitting Blender: what it leaves is told to end, as the processes beside it do by themselves.
    assert told["running when Blender is quit"] == 2
    end = time.monotonic() + 20
    while marked(str(tmp_path)) and time.monotonic() < end:
        time.sleep(0.1)
    assert not marked(str(tmp_path))
