"""The node, in a stand-in for Houdini: what its buttons write, run and show. Houdini itself takes no part in this."""

from __future__ import annotations

import importlib
import runpy
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import build_houdini_asset
import numpy as np
import pytest
from fake_houdini import FakeGeometry, FakeNode, hou
from houdini_files import houdini_grid, velocity_in_parts, write_houdini
from moving_smoke import moving_smoke

from tnst_mi.io.grids.vdb import read_vdb
from tnst_mi.recipe.recipe import Recipe

__all__ = ["hou"]

FRAMES = (1001, 1002)

#: In place of tnst-mi: takes its flags, shows progress, and leaves the input as results, whole ones as tnst-mi does.
PROGRAM = """\
#!{python}
import json, pathlib, shutil, sys, time
source, out = pathlib.Path(sys.argv[2]), pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
print(" ".join(sys.argv[1:]), flush=True)
print("smoke.1001 octave 1/1:  50% 1/2 [00:01<00:01, iteration 1/2, loss 1]", flush=True)
if (out.parent.parent / "slow").exists() and "--resume" not in sys.argv:
    (out / "density").mkdir(parents=True, exist_ok=True)
    (out / "run.json").write_text(json.dumps({{"input": str(source)}}))
    time.sleep(60)
if (out.parent.parent / "bad").exists():
    sys.exit("tnst-mi: recipe.toml: no goal; give --style")
(out / "density").mkdir(parents=True, exist_ok=True)
if "--resume" not in sys.argv:
    (out / "run.json").write_text(json.dumps({{"input": str(source)}}))
source = pathlib.Path(json.loads((out / "run.json").read_text())["input"])
for file in source.parent.glob("smoke.*.vdb"):
    shutil.copyfile(file, out / "density" / file.name)
"""


@pytest.fixture
def module(hou: Any) -> Any:
    return importlib.import_module("tnst_mi_houdini.node")


@pytest.fixture
def node(tmp_path: Path) -> FakeNode:
    """The asset's node below VDBs, with a program and a folder."""
    files = {}
    for number, frame in zip(FRAMES, moving_smoke(2), strict=True):
        files[number] = tmp_path / f"houdini{number}.vdb"
        velocity = np.ones((*frame.density.shape, 3), np.float32)
        write_houdini(files[number], [houdini_grid("density", frame.density, 0.1), *velocity_in_parts(velocity, 0.1)])
    program = tmp_path / "tnst-mi"
    program.write_text(PROGRAM.format(python=sys.executable))
    program.chmod(0o755)
    made = FakeNode(above=FakeNode(files))
    made["program"], made["folder"], made["range"] = str(program), str(tmp_path / "run 1"), FRAMES
    made["tag"], made["weights"] = ["fire"], "patterns"
    return made


def inputs(folder: Path) -> list[str]:
    """All VDBs that were written for tnst-mi, staged ones included."""
    return sorted(str(path.relative_to(folder)) for path in folder.glob("*input*/*.vdb"))


def idle(hou: Any, until: Any = lambda: False, seconds: float = 30.0) -> None:
    """Houdini's event loop, until its callbacks are gone, or something is so."""
    deadline = time.monotonic() + seconds
    while hou.ui.callbacks and not until() and time.monotonic() < deadline:
        for callback in list(hou.ui.callbacks):
            callback()
        time.sleep(0.02)
    assert time.monotonic() < deadline


def test_stylize_writes_runs_and_shows(hou: Any, module: Any, node: FakeNode, tmp_path: Path) -> None:
    folder = tmp_path / "run 1"
    with pytest.raises(hou.NodeWarning, match=r"smoke\.1001\.vdb is not there: the input is shown; press Stylize"):
        module.cook(node)
    module.stylize(node)
    idle(hou)
    assert hou.ui.messages == [] and hou.ui.status[-1].startswith("tnst-mi is done")
    recipe = Recipe.from_toml(folder / "input.1" / "recipe.toml")
    assert recipe.tag == ("fire",) and recipe.fps == 25.0
    log = (folder / "log.txt").read_text()
    words = f"stylize {folder}/input.1/smoke.####.vdb --recipe {folder}/input.1/recipe.toml --out {folder}/run\n"
    assert log.startswith(words)
    names = [grid.name for grid in read_vdb(folder / "input.1" / "smoke.1002.vdb").grids]
    assert names == ["density", "vel.x", "vel.y", "vel.z"]
    assert node.cooked >= 1
    module.cook(node)
    assert node.shown.file == folder / "run" / "density" / "smoke.1001.vdb"


def test_an_earlier_run_is_replaced_only_where_that_is_said(hou: Any, module: Any, node: FakeNode) -> None:
    module.stylize(node)
    idle(hou)
    module.stylize(node)
    assert "has the results of an earlier run; press Resume" in hou.ui.messages[-1] and not hou.ui.callbacks
    node["replace"], node["range"] = 1, (1002, 1002)
    module.stylize(node)
    idle(hou)
    folder = Path(node.evalParm("folder"))
    assert (folder / "log.txt").read_text().splitlines()[0].endswith("--overwrite")
    # Frames that are not asked for any more are no input, and the input of the run that was replaced is gone.
    assert inputs(folder) == ["input.2/smoke.1002.vdb"]


def test_cancel_and_resume(hou: Any, module: Any, node: FakeNode) -> None:
    folder = Path(node.evalParm("folder"))
    (folder.parent / "slow").touch()
    module.stylize(node)
    idle(hou, lambda: any("octave 1/1, frame 1001, 50%" in status for status in hou.ui.status))
    module.stylize(node)
    assert "a run is under way in" in hou.ui.messages.pop()
    module.cancel(node)
    idle(hou)
    assert hou.ui.status[-1] == "tnst-mi was stopped; Resume goes on from what is done" and not hou.ui.messages
    module.resume(node)
    idle(hou)
    assert hou.ui.status[-1].startswith("tnst-mi is done") and not hou.ui.messages
    assert (folder / "log.txt").read_text().startswith(f"stylize --resume --out {folder}/run\n")


def test_what_is_wrong_is_said_in_one_line(hou: Any, module: Any, node: FakeNode) -> None:
    folder = Path(node.evalParm("folder"))
    module.resume(node)
    assert "no run to go on with; press Stylize" in hou.ui.messages[-1]
    node["content_layers"] = "a=b"
    module.stylize(node)
    assert "content_layers: 'a=b', expected" in hou.ui.messages[-1]
    node["content_layers"] = "inception_4d/output"
    node["range"] = (5, 2)
    module.stylize(node)
    assert "expected the first frame before the last" in hou.ui.messages[-1]
    node["range"] = FRAMES
    assert node.above is not None
    node.above.kinds = ("VDB", "Volume")
    module.stylize(node)
    assert "1 primitives at frame 1001 are no VDBs" in hou.ui.messages[-1] and "Convert VDB" in hou.ui.messages[-1]
    node.above.kinds = ("VDB",)
    assert inputs(folder) == []
    (folder.parent / "bad").touch()
    module.stylize(node)
    idle(hou)
    assert hou.ui.messages[-1].startswith("tnst-mi: recipe.toml: no goal; give --style (all that was said is in ")
    assert inputs(folder) == []
    node.above = None
    (folder.parent / "bad").unlink()
    module.stylize(node)
    assert "nothing is connected; connect the VDBs of the smoke" in hou.ui.messages[-1]
    assert all("\n" not in message for message in hou.ui.messages)


def test_without_a_user_interface_it_waits_and_raises(hou: Any, module: Any, node: FakeNode) -> None:
    hou.available = False
    module.stylize(node)
    folder = Path(node.evalParm("folder"))
    assert (folder / "run" / "density" / "smoke.1002.vdb").is_file()
    node["replace"] = 1
    (folder.parent / "bad").touch()
    with pytest.raises(hou.NodeError, match="no goal; give --style"):
        module.stylize(node)


@pytest.mark.parametrize("why", ["Escape", "cook", "disk"])
def test_an_input_that_cannot_be_written_leaves_the_earlier_run_as_it_was(
    hou: Any, module: Any, node: FakeNode, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It can be resumed, by the same recipe on the same input: nothing is switched before all is written."""
    assert node.above is not None
    module.stylize(node)
    idle(hou)
    folder = Path(node.evalParm("folder"))
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    def interrupted(operation: Any, share: float) -> None:
        if share > 0:
            raise hou.OperationInterrupted

    def full(geometry: FakeGeometry, path: str) -> None:
        Path(path).write_bytes(b"half")
        if path.endswith("1002.vdb"):
            raise hou.OperationFailed("The disk is full.")

    if why == "Escape":
        monkeypatch.setattr(hou.InterruptableOperation, "updateProgress", interrupted)
        said = "interrupted while the input was written"
    elif why == "cook":
        del node.above.files[1002]
        said = "/obj/smoke/stylize1: does not cook at frame 1002 (The attempted operation failed. Error: no frame 1002)"
    else:
        node.above.save = full
        said = "smoke.1002.vdb: Houdini could not write it (The disk is full.); see whether the disk has room"
    node["replace"], node["eta"] = 1, 0.01
    module.stylize(node)
    assert said in (hou.ui.status if why == "Escape" else hou.ui.messages)[-1] and not hou.ui.callbacks
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_a_run_under_way_keeps_its_input_whoever_started_it(
    hou: Any, module: Any, node: FakeNode, tmp_path: Path
) -> None:
    """By the lock of tnst-mi, here held by a process that is not of this Houdini."""
    module.stylize(node)
    idle(hou)
    folder = Path(node.evalParm("folder"))
    holder = "import sys, time, pathlib; from tnst_mi.machine.lock import locked\n"
    holder += "with locked(pathlib.Path(sys.argv[1])): print(1, flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", holder, str(folder / "run")]
    node["replace"] = 1
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None and other.stdout.readline() == b"1\n"
        for action in (module.stylize, module.resume):
            action(node)
            assert f"run: process {other.pid} on " in hou.ui.messages[-1] and not hou.ui.callbacks
        module.cancel(node)
        assert "which this Houdini has not started; press Cancel or Ctrl-C where it was" in hou.ui.messages[-1]
        assert inputs(folder) == ["input.1/smoke.1001.vdb", "input.1/smoke.1002.vdb"]
        other.communicate(b"")
    module.stylize(node)
    idle(hou)
    assert hou.ui.status[-1].startswith("tnst-mi is done")
    module.cancel(node)
    assert "no run is under way" in hou.ui.status[-1]


def test_two_nodes_of_one_folder_and_a_scene_that_is_opened_again(hou: Any, module: Any, node: FakeNode) -> None:
    folder = Path(node.evalParm("folder"))
    (folder.parent / "slow").touch()
    module.stylize(node)
    other = FakeNode(above=node.above)
    other.parms.update(node.parms)
    module.stylize(other)
    assert "a run is under way in" in hou.ui.messages.pop()
    # What another node has started goes on when this one is deleted, and is cancelled by its button.
    module.deleted(other)
    assert not hou.ui.status or "stopp" not in hou.ui.status[-1]
    module.cancel(other)
    idle(hou)
    assert hou.ui.status[-1] == "tnst-mi was stopped; Resume goes on from what is done"


def test_a_run_that_does_not_begin_leaves_the_earlier_one_with_its_input(
    hou: Any, module: Any, node: FakeNode, tmp_path: Path
) -> None:
    module.stylize(node)
    idle(hou)
    (tmp_path / "bad").touch()
    node["replace"] = 1
    module.stylize(node)
    idle(hou)
    assert "no goal; give --style" in hou.ui.messages[-1]
    assert inputs(tmp_path / "run 1") == ["input.1/smoke.1001.vdb", "input.1/smoke.1002.vdb"]


def test_the_run_of_a_node_ends_with_it(hou: Any, module: Any, node: FakeNode, tmp_path: Path) -> None:
    (tmp_path / "slow").touch()
    module.stylize(node)
    module.deleted(node)
    idle(hou)
    assert hou.ui.status[-1] == "tnst-mi was stopped; Resume goes on from what is done"


@pytest.mark.parametrize("name", ["input/smoke.1001.vdb", "log.txt", "input.1/smoke.1001.vdb"])
def test_files_of_others_are_never_touched(hou: Any, module: Any, node: FakeNode, tmp_path: Path, name: str) -> None:
    shot = tmp_path / "shot"
    (shot / name).parent.mkdir(parents=True, exist_ok=True)
    (shot / name).write_bytes(b"precious")
    node["folder"] = str(shot)
    module.stylize(node)
    assert "shot: has files that are not of this asset, which could be lost; choose a new" in hou.ui.messages[-1]
    assert [path for path in shot.rglob("*") if path.is_file()] == [shot / name]
    assert (shot / name).read_bytes() == b"precious"


def test_files_that_were_put_into_an_input_stay(hou: Any, module: Any, node: FakeNode) -> None:
    module.stylize(node)
    idle(hou)
    folder = Path(node.evalParm("folder"))
    (folder / "input.1" / "smoke.0999.vdb").write_bytes(b"precious")
    node["replace"] = 1
    module.stylize(node)
    idle(hou)
    assert inputs(folder) == ["input.1/smoke.0999.vdb", "input.2/smoke.1001.vdb", "input.2/smoke.1002.vdb"]


def test_the_log_may_be_deleted(hou: Any, module: Any, node: FakeNode, tmp_path: Path) -> None:
    (tmp_path / "slow").touch()
    module.stylize(node)
    (Path(node.evalParm("folder")) / "log.txt").unlink()
    idle(hou, lambda: bool(hou.ui.status))
    module.cancel(node)
    idle(hou)
    assert hou.ui.status[-1] == "tnst-mi was stopped; Resume goes on from what is done"


def test_a_result_is_shown_while_the_run_goes_on(hou: Any, module: Any, node: FakeNode, tmp_path: Path) -> None:
    (tmp_path / "slow").touch()
    module.stylize(node)
    result = Path(node.evalParm("result"))
    assert result == tmp_path / "run 1" / "run" / "density" / "smoke.1001.vdb"
    idle(hou, result.parent.is_dir)
    assert node.cooked == 0
    result.write_bytes(b"")
    idle(hou, lambda: node.cooked > 0)
    assert hou.ui.callbacks
    module.cancel(node)
    idle(hou)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("tag", [], "nothing to stylize towards; add a style picture, or a motif by its name, in the folder Goals"),
        ("window", 8, "window = 8: expected an odd integer from 1 to 99"),
        ("gamma", 0.0, "gamma = 0: expected a number above 0, at most 10000 or auto"),
        ("azimuth", (20.0, 10.0), "azimuth = 20, 10: expected two numbers LOW,HIGH, in this order, from -360 to 360"),
        ("mask", "{height = [0.5", "mask: is no value of TOML"),
        ("mask", "{height = [0, 1]}\nseed = 2", "mask: has also seed, expected one value of TOML"),
    ],
)
def test_what_no_recipe_can_have_is_said_before_the_input_is_written(
    hou: Any, module: Any, node: FakeNode, name: str, value: Any, message: str
) -> None:
    node[name] = value
    module.stylize(node)
    assert hou.ui.messages[-1].startswith(message) and not Path(node.evalParm("folder")).exists()


def test_nodes_of_one_name_have_folders_of_their_own() -> None:
    node = FakeNode()
    assert node.evalParm("folder") == "/shots/tnst_mi/a/obj/smoke/stylize1"
    assert node.evalParm("result") == "/shots/tnst_mi/a/obj/smoke/stylize1/run/density/smoke.1001.vdb"


def test_the_real_tnst_mi_gives_the_node_its_grids_back(
    hou: Any, module: Any, node: FakeNode, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A whole stylization below an environment that would break it."""
    program = tmp_path / "real"
    program.write_text(f"#!{sys.executable}\nimport sys\nfrom tnst_mi.cli import main\nsys.exit(main())\n")
    program.chmod(0o755)
    node["program"], node["window"], node["octaves"], node["iterations"], node["views"] = str(program), 3, 1, 2, 1
    node.parms["eta"].keyframes = {FRAMES[0]: (0.01,), FRAMES[1]: (0.02,)}
    for name, value in (("PYTHONHOME", "/nowhere"), ("LD_LIBRARY_PATH", "/nowhere"), ("HFS", "/nowhere")):
        monkeypatch.setenv(name, value)
    module.stylize(node)
    idle(hou, seconds=200)
    assert hou.ui.messages == []
    assert any("octave 1/1, " in status or "writing results" in status for status in hou.ui.status)
    module.cook(node)
    assert node.above is not None and node.shown.file is not None
    before, after = read_vdb(node.above.files[FRAMES[0]]), read_vdb(node.shown.file)
    assert {grid.name for grid in after.grids} == {grid.name for grid in before.grids}
    box = before.grids[0].topology.active_box()
    assert box is not None
    assert (before.grids[0].tree.values_in(box) != after.grids[0].tree.values_in(box)).mean() > 0.1
    # tnst-mi itself says which input its run has read, whose place another takes.
    node["replace"], node["range"], node["window"] = 1, (1002, 1002), 1
    module.stylize(node)
    idle(hou, seconds=200)
    assert hou.ui.messages == []
    assert inputs(Path(node.evalParm("folder"))) == ["input.2/smoke.1002.vdb"]


def test_the_wedge_script_makes_its_work_items(hou: Any, tmp_path: Path) -> None:
    """As it is committed, in a stand-in for TOPs: four variations of one shot, with their recipes."""
    program = tmp_path / "tnst-mi"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    hou.text = SimpleNamespace(expandString=lambda text: text.replace("$HIP", str(tmp_path)))
    hou.getenv = {"TNST_MI_PROGRAM": str(program)}.get
    items: list[dict[str, str]] = []
    outputs: list[tuple[str, str, bool]] = []
    (tmp_path / "sh010").mkdir()
    for name in ("smoke.0009.vdb", "smoke.0010.vdb", "smoke.vdb", "fire.0010.vdb"):
        (tmp_path / "sh010" / name).touch()

    def add(index: int) -> SimpleNamespace:
        assert index == len(items)
        items.append(found := {})
        return SimpleNamespace(
            setStringAttrib=found.__setitem__,
            setCommand=lambda line: found.update(command=line),
            addExpectedOutputFile=lambda path, tag, own: outputs.append((path, tag, own)),
        )

    script = build_houdini_asset.ASSET.parents[1] / "pdg" / "wedge_recipes.py"
    runpy.run_path(str(script), {"item_holder": SimpleNamespace(addWorkItem=add)})
    assert len({item["command"] for item in items}) == 4
    for item in items:
        recipe = Recipe.from_toml(item["recipe"])
        assert recipe.tag == ("fire",) and recipe.fps == 25.0 and f"eta{recipe.eta}" in item["variation"]
        assert item["recipe"] in item["command"] and item["results"].startswith(item["out"])
    # None that TOPs would remove: a run can be gone on with.
    assert outputs == [
        (f"{item['out']}/density/smoke.{number}.vdb", "file/geo/vdb", False)
        for item in items
        for number in ("0009", "0010")
    ]
