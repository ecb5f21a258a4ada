"""The asset's code that needs no Houdini: names of sequences, recipes, command lines, environments, logs, processes."""

from __future__ import annotations

import ast
import doctest
import json
import os
import platform
import shlex
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from types import ModuleType

import pytest
from fake_houdini import FakeNode
from tnst_mi_houdini import child, commands, environment, lock, pythons, sequences, values
from tnst_mi_houdini import recipe_text as recipe_texts
from tnst_mi_houdini.job import Job
from tnst_mi_houdini.recipe_text import Typed, recipe_text
from tnst_mi_houdini.run_folder import Input, RunFolder
from tnst_mi_houdini.work_items import work_items

from tnst_mi.batch.jobs import jobs_of
from tnst_mi.io.files.listing import list_frames
from tnst_mi.recipe.recipe import Recipe

FRAMES = range(10, 13)


@pytest.mark.parametrize(
    ("houdini", "pattern", "file"),
    [
        ("/a/smoke.$F4.vdb", "/a/smoke.####.vdb", "/a/smoke.0012.vdb"),
        ("/a/smoke.$F.vdb", "/a/smoke.#.vdb", "/a/smoke.12.vdb"),
        ("/a/smoke_${F5}_v2.vdb", "/a/smoke_#####_v2.vdb", "/a/smoke_00012_v2.vdb"),
        ("/a/smoke.<F4>.vdb", "/a/smoke.####.vdb", "/a/smoke.0012.vdb"),
        ("C:/a b/$FPS.$F4.vdb", "C:/a b/$FPS.####.vdb", "C:/a b/$FPS.0012.vdb"),
    ],
)
def test_names_of_sequences(houdini: str, pattern: str, file: str) -> None:
    assert sequences.frame_pattern(houdini) == pattern and sequences.frame_file(houdini, 12) == file


@pytest.mark.parametrize("path", ["smoke.vdb", "smoke.$FF.vdb", "smoke.$FSTART.vdb", "smoke.$F4_a.vdb", "$F/$F4.vdb"])
def test_names_without_one_number_of_the_frame_are_refused(path: str) -> None:
    with pytest.raises(sequences.NoFrameNumber, match=r"expected one \$F4 or \$\{F4\}, as in smoke\.\$F4\.vdb"):
        sequences.frame_pattern(path)


def test_the_recipe_of_a_new_node_is_empty() -> None:
    """What is not changed is not written: presets and later defaults apply."""
    assert values.recipe_values(FakeNode(), FRAMES) == ({}, [])


def test_a_recipe_reads_as_the_node_says() -> None:
    node = FakeNode()
    node["style"] = ['/a/van "gogh"\'s.png', "", "flames"]
    node["style_layers"] = "conv2/3x3=0.5, inception_3b/output"
    node["eta"], node["gamma_choice"], node["look"], node["look_choice"] = 0.004, "auto", 2.5, "number"
    node["fps_choice"], node["fps"], node["threads_choice"] = "number", 25.0, "unset"
    node["azimuth"], node["origin_choice"], node["origin"] = (-30.0, 30.0), "number", (0.0, 1.5, 0.0)
    node["fit"], node["crop"], node["window"], node["reach"] = 1, 0, 9, "5%"
    node["keep_silhouette"], node["preset"], node["transport"] = "2.5", "paper", "step"
    node["mask"] = "{height = [0.5,\n 2.0]}"
    found, notes = values.recipe_values(node, FRAMES)
    read = tomllib.loads(recipe_text(found))
    assert notes == [] and read == {
        "style": ['/a/van "gogh"\'s.png', "flames"],
        "style_layers": {"conv2/3x3": 0.5, "inception_3b/output": 1.0},
        **{
            "eta": 0.004,
            "gamma": "auto",
            "look": 2.5,
            "fps": 25.0,
            "azimuth": [-30.0, 30.0],
            "origin": [0.0, 1.5, 0.0],
        },
        **{"fit": True, "crop": False, "window": 9, "reach": "5%", "keep_silhouette": 2.5, "preset": "paper"},
        **{"transport": "step", "mask": {"height": [0.5, 2.0]}},
    }


def test_what_is_written_is_a_recipe_for_tnst_mi(tmp_path: Path) -> None:
    node = FakeNode()
    node["tag"], node["strength"], node["gamma_choice"] = ["fire"], 0.5, "auto"
    node.parms["eta"].keyframes = {frame: (0.001 * frame,) for frame in FRAMES}
    found, _ = values.recipe_values(node, FRAMES)
    (tmp_path / "recipe.toml").write_text(recipe_text(found, "/obj/a\nb"), encoding="utf-8")
    recipe = Recipe.from_toml(tmp_path / "recipe.toml")
    assert recipe.tag == ("fire",) and recipe.strength == 0.5 and recipe.gamma == "auto"
    assert [recipe.at(frame).eta for frame in FRAMES] == [0.01, 0.011, 0.012]


def test_animation_where_a_recipe_has_none_is_said() -> None:
    node = FakeNode()
    node.parms["iterations"].keyframes = {10: (30,), 11: (40,)}
    node["tag"], node["gamma_choice"] = ["fire"], "auto"
    for name in ("tag1", "fit", "gamma"):
        node.parms[name].keyframes = {10: node.parms[name].values}
    node["look_choice"], node["look"] = "number", 2.0
    node.parms["look_choice"].keyframes = {12: ("thick",)}
    found, notes = values.recipe_values(node, FRAMES)
    assert found == {"iterations": 30, "tag": ["fire"], "gamma": "auto", "look": 2.0}
    # The number beside a word counts for nothing.
    assert [note.split()[0] for note in notes] == ["tag", "look", "iterations", "fit"]
    assert notes[2] == "iterations is animated, and cannot change over the frames: taken as at frame 10"


def test_layers_that_are_none_are_refused() -> None:
    node = FakeNode()
    node["content_layers"] = "conv2/3x3=much"
    with pytest.raises(values.BadValue, match=r"content_layers: 'conv2/3x3=much', expected LAYER or LAYER=WEIGHT"):
        values.recipe_values(node, FRAMES)


@pytest.mark.parametrize(
    ("name", "value", "kept"),
    [
        ("PATH", "/opt/hfs20.5/bin:/usr/bin:/opt/hfs20.5.1/bin", "/usr/bin:/opt/hfs20.5.1/bin"),
        ("PYTHONHOME", "/opt/hfs20.5/python", None),
        ("PYTHONPATH", "/opt/hfs20.5/houdini/python3.11libs:/studio/python", "/studio/python"),
        ("PYTHONPATH", f"{Path(child.__file__).parents[1]}", None),
        ("LD_LIBRARY_PATH", "/opt/hfs20.5/dsolib:/opt/cuda/lib64", "/opt/cuda/lib64"),
        ("LD_LIBRARY_PATH", "/opt/hfs20.5/dsolib", None),
        ("LD_PRELOAD", "/opt/hfs20.5/dsolib/libjemalloc.so /opt/studio/license.so", "/opt/studio/license.so"),
        ("DYLD_LIBRARY_PATH", "/opt/hfs20.5/dsolib:/usr/local/lib", "/usr/local/lib"),
        ("DYLD_FRAMEWORK_PATH", "/opt/hfs20.5/Frameworks", None),
        ("DYLD_INSERT_LIBRARIES", "/opt/hfs20.5/a.dylib", None),
        ("PXR_PLUGINPATH_NAME", "/opt/hfs20.5/usd:/studio/usd", "/studio/usd"),
        ("QT_PLUGIN_PATH", "/opt/hfs20.5/qt", None),
        ("HOME", "/home/a", "/home/a"),
    ],
)
def test_the_process_has_the_users_environment_without_houdinis(name: str, value: str, kept: str | None) -> None:
    around = {"HFS": "/opt/hfs20.5", "TERM": "linux"}
    assert child.users_own({**around, name: value}) == {**around, **({} if kept is None else {name: kept})}
    # What a farm's processes inherit is not known; there, all of it is taken away.
    words = shlex.split(commands.farm_line(["tnst-mi"], windows=False))
    assert (name in words) == (name not in ("PATH", "HOME"))


def test_another_python_starts_below_houdinis_environment() -> None:
    """With a PYTHONHOME that is Houdini's, a Python does not start; with what is left of the environment, it does."""
    broken = {**os.environ, "HFS": "/nowhere", "PYTHONHOME": "/nowhere", "PYTHONPATH": "/nowhere"}
    command = [sys.executable, "-c", "print('started')"]
    assert subprocess.run(command, env=broken, capture_output=True, check=False).returncode != 0
    cleaned = child.users_own(broken)
    assert subprocess.run(command, env=cleaned, capture_output=True, check=True).stdout.split() == [b"started"]
    line = commands.farm_line(command, windows=False)
    assert subprocess.run(line, shell=True, env=broken, capture_output=True, check=True).stdout.split() == [b"started"]


def test_the_program_is_found_where_it_is_named(tmp_path: Path) -> None:
    program = tmp_path / "env" / "bin" / "tnst-mi"
    program.parent.mkdir(parents=True)
    program.write_text("#!/bin/sh\n")
    path = {"PATH": str(program.parent)}
    with pytest.raises(environment.ProgramMissing, match="is not a program"):
        environment.find_program(str(tmp_path / "env"), {})
    program.chmod(0o755)
    for chosen, around in (("", path), (str(tmp_path / "env"), {}), ("", {environment.PROGRAM: str(program)})):
        assert environment.find_program(chosen, around) == str(program)
    with pytest.raises(environment.ProgramMissing, match="not found on the PATH; name the program"):
        environment.find_program("", {"PATH": str(tmp_path)})
    with pytest.raises(environment.ProgramMissing, match="no tnst-mi there, expected the program or the folder"):
        environment.find_program(str(tmp_path), path)


def test_a_cancelled_job_ends_though_houdini_ignores_ctrl_c(tmp_path: Path) -> None:
    """As it does if a script has started it in the background; what it starts inherits that."""
    script = "import time; print('octave 1/2: 40% 4/10 [00:01<00:02, x]', flush=True); time.sleep(60)"
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        job = Job([sys.executable, "-c", script], tmp_path / "deep" / "log.txt")
        job.start()
    finally:
        signal.signal(signal.SIGINT, before)
    deadline = time.monotonic() + 15
    while not job.poll().text.startswith("octave 1/2, 40%") and time.monotonic() < deadline:
        time.sleep(0.02)
    job.cancel()
    while not job.finished and time.monotonic() < deadline:
        time.sleep(0.02)
    assert job.finished and job.exit_code != 0 and job.cancelled and job.error is None


def test_a_job_tells_its_progress_each_second_and_why_it_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LD_LIBRARY_PATH", "/opt/hfs/dsolib:/opt/cuda/lib64")
    monkeypatch.setenv("HFS", "/opt/hfs")
    script = (
        "echo $TNST_MI_PROGRESS_SECONDS $LD_LIBRARY_PATH; echo 'tnst-mi: x.vdb: empty; export it again' >&2; exit 2"
    )
    job = Job(["sh", "-c", script], tmp_path / "log")
    job.start()
    while not job.finished:
        time.sleep(0.02)
    assert job.exit_code == 2 and job.error == "tnst-mi: x.vdb: empty; export it again"
    assert job.log.read_text().splitlines()[0] == "1 /opt/cuda/lib64"


def test_the_python_that_watches_is_houdinis_also_where_houdini_is_the_executable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "python" / "bin" / f"python{sys.version_info[0]}.{sys.version_info[1]}"
    own.parent.mkdir(parents=True)
    own.touch()
    monkeypatch.setattr(sys, "executable", str(tmp_path / "houdini-bin"))
    monkeypatch.setattr(sys, "base_prefix", str(tmp_path / "python"))
    assert pythons.any_python() == own
    own.unlink()
    newer = tmp_path / "python3.12"
    newer.touch(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert pythons.any_python() == newer


def test_an_input_stays_as_long_as_its_run_may_need_it(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "deep" / "folder")
    first, second, third = (folder.write_input(lambda to: (to / "recipe.toml").touch(), "/obj/a") for _ in range(3))
    assert [each.path.name for each in (first, second, third)] == ["input.1", "input.2", "input.3"]
    folder.out.mkdir()
    (folder.out / "recipe.toml").touch()
    folder.remove_superseded(third)  # it has begun, and does not say yet what it reads
    assert all(each.recipe.is_file() for each in (first, second, third))
    record = folder.out / "run.json"
    record.write_text(json.dumps({"input": second.sequence}))
    folder.remove_superseded(third)  # the run that is there is another
    assert sorted(path.name for path in folder.path.glob("input.*")) == ["input.2"]
    for damaged in ("", "[]", '{"input": 5}', json.dumps({"input": str(tmp_path / "input.9" / "smoke.####.vdb")})):
        record.write_text(damaged)
        folder.remove_superseded()
    assert second.recipe.is_file()


def test_a_damaged_list_of_files_removes_nothing_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "precious").touch()
    (tmp_path / "input.1").mkdir()
    (tmp_path / "input.1" / "tnst_mi_input.json").write_text(json.dumps({"files": ["../precious", "..", 5, ""]}))
    Input(tmp_path / "input.1").remove()
    assert [path.name for path in tmp_path.iterdir()] == ["precious"]


def test_a_lock_file_names_nobody_by_itself(tmp_path: Path) -> None:
    """As that of a run that was killed; one of another machine is believed."""
    assert lock.writer_of(tmp_path) is None
    for text in ("", "[]", '{"host": 1, "pid": 2}', json.dumps({"host": platform.node(), "pid": 1})):
        (tmp_path / lock.LOCK).write_text(text)
        assert lock.writer_of(tmp_path) is None
    (tmp_path / lock.LOCK).write_text('{"host": "render7", "pid": 12}')
    assert lock.writer_of(tmp_path) == "process 12 on render7"


def test_typed_toml_stays_as_it_was_typed() -> None:
    node = FakeNode()
    node["mask"] = '{file = "my  mask.npz"}'
    node["target"] = '[\n{style = "a.png", mask = "flame"}, # first\n{style = "b.png"}]'
    found, _ = values.recipe_values(node, FRAMES)
    assert tomllib.loads(recipe_text(found)) == {
        "mask": {"file": "my  mask.npz"},
        "target": [{"style": "a.png", "mask": "flame"}, {"style": "b.png"}],
    }


@pytest.mark.parametrize(
    ("typed", "written"),
    [
        ("$HIP/masks/m_$F4.npz", "/shots/masks/m_####.npz"),
        ('{file = "$HIP/m_${F}_v2.npz", invert = true}', Typed('{file = "/shots/m_#_v2.npz", invert = true}')),
        ("$HIP/masks/m_$FF.npz", "/shots/masks/m_$FF.npz"),
    ],
)
def test_masks_of_each_frame_stay_masks_of_each_frame(typed: str, written: str) -> None:
    node = FakeNode()
    node["mask"] = typed
    assert values.recipe_values(node, FRAMES) == ({"mask": written}, [])


def test_a_camera_by_the_number_of_the_frame_is_said() -> None:
    node = FakeNode()
    node["camera"] = "$HIP/shot_$F4.json"
    found, notes = values.recipe_values(node, FRAMES)
    assert found == {"camera": "/shots/shot_0010.json"}
    assert notes == ["camera is animated, and cannot change over the frames: taken as at frame 10"]


def test_work_items_have_names_of_their_own(tmp_path: Path) -> None:
    """Also where values differ in what no name has, in capitals, or in their end."""
    styles = [["a b.png"], ["a_b.png"], ["A_b.png"], ["/x" * 200 + "1"], ["/x" * 200 + "2"], "", "..", "λ"]
    items = work_items("tnst-mi", {"a": "smoke.$F4.vdb"}, {}, {"style": styles}, tmp_path)
    assert len({item.name.lower() for item in items}) == len(styles)
    assert [tomllib.loads(item.recipe.read_text("utf-8"))["style"] for item in items] == styles
    assert max(len(item.name) for item in items) < 100
    again = work_items("tnst-mi", {"a": "smoke.$F4.vdb"}, {}, {"style": styles[2::-1]}, tmp_path)
    assert {item.name for item in again} == {item.name for item in items[:3]}


@pytest.mark.parametrize("shot", ["../up", "a/b", "", "..", "sh 10"])
def test_shots_that_are_no_folders_are_refused(tmp_path: Path, shot: str) -> None:
    with pytest.raises(ValueError, match="expected the name of a shot that a folder can have, such as"):
        work_items("tnst-mi", {shot: "smoke.$F4.vdb"}, {}, {"eta": [0.1]}, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["100%.vdb", "a&b.vdb", "a^b.vdb", 'a"b.vdb', "a|b", "!x"])
def test_what_cmd_would_take_for_its_own_is_refused(name: str) -> None:
    assert commands.farm_line(["tnst-mi.exe", "my smoke.vdb"], windows=True).endswith('&& tnst-mi.exe "my smoke.vdb""')
    with pytest.raises(ValueError, match=r"which cmd\.exe does not leave alone; rename it"):
        commands.farm_line(["tnst-mi.exe", name], windows=True)


def test_work_items_are_batches_whose_results_are_where_they_say(tmp_path: Path) -> None:
    """For each shot and each combination: the folder is the one that tnst-mi batch has for it."""
    shots = {"sh010": str(tmp_path / "a b" / "smoke.$F4.vdb"), "sh020": "/c/fire_${F4}.vdb"}
    variations = {"eta": [0.002, 0.004], "tag": [["fire"], ["flower"], ["brush strokes"]]}
    items = work_items("/env/bin/tnst-mi", shots, {"window": 9}, variations, tmp_path, "slurm:a.toml")
    assert len(items) == 12 and len({item.out for item in items}) == 12
    for item in items:
        words = shlex.split(item.command)
        begin = words.index("/env/bin/tnst-mi")
        assert words[begin + 1] == "batch" and words[-2:] == ["--cluster", "slurm:a.toml"]
        recipe, source, _, out = map(Path, words[begin + 2 : begin + 6])
        (job,) = jobs_of({recipe: Recipe.from_toml(recipe)}, [source], out)
        assert job.out == item.out and Path(item.results).parent == item.out / "density"
        assert job.recipe.window == 9 and job.recipe.eta == item.values["eta"]
        assert job.recipe.tag == tuple(item.values["tag"])


@pytest.mark.parametrize("module", [child, commands, sequences, recipe_texts])
def test_examples_of_docstrings_run(module: ModuleType) -> None:
    assert doctest.testmod(module).failed == 0 and doctest.testmod(module).attempted > 0


def test_no_other_package_is_needed_and_python_3_10_will_do() -> None:
    """Houdini 20 has Python 3.10; nothing but the standard library, hou and the package itself is imported."""
    for file in Path(commands.__file__).parent.glob("*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"), feature_version=(3, 10))
        imported = {
            name.name.split(".")[0] for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names
        }
        imported |= {
            node.module.split(".")[0]
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
            if not node.level and node.module
        }
        assert imported <= {*sys.stdlib_module_names, *(["hou"] if file.name == "node.py" else [])}


def test_the_pattern_is_what_tnst_mi_reads(tmp_path: Path) -> None:
    houdini = str(tmp_path / "smoke.$F4.vdb")
    for frame in (9, 10, 11):
        Path(sequences.frame_file(houdini, frame)).touch()
    listing = list_frames(Path(sequences.frame_pattern(houdini)))
    assert listing.numbers == [9, 10, 11]
