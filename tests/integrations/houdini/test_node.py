"""The node, in a stand-in for Houdini: what its buttons write, run and show. Houdini itself takes no part in this."""

from __future__ import annotations

import importlib
import os
import runpy
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
import pathlib, shutil, sys, time
source, out = pathlib.Path(sys.argv[2]), pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
print(" ".join(sys.argv[1:]), flush=True)
print("smoke.1001 octave 1/1:  50% 1/2 [00:01<00:01, iteration 1/2, loss 1]", flush=True)
if (out.parent / "slow").exists() and "--resume" not in sys.argv:
    (out / "density").mkdir(parents=True)
    (out / "recipe.toml").touch()
    time.sleep(60)
if (out.parent / "bad").exists():
    sys.exit("tnst-mi: recipe.toml: no goal; give --style")
(out / "density").mkdir(parents=True, exist_ok=True)
for file in (out.parent / "input").glob("smoke.*.vdb"):
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
    made["result"] = str(tmp_path / "run 1" / "run" / "density" / "smoke.1001.vdb")
    made["tag"], made["weights"] = ["fire"], "patterns"
    return made


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
    recipe = Recipe.from_toml(folder / "recipe.toml")
    assert recipe.tag == ("fire",) and recipe.fps == 25.0
    log = (folder / "log.txt").read_text()
    assert log.startswith(f"stylize {folder}/input/smoke.####.vdb --recipe {folder}/recipe.toml --out {folder}/run\n")
    names = [grid.name for grid in read_vdb(folder / "input" / "smoke.1002.vdb").grids]
    assert names == ["density", "vel.x", "vel.y", "vel.z"]
    assert node.cooked == 1
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
    # Frames that are not asked for any more are no input.
    assert [path.name for path in (folder / "input").iterdir()] == ["smoke.1002.vdb"]


def test_cancel_and_resume(hou: Any, module: Any, node: FakeNode) -> None:
    folder = Path(node.evalParm("folder"))
    folder.mkdir()
    (folder / "slow").touch()
    module.stylize(node)
    idle(hou, lambda: "stylize1: smoke.1001 octave 1/1, 50%, 00:01 left" in hou.ui.status)
    module.stylize(node)
    assert "a run is under way; press Cancel, or wait for it" in hou.ui.messages.pop()
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
    assert not folder.exists()
    folder.mkdir()
    (folder / "bad").touch()
    module.stylize(node)
    idle(hou)
    assert hou.ui.messages[-1].startswith("recipe.toml: no goal; give --style (tnst-mi ended with code 1; all that")
    node.above = None
    (folder / "bad").unlink()
    module.stylize(node)
    assert "nothing is connected; connect the VDBs of the smoke" in hou.ui.messages[-1]
    assert all("\n" not in message for message in hou.ui.messages)


def test_without_a_user_interface_it_waits_and_raises(hou: Any, module: Any, node: FakeNode) -> None:
    hou.available = False
    module.stylize(node)
    folder = Path(node.evalParm("folder"))
    assert (folder / "run" / "density" / "smoke.1002.vdb").is_file()
    node["replace"] = 1
    (folder / "bad").touch()
    with pytest.raises(hou.NodeError, match="no goal; give --style"):
        module.stylize(node)


def test_interrupting_the_input_leaves_no_half_file(hou: Any, module: Any, node: FakeNode, monkeypatch: Any) -> None:
    def interrupted(operation: Any, share: float) -> None:
        if share > 0:
            raise hou.OperationInterrupted

    monkeypatch.setattr(hou.InterruptableOperation, "updateProgress", interrupted)
    module.stylize(node)
    folder = Path(node.evalParm("folder"))
    assert "interrupted while the input was written" in hou.ui.status[-1] and not hou.ui.callbacks
    assert os.listdir(folder) == ["input"] and os.listdir(folder / "input") == ["smoke.1001.vdb"]


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
    assert hou.ui.messages == [] and any("octave 1/1, " in status for status in hou.ui.status)
    module.cook(node)
    assert node.above is not None and node.shown.file is not None
    before, after = read_vdb(node.above.files[FRAMES[0]]), read_vdb(node.shown.file)
    assert {grid.name for grid in after.grids} == {grid.name for grid in before.grids}
    box = before.grids[0].topology.active_box()
    assert box is not None
    assert (before.grids[0].tree.values_in(box) != after.grids[0].tree.values_in(box)).mean() > 0.1


def test_a_frame_that_cannot_be_written_is_said_and_leaves_nothing(hou: Any, module: Any, node: FakeNode) -> None:
    def full(geometry: FakeGeometry, path: str) -> None:
        Path(path).write_bytes(b"half")
        raise hou.OperationFailed("The disk is full.")

    assert node.above is not None
    node.above.save = full
    module.stylize(node)
    (message,) = hou.ui.messages
    assert "smoke.1001.vdb: Houdini could not write it (The disk is full.); see whether the disk has room" in message
    assert os.listdir(Path(node.evalParm("folder")) / "input") == []


def test_the_wedge_script_makes_its_work_items(hou: Any, tmp_path: Path) -> None:
    """As it is committed, in a stand-in for TOPs: four variations of one shot, with their recipes."""
    program = tmp_path / "tnst-mi"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    hou.text = SimpleNamespace(expandString=lambda text: text.replace("$HIP", str(tmp_path)))
    hou.getenv = {"TNST_MI_PROGRAM": str(program)}.get
    items: list[dict[str, str]] = []

    def add(index: int) -> SimpleNamespace:
        assert index == len(items)
        items.append(found := {})
        return SimpleNamespace(setStringAttrib=found.__setitem__, setCommand=lambda line: found.update(command=line))

    script = build_houdini_asset.ASSET.parents[1] / "pdg" / "wedge_recipes.py"
    runpy.run_path(str(script), {"item_holder": SimpleNamespace(addWorkItem=add)})
    assert len({item["command"] for item in items}) == 4
    for item in items:
        recipe = Recipe.from_toml(item["recipe"])
        assert recipe.tag == ("fire",) and recipe.fps == 25.0 and f"eta{recipe.eta}" in item["variation"]
        assert item["recipe"] in item["command"] and item["results"].startswith(item["out"])
