"""The Blender add-on in Blender, and in a Python that has bpy: its zip is installed and used as artists do.

Python with bpy: this one, or the one that $TNST_MI_BPY_PYTHON names.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import build_blender_addon
import numpy as np
import pytest
from jobs import frames
from PIL import Image

from tnst_mi.io import save_frames
from tnst_mi.machine.blender import run_in_blender

ROOT = Path(__file__).parents[3]
SCRIPT = ROOT / "tests" / "helpers" / "inside_blender.py"
BPY = os.environ.get("TNST_MI_BPY_PYTHON") or (sys.executable if importlib.util.find_spec("bpy") else None)

needs_blender = pytest.mark.skipif(shutil.which("blender") is None, reason="the program blender is not installed")
needs_bpy = pytest.mark.skipif(BPY is None, reason="no Python with bpy (TNST_MI_BPY_PYTHON names one)")
HOSTS = [pytest.param("blender", marks=needs_blender), pytest.param("bpy", marks=needs_bpy)]

Inside = Callable[..., dict[str, Any]]


@pytest.fixture
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Inside:
    """Runs a scenario of helpers/inside_blender.py in a new Blender with a user folder of its own."""
    for name in ("RESOURCES", "CONFIG", "SCRIPTS", "DATAFILES", "EXTENSIONS"):
        folder = tmp_path / "user" / name.lower()
        folder.mkdir(parents=True)
        monkeypatch.setenv(f"BLENDER_USER_{name}", str(folder))
    monkeypatch.delenv("TNST_MI_PROGRAM", raising=False)
    # Blender writes the tile of its noise into the folder that it is started in.
    monkeypatch.chdir(tmp_path)
    zip_file = tmp_path / "addon.zip"
    build_blender_addon.write_zip(build_blender_addon.contents(None), zip_file)

    def run(host: str, scenario: str, **arguments: Any) -> dict[str, Any]:
        given = json.dumps({"scenario": scenario, "zip": str(zip_file), "out": str(tmp_path), **arguments})
        said: list[str] = []
        if host == "blender":
            run_in_blender(SCRIPT, [given], said.append)
        else:
            command = [str(BPY), str(SCRIPT), "--", given]
            environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
            ran = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=280, check=False)
            said += (ran.stdout + ran.stderr).splitlines()
        told = tmp_path / "told.json"
        assert told.is_file(), "\n".join(said)
        assert not [line for line in said if "does not support blend relative" in line]
        return json.loads(told.read_text("utf-8"))

    return run


@pytest.fixture
def program(tmp_path: Path) -> str:
    """`tnst-mi` of this checkout."""
    script = tmp_path / "program" / "tnst-mi"
    script.parent.mkdir()
    script.write_text(f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} -m tnst_mi "$@"\n')
    script.chmod(0o755)
    return str(script)


@pytest.fixture
def folder(tmp_path: Path) -> str:
    """A folder with smoke_0007.vdb to smoke_0009.vdb."""
    save_frames(tmp_path / "smoke", frames(0.2, 0.4, 0.3), format="vdb")
    for number, file in enumerate(sorted((tmp_path / "smoke").glob("*.vdb")), 7):
        file.rename(file.with_name(f"smoke_{number:04}.vdb"))
    return str(tmp_path / "smoke")


def corners(told: list[list[float]]) -> np.ndarray:
    return np.array(told, np.float64)


@pytest.mark.parametrize("host", HOSTS)
def test_the_panel_is_drawn_and_what_is_bad_is_refused(inside: Inside, host: str, folder: str, tmp_path: Path) -> None:
    told = inside(host, "refusals", folder=folder)
    assert told["package"] == ("tnst_mi_blender" if host == "blender" else "bl_ext.user_default.tnst_mi_blender")
    assert told["motifs"] == [[64, 64, True]] * 64
    expected = {
        "environment": "no such program, expected tnst-mi or the folder of its environment",
        "no look": "choose what the smoke is to look like: press Choose a Look",
        "no camera": "the scene has no camera: add one, or switch Camera off",
        "no picture": "choose a picture",
        "region": "somewhere: choose Sphere or Cube as what the empty is displayed as",
        "frames": "there is no smoke in the frames 30 to 40, but in 21 to 23: choose others",
        "uneven": "smoke that is scaled unevenly",
        "mirrored": "the camera cannot see smoke that is mirrored",
        "flat": "Smoke: is flat, its scale 0 × 0.1 × 0.1: expected none of 0",
        "unseen": "sphere: a region has to be in the scene, neither disabled in viewports",
        "repeated": "markers: shots of a sequence that is played again are the same: set its Mode to Clip",
        "advanced": "Advanced, lam = 1.5: expected ",
        "unknown": "Advanced, lambda: no such key in this version; remove it from the list",
        "unwritable": "tnst-mi: cannot be written (Not a directory); choose another folder",
        "no smoke": "there is no smoke in the shots of markers, frames 24 to 40, but in 21 to 23: move the markers",
        "markers": "the timeline has no markers",
        "resume": "nothing was started here; press Stylize",
        "unsaved": "Results, //results: is beside the scene's file, and the scene has not been saved: save it",
        "failed": "tnst-mi: Frame Range = '4': none; lower Advanced, iterations = 2 or Advanced, lam",
    }
    for what, words in expected.items():
        assert told[what].startswith("Error: ") and words in told[what], (what, told[what])
        assert "\n" not in told[what] and "Traceback" not in told[what]
    foreseen = told["foreseen"]
    assert foreseen.pop("came back") == [21, 0.5] and foreseen.pop("left") == []
    assert "Old 100 to New 200: make both the same" in foreseen.pop("stretched")
    assert foreseen.pop("without camera") == [], "no frame is gone through for what does not count"
    moves = {name for name, may in foreseen.pop("may move").items() if may}
    assert moves == {
        "child of keyed",
        "child of a vertex",
        "driven",
        "follows a path",
        "tracks keyed",
        "limited in space of keyed",
        "tracks in space of keyed",
        "alone, with a script",
        "alone, in a scene with keyframes",
    }
    gone_through = {name: shot["frames"] for name, shot in foreseen.items()}
    # A still camera is taken as it is in the current frame.
    assert gone_through == {
        "still": [21],
        "held": [21],
        "carried": [21, 22, 23],
        "driven": [21, 22, 23],
        "last frame": [23],
        "hidden camera": [21, 22, 23],
        "only of a marker": [21, 22, 23],
        "moving smoke": [21, 22, 23],
        "hidden smoke": [21, 22, 23],
        "excluded smoke": [21, 22, 23],
        "turned away": [21],
    }
    across = {name: shot["across"] for name, shot in foreseen.items()}
    assert {name for name, shot in foreseen.items() if shot["differ"]} == {
        name for name, frames in gone_through.items() if len(frames) > 1
    }
    assert across["last frame"] == across["carried"][-1:] and across["carried"][0] != across["carried"][-1]
    assert across["hidden camera"] == across["only of a marker"] == across["carried"]
    assert across["hidden smoke"] == across["excluded smoke"] == across["moving smoke"]
    (note,) = foreseen["turned away"]["notes"]
    assert note.startswith("the camera does not see the smoke of Smoke in any frame") and "switch Camera off" in note
    assert not any(shot["notes"] for name, shot in foreseen.items() if name != "turned away")
    assert {"motif", "picture", "channel", "region", "tnst_mi.stylize", "tnst_mi.resume", "tnst_mi.install"} <= set(
        told["drawn"]
    )
    # Another Blender may be writing its log into the folder that both install into.
    private, log = map(Path, told["installation"])
    assert log.name == "tnst_mi_install.log" and not log.is_relative_to(private)
    assert not told["left"]
    failed, log = told["failed"].removeprefix("Error: "), f"Log: {tmp_path / 'results' / 'draft.log'}"
    panels = told["panels"]
    assert [failed, log] == [text for text in panels["volume"] if text in (failed, log)]
    assert panels["result"] == ["Stylizes Smoke", *panels["volume"]]
    assert panels["camera"] == panels["nothing"] == []
    assert panels["nothing, running"] == ["Stylizing other", "starting", "tnst_mi.cancel"]
    assert {*panels["nothing, running"], "quality"} <= set(panels["volume, running"])
    assert "tnst_mi.stylize" in panels["volume"] and "tnst_mi.stylize" not in panels["volume, running"]
    assert "Stylizes Smoke" not in panels["lost original"] and "quality" in panels["lost original"]
    copies, folder = told["copies"], str(tmp_path / "results")

    def has_those_of(whose: str, asking: str) -> str:
        return f"{folder}: has the results of {whose}; choose another folder in Results for {asking}, and press Stylize"

    assert copies["named"] == ["", has_those_of("Smoke", "Smoke.001")] and copies["said"] == [True, False]
    assert copies["stylized"] == copies["resumed"] == f"Error: {copies['named'][1]}"
    assert copies["renamed"] == ["", has_those_of("Fog", "Smoke")]
    assert copies["each its own"] == [*copies["renamed"], has_those_of("Smoke", "Fog"), ""]
    assert copies["full copy"] == [True, "", has_those_of("Fog", "Fog.001"), True]
    assert copies["of a file"] == [has_those_of(f"Smoke in {folder}/asset.blend", "Fog"), "", ""]


@pytest.mark.parametrize("host", HOSTS)
def test_a_volume_is_stylized_in_its_place(
    inside: Inside, host: str, program: str, folder: str, tmp_path: Path
) -> None:
    (frame,) = frames(0.2)
    # Bounds are those of blocks of 8 cells.
    growing = [np.zeros((24, 24, 24), np.float32) for _ in range(3)]
    growing[0][:2, :2, :2], growing[1][:20, :20, :20] = 1.0, 1.0
    named = [replace(frame, density=density, name=f"grown_{number}") for number, density in enumerate(growing)]
    save_frames(tmp_path / "extents", named, format="vdb")
    told = inside(host, "volume", program=program, folder=folder)
    assert told["first"] == told["second"] == ["FINISHED"]
    result = told["objects"]["Smoke_stylized"]
    assert result["file"] == str(tmp_path / "results" / "final" / "density" / "smoke_0007.vdb")
    assert (result["frames"], result["materials"]) == ([21, 6, 3], ["of the object"])
    assert told["modifiers"] == [["VOLUME_DISPLACE", 0.0]]
    assert told["objects"]["Smoke"]["hidden"] == [True, True] and result["hidden"] == [False, False]
    half_voxel = 0.5 * 0.1
    original = corners(told["original"])
    assert np.ptp(original, axis=0).min() > 4 * half_voxel
    np.testing.assert_allclose(corners(told["in place"]), original, rtol=0, atol=half_voxel)
    seen = np.asarray(Image.open(tmp_path / "seen.png").convert("L"), float)
    assert seen.std() > 2, "smoke is in the picture"
    # Again, with a region: no second object, which is beside the original now.
    assert set(told["again"]) == {"Smoke", "Smoke_stylized"} and told["again"]["Smoke"]["hidden"] == [False, False]
    moved = corners(told["beside"]) - original
    np.testing.assert_allclose(moved, np.broadcast_to([moved[0, 0], 0, 0], moved.shape), rtol=0, atol=half_voxel)
    assert moved[0, 0] > np.ptp(original[:, 0])
    np.testing.assert_allclose(corners(told["beside from afar"]), corners(told["beside"]), rtol=0, atol=1e-4)
    for mode, (of_original, of_result) in told["played"].items():
        assert of_result == of_original, mode
    first, second, third = (f"smoke_{number:04}.vdb" for number in (7, 8, 9))
    assert told["played"]["CLIP"][1] == [""] * 3 + [first, second, third] + [""] * 6
    assert told["played"]["PING_PONG"][1][3:10] == [first, second, third, second, first, second, third]
    thin, empty, together = told["widths"]
    assert together > thin > 0.0, "Blender 3.4 keeps the bounds of an object's first file"
    assert empty == 0.0
    assert told["artist"]["all"] == [[], list(range(18, 30))] and told["artist"]["no drivers"]
    assert told["artist"]["later"] == [[], [22, 23]] and told["artist"]["simple"] == [True, True]
    assert told["artist"]["between"], "the result shows its last file until the next frame"
    shown = {
        mode: [frame for frame, name in zip(range(18, 30), files[0], strict=True) if name not in ("", first)]
        for mode, files in told["played"].items()
    }
    for mode in ("EXTEND", "REPEAT", "PING_PONG"):
        assert told["artist"][mode] == [[], shown[mode]], mode
    assert told["artist"]["one keyed"] == [1, 0, False], "no driver is left where keyframes hide it"
    assert told["artist"]["beside"] == [[], [], 0]
    assert told["artist"]["lost"] == {
        "of another part": [False, [22, 23]],
        "of the shown part": [True, []],
        "with a duplicate": True,
        "unlinked": [True, ["Scene", "elsewhere"]],
    }
    assert told["artist"]["by hand"] == [[True, True], [True, 1], [True, 0]]
    (note,), hidden = told["artist"]["keyed"]
    assert note.startswith("Smoke: when it is hidden is animated, and was left so") and hidden == [28, 29]
    unsaved, shown_in_all = told["of a library"]["linked"].pop("notes")
    assert unsaved.startswith("Smoke belongs to library.blend") and "Object > Library Override > Make" in unsaved
    assert "seen in all of them: stylize all frames, or make it local" in shown_in_all
    assert told["of a library"]["linked"] == {
        "shown": [True, True, True],
        "hidden": [],
        "run": "of the linked",
    }
    (note,) = told["of a library"]["keyed"].pop("notes")
    assert note.startswith("Keyed belongs to another file") and "Make Local" in note
    assert told["of a library"]["keyed"] == {
        "shown": [True, True, True],
        "hidden": [],
        "run": "of the keyed",
    }
    assert told["of a library"]["kept hidden"] == {"Smoke": [22, 23], "Keyed": []}
    assert told["of a library"]["kept"] == ["preview", ["spirals", "net"]]
    # The asset's own run is none of theirs.
    assert not told["of a library"]["knows the asset's"]
    assert told["of a library"]["runs"] == {
        "own": "of the asset",
        "Keyed": "of the keyed",
        "Smoke": "of the override",
    }
    assert told["of a library"]["override"] == {
        "notes": [],
        "shown": [True, True, True],
        "hidden": [22, 23],
        "run": "of the override",
    }
    recipe = (tmp_path / "results" / "final_inputs" / "recipe.toml").read_text("utf-8")
    assert 'frames = "7:9"' in recipe and "mask.vdb" in recipe


@pytest.mark.parametrize("host", HOSTS)
def test_each_marker_is_a_shot(inside: Inside, host: str, program: str, folder: str, tmp_path: Path) -> None:
    told = inside(host, "markers", program=program, folder=folder)
    assert (told["ended"], told["current"]) == (["FINISHED"], 5)
    skipped, unseen = told["notes"]
    assert skipped == "late: skipped, there is no smoke in its frames 24 to 27"
    assert unseen.startswith("the camera of close 2 does not see the smoke of Smoke in any frame")
    assert told["said"].splitlines() == [skipped, unseen]
    assert told["hidden"] == list(range(18, 30)), "all frames of the smoke are in the other shots"
    shots = {name: item["frames"] for name, item in told["objects"].items() if name != "Smoke"}
    assert shots == {"Smoke_stylized_close": [21, 6, 2], "Smoke_stylized_close 2": [23, 8, 1]}
    inputs = tmp_path / "results" / "markers_final_inputs"
    cameras = [json.loads(file.read_text()) for file in sorted(inputs.rglob("cameras.json"))]
    whole, shots = {"Smoke_stylized"}, {"Smoke_stylized_close", "Smoke_stylized_close 2"}
    for then, seen in (("one", whole), ("shots", shots)):
        ended, hidden = told[f"then {then}"]
        assert ended == ["FINISHED"] and set(hidden) == {"Smoke", *whole, *shots}
        assert {name for name in hidden if hidden[name] == [False, False]} == seen
    assert len(cameras) == 2 and cameras[0]["matrix"] != cameras[1]["matrix"]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks for processes in /proc")
@pytest.mark.parametrize("host", HOSTS)
def test_cancel_leaves_no_process_and_can_be_resumed(
    inside: Inside, host: str, program: str, folder: str, tmp_path: Path
) -> None:
    told = inside(host, "cancelled", program=program, folder=folder)
    assert [told[when] for when in ("before", "during", "twice")] == [False, True, False]
    assert told["pressed"] == ["FINISHED"]
    assert (told["cancelled"], told["processes"]) == (["CANCELLED"], [])
    assert set(told["objects"]) == {"Smoke"}
    assert re.fullmatch(r"Stopped at octave 1/1, frame [789], \d+%: Resume goes on", told["stopped"])
    assert told["resumed"] == ["FINISHED"] and set(told["then"]) == {"Fog", "Fog_stylized"} and told["after"] == ""
    assert told["whose"] == "Fog"
    assert told["known"] == [True, str(tmp_path / "project" / "scene.blend")]
    assert told["then"]["Fog_stylized"]["file"] == "//../project/results/final/density/smoke_0007.vdb"


@needs_blender
@pytest.mark.parametrize(
    ("adaptive", "noise", "form", "sides"),
    [
        (False, False, "OPENVDB", [4.0, 2.0, 3.0]),
        (True, False, "OPENVDB", [4.0, 2.0, 3.0]),
        (False, False, "UNI", [4.0, 2.0, 3.0]),
        (True, True, "OPENVDB", [4.0, 2.0, 3.0]),
        # Of 24 × 8.24 × 23.2 cells, which Blender makes whole ones.
        (False, False, "OPENVDB", [3.0, 1.03, 2.9]),
    ],
    ids=["whole", "adaptive", "uni", "noise", "stretched"],
)
def test_the_smoke_of_a_domain_is_seen_where_it_was(
    inside: Inside, program: str, tmp_path: Path, adaptive: bool, noise: bool, form: str, sides: list[float]
) -> None:
    told = inside("blender", "domain", program=program, adaptive=adaptive, noise=noise, format=form, sides=sides)
    assert told["ended"] == ["FINISHED"] and told["hidden"]
    result = told["objects"]["Domain_stylized"]
    assert (result["frames"], result["materials"]) == ([1, 0, 3], ["thick smoke_noise" if noise else "thick smoke"])
    if not adaptive and form == "OPENVDB":
        lowest = np.abs(corners(told["bounds"])[0] - corners(told["drawn"])[0])
        assert lowest.max() < 0.5 * told["cell"]
    before, after = (
        np.asarray(Image.open(tmp_path / name).convert("L"), float) for name in ("domain.png", "stylized.png")
    )
    assert before.std() > 2
    assert np.corrcoef(before.ravel(), after.ravel())[0, 1] > 0.99
    # Half a voxel is 6 pixels.
    assert np.corrcoef(before[:, 3:].ravel(), after[:, :-3].ravel())[0, 1] < 0.99
    if noise:
        told = told["without noise"]
        assert told["ended"] == ["FINISHED"]
        assert (told["shown"]["frames"], told["shown"]["materials"]) == ([1, 0, 3], ["thick smoke"])
        assert told["in range"] == [["FINISHED"], [3, 2, 1]]
        assert [told["hidden in 2"], told["hidden in 3"]] == [False, True]
        assert told["without smoke"] == ["FINISHED"]
        for frame in (2, 3):
            before, after = (
                np.asarray(Image.open(tmp_path / f"{name}_{frame}.png").convert("L"), float)
                for name in ("original", "in_range")
            )
            assert before.std() > 2 and np.corrcoef(before.ravel(), after.ravel())[0, 1] > 0.99
