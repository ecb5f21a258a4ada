"""The asset's code that needs no Houdini: names of sequences, recipes, command lines, environments, logs, processes."""

from __future__ import annotations

import ast
import doctest
import os
import shlex
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from types import ModuleType

import pytest
from fake_houdini import FakeNode
from tnst_mi_houdini import commands, environment, progress, sequences, values
from tnst_mi_houdini import recipe_text as recipe_texts
from tnst_mi_houdini.job import Job
from tnst_mi_houdini.recipe_text import recipe_text
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


def test_nothing_of_houdini_leaks_into_the_process() -> None:
    given = {
        **{"HFS": "/opt/hfs20.5", "PATH": "/opt/hfs20.5/bin:/usr/bin:/opt/hfs20.5.1/bin", "HOME": "/home/a"},
        **{"PYTHONHOME": "/opt/hfs20.5/python", "PYTHONPATH": "/x", "LD_LIBRARY_PATH": "/opt/hfs20.5/dsolib"},
    }
    kept = environment.process_environment(given)
    assert kept == {"HFS": "/opt/hfs20.5", "PATH": "/usr/bin:/opt/hfs20.5.1/bin", "HOME": "/home/a"}


def test_another_python_starts_below_houdinis_environment() -> None:
    """With a PYTHONHOME that is Houdini's, a Python does not start; with what is left of the environment, it does."""
    broken = {**os.environ, "PYTHONHOME": "/nowhere", "PYTHONPATH": "/nowhere"}
    command = [sys.executable, "-c", "print('started')"]
    assert subprocess.run(command, env=broken, capture_output=True, check=False).returncode != 0
    cleaned = environment.process_environment(broken)
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


def test_progress_and_errors_are_read_from_a_log() -> None:
    line = "smoke.0003 octave 1/1:  67% 12/18 [00:02<00:03, iteration 4/6, loss 91.86]"
    assert progress.progress_of(line) == progress.Progress(0.67, "smoke.0003 octave 1/1, 67%, 00:03 left")
    for other in ("device: CPU, 2 threads (llvm_ad_rgb)", "smoke.0001: mass 479.41 → 479.36 (-0.0%)", ""):
        assert progress.progress_of(other) is None
    assert progress.error_of("a\ntnst-mi: recipe.toml: no\nb\n") == "recipe.toml: no" and progress.error_of("a") is None


def test_a_cancelled_job_leaves_no_process(tmp_path: Path) -> None:
    """Ctrl-C reaches the children too; its progress was read before."""
    child = "import subprocess, sys, time; p = subprocess.Popen(['sleep', '60']); print(p.pid, flush=True);"
    script = f"{child} print('f octave 1/2: 40% 4/10 [00:01<00:02, x]', flush=True); time.sleep(60)"
    job = Job([sys.executable, "-c", script], tmp_path / "deep" / "log.txt", os.environ)
    deadline = time.monotonic() + 20
    while job.progress is None and time.monotonic() < deadline:
        time.sleep(0.02)
    assert job.progress == progress.Progress(0.4, "f octave 1/2, 40%, 00:02 left") and job.exit_code is None
    job.cancel()
    assert job.wait() != 0 and job.cancelled
    with pytest.raises(ProcessLookupError):
        pid = int(job.log.read_text().split()[0])
        while time.monotonic() < deadline:
            os.kill(pid, 0)
            time.sleep(0.02)


def test_a_failed_job_says_why(tmp_path: Path) -> None:
    job = Job(["sh", "-c", "echo 'tnst-mi: x.vdb: empty; export it again' >&2; exit 2"], tmp_path / "log", os.environ)
    assert job.wait() == 2 and not job.cancelled
    assert job.error.startswith("x.vdb: empty; export it again (tnst-mi ended with code 2; all that it said is in ")


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


@pytest.mark.parametrize("module", [commands, environment, progress, sequences, recipe_texts])
def test_examples_of_docstrings_run(module: ModuleType) -> None:
    assert doctest.testmod(module).failed == 0 and doctest.testmod(module).attempted > 0


def test_no_other_package_is_needed_and_python_3_9_will_do() -> None:
    """Houdini 19.5 has Python 3.9; nothing but the standard library, hou and the package itself is imported."""
    for file in Path(commands.__file__).parent.glob("*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"), feature_version=(3, 9))
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
