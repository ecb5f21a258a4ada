"""Stages that crash Pixar's library, hang it, fill the memory or make it answer nonsense; and what is asked of it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from tnst_mi.errors import InputError
from tnst_mi.io.cameras import usd, usd_process
from tnst_mi.io.cameras.reading import read_cameras

ANSWER: dict[str, Any] = {
    "cameras": ["/main"],
    "matching": ["/main"],
    "metres": 1.0,
    "up": "Y",
    "span": [1.0, 1.0],
    "samples": [
        {
            "frame": 1,
            "matrix": np.eye(4).tolist(),
            "perspective": True,
            "focal_length": 50.0,
            "apertures": [36.0, 24.0],
            "offsets": [0.0, 0.0],
        }
    ],
}


def library(folder: Path, opening: str) -> None:
    """Write a library in place of Pixar's, which does something else when it opens a stage."""
    (folder / "pxr").mkdir()
    (folder / "pxr" / "__init__.py").touch()
    (folder / "pxr" / "UsdGeom.py").touch()
    lines = "\n        ".join(opening.splitlines())
    (folder / "pxr" / "Usd.py").write_text(
        f"import contextlib, os, signal, sys, time\n\nclass Stage:\n    LoadNone = 0\n\n"
        f"    @staticmethod\n    def Open(path, load):\n        {lines}\n",
        "utf-8",
    )


def answering(content: bytes) -> str:
    """What makes the library write something in place of our answer, and end as if all was well."""
    return (
        f"answer = {content!r}\n"
        "for descriptor in range(3, 10):\n"
        "    with contextlib.suppress(OSError):\n"
        "        while answer:\n"
        "            answer = answer[os.write(descriptor, answer):]\n"
        "os._exit(0)"
    )


@pytest.fixture
def stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(str(tmp_path))
    path = tmp_path / "shot.usda"
    path.write_text("#usda 1.0\n", "utf-8")
    return path


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_cameras(str(path)).at(1, "y")
    message = str(caught.value)
    assert "shot.usda: " in message and message.isprintable() and len(message) <= 300
    return message


@pytest.mark.skipif(sys.platform == "win32", reason="there, processes do not end by signals")
@pytest.mark.parametrize("name", ["SIGABRT", "SIGSEGV", "SIGKILL"])
def test_a_crash_is_one_line(stage: Path, name: str) -> None:
    library(stage.parent, f"os.kill(os.getpid(), signal.{name})")
    assert f"crashes Pixar's library ({name}); it is damaged, or takes more than 4 GB: save" in refusal(stage)


def test_a_crash_leaves_no_core(stage: Path) -> None:
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_CORE)
    resource.setrlimit(resource.RLIMIT_CORE, (before[1], before[1]))
    try:
        library(stage.parent, "import resource\nraise RuntimeError(resource.getrlimit(resource.RLIMIT_CORE)[0])")
        assert "damaged (0)" in refusal(stage)
    finally:
        resource.setrlimit(resource.RLIMIT_CORE, before)


def test_a_library_that_ends_the_process_is_a_crash(stage: Path) -> None:
    library(stage.parent, "os._exit(7)")
    assert "crashes Pixar's library (exit code 7)" in refusal(stage)


@pytest.mark.parametrize("how", ["while True:\n    pass", answering(b"{}").replace("os._exit(0)", "time.sleep(600)")])
def test_a_hang_ends_in_time(stage: Path, monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    monkeypatch.setattr(usd_process, "_SECONDS", 1.5)
    library(stage.parent, how)
    start, before = time.monotonic(), psutil.Process().children()
    assert "took more than 1.5 s to read it; export the camera alone" in refusal(stage)
    assert 1.5 <= time.monotonic() - start < 6
    assert psutil.Process().children() == before


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems do not keep the limit")
def test_memory_is_bounded(stage: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(usd_process, "_MEMORY", 300_000_000)
    library(stage.parent, "kept = []\nwhile True:\n    kept.append(bytes(10_000_000))")
    assert "takes more than 300 MB to read; export the camera alone" in refusal(stage)


def test_a_limit_of_the_whole_command_is_named(stage: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(usd_process.address_space, "limit", lambda: 500_000_000)
    library(stage.parent, "raise MemoryError")
    assert "takes more than 500 MB to read" in refusal(stage)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{}",
        b"3",
        b"null",
        b'"problem"',
        b"\xff\x00",
        b"[" * 100_000,
        b'{"problem": "memory"',
        b"9" * 5000,
        b"0" * (usd_process._LONGEST + 1),
        *(
            json.dumps(ANSWER | change).encode()
            for change in (
                {"cameras": 1},
                {"metres": "far"},
                {"span": [1.0]},
                {"samples": 5},
                {"samples": [{}]},
                {"samples": [ANSWER["samples"][0] | {"matrix": [[1.0, 0.0]]}]},
                {"samples": [ANSWER["samples"][0] | {"offsets": [10**400, 0]}]},
                {"samples": [ANSWER["samples"][0] | {"frame": [1]}]},
            )
        ),
    ],
    ids=range(18),
)
def test_nonsense_is_one_line(stage: Path, content: bytes) -> None:
    library(stage.parent, answering(content))
    assert "makes Pixar's library answer nonsense; save it again, or copy it again" in refusal(stage)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"up": "X\x1b[31m"}, "upAxis = 'X\\x1b[31m': expected Y or Z"),
        ({"metres": 0.0}, "metersPerUnit = 0: expected a number above 0"),
        ({"metres": float("inf")}, "metersPerUnit = inf: expected a number above 0"),
        ({"span": [float("nan"), 1.0]}, "has no camera for frame 1; it goes from nan to 1"),
        ({"samples": []}, "has changed since it was opened"),
        ({"matching": []}, "has /main; name one"),
        ({"cameras": [], "matching": []}, "has no camera in it"),
        ({"samples": [ANSWER["samples"][0] | {"focal_length": float("nan")}]}, "focal length nan, expected numbers"),
    ],
)
def test_values_that_no_camera_has_are_refused(stage: Path, change: dict[str, Any], line: str) -> None:
    library(stage.parent, answering(json.dumps(ANSWER | change).encode()))
    assert line in refusal(stage)


def test_what_it_should_answer_is_a_camera(stage: Path) -> None:
    """So that the answers above are refused for what is wrong with them."""
    library(stage.parent, answering(json.dumps(ANSWER).encode()))
    np.testing.assert_array_equal(read_cameras(str(stage)).at(1, "y").to_scene, np.eye(4))


def test_what_the_library_prints_and_raises_is_one_line(stage: Path) -> None:
    library(stage.parent, "print('{}')\nos.write(1, b'{}')\nraise RuntimeError('at byte 3\\n' + 9999 * '\\x1b[31m')")
    assert "not a stage of USD, truncated, or damaged (at byte 3" in refusal(stage)


def test_bytes_that_are_no_text_are_damage(tmp_path: Path) -> None:
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    (tmp_path / "shot.usda").write_bytes(b'#usda 1.0\ndef Camera "\xe9t\xe9" {')
    assert "not a stage of USD, truncated, or damaged (ErrorException)" in refusal(tmp_path / "shot.usda")


def test_a_library_that_cannot_be_imported_is_no_damage(stage: Path) -> None:
    library(stage.parent, "pass")
    (stage.parent / "pxr" / "UsdGeom.py").write_text("raise ImportError('libusd.so: too old')", "utf-8")
    assert "Pixar's library cannot be imported (libusd.so: too old); install it again" in refusal(stage)


def test_a_python_that_cannot_be_started_is_no_damage(stage: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    library(stage.parent, "pass")
    monkeypatch.setattr(sys, "executable", None)
    assert "another Python, which cannot be started (sys.executable = None: " in refusal(stage)


def test_the_process_imports_nothing_large_and_nothing_beside_its_script(stage: Path) -> None:
    modules = "[name for name in ('tnst_mi', 'mitsuba', 'numpy', 'torch', 'usd', 'tables') if name in sys.modules]"
    folders = "[folder for folder in sys.path if folder.endswith('cameras')]"
    library(stage.parent, f"raise RuntimeError(str({modules} + {folders}))")
    assert "damaged ([])" in refusal(stage)


def test_ctrl_c_is_left_to_the_one_that_waits(stage: Path) -> None:
    """On a terminal it reaches both; the run may go on, as where a first one only asks it to stop."""
    library(stage.parent, "signal.raise_signal(signal.SIGINT)\nraise RuntimeError('goes on')")
    assert "damaged (goes on)" in refusal(stage)


PROGRAM = """
import sys
sys.path.insert(0, sys.argv[1])
from tnst_mi.cli import main
shot, out = sys.argv[1] + "/shot.usda", sys.argv[1] + "/out"
raise SystemExit(main(["compare", sys.argv[1] + "/smoke.npz", "--camera", shot, "--out", out]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there, Ctrl-C is not sent to one process")
@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_ends_the_process(stage: Path, by: signal.Signals) -> None:
    np.savez(stage.parent / "smoke.npz", density=np.ones((4, 4, 4), np.float32))
    library(stage.parent, f"open({str(stage.parent / 'pid')!r}, 'w').write(str(os.getpid()))\nwhile True:\n    pass")
    with subprocess.Popen([sys.executable, "-c", PROGRAM, stage.parent], stderr=subprocess.PIPE, text=True) as run:
        worker = _process_of(stage.parent / "pid")
        run.send_signal(by)
        _, said = run.communicate(timeout=60)
    assert (run.returncode, said) == (3, "tnst-mi: interrupted\n")
    assert not worker.is_running()


@pytest.mark.skipif(sys.platform == "win32", reason="there, processes have no alarm")
def test_the_process_ends_where_nobody_waits_any_more(stage: Path) -> None:
    """As after a signal that cannot be handled."""
    library(stage.parent, f"open({str(stage.parent / 'pid')!r}, 'w').write(str(os.getpid()))\nwhile True:\n    pass")
    program = (
        f"import sys; sys.path.insert(0, {str(stage.parent)!r})\n"
        "from tnst_mi.io.cameras import reading, usd_process\n"
        f"usd_process._SECONDS = 2.0; reading.read_cameras({str(stage)!r})"
    )
    with subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.DEVNULL) as run:
        worker = _process_of(stage.parent / "pid")
        run.kill()
    _, alive = psutil.wait_procs([worker], timeout=20)
    # Where nobody collects orphans, they remain as zombies.
    alive = [process for process in alive if process.status() != psutil.STATUS_ZOMBIE]
    for process in alive:
        process.kill()
    assert alive == []


def _process_of(file: Path) -> psutil.Process:
    """The process that has written its number into a file."""
    end = time.monotonic() + 60
    while not (file.exists() and file.read_text("ascii")):
        assert time.monotonic() < end
        time.sleep(0.05)
    return psutil.Process(int(file.read_text("ascii")))


def moving(path: Path, first: int, last: int) -> str:
    """A stage whose camera is at (frame, frame², 0) at each frame of a span."""
    pxr_usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    from pxr import Gf, UsdGeom

    stage = pxr_usd.Stage.CreateNew(str(path))
    camera = UsdGeom.Camera.Define(stage, "/main")
    move = camera.AddTranslateOp()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    for frame in range(first, last + 1):
        move.Set(Gf.Vec3d(frame, frame * frame, 0), frame)
    stage.GetRootLayer().Save()
    return str(path)


def test_the_library_is_asked_once_for_a_run_of_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole frames come with the first of them; those between, with the first of the same distance."""
    asked: list[float | None] = []

    def counted(path: Path, name: str | None, frame: float | None) -> usd_process.StageAnswer:
        asked.append(frame)
        return usd_process.ask(path, name, frame)

    monkeypatch.setattr(usd, "ask", counted)
    cameras = read_cameras(moving(tmp_path / "shot.usdc", 5, 304))
    for frame in range(5, 305):
        np.testing.assert_array_equal(cameras.at(frame, "y").to_scene[:3, 3], [frame, frame * frame, 0])
    assert asked == [None]
    for frame in range(5, 304):
        square = (frame**2 + (frame + 1) ** 2) / 2
        np.testing.assert_allclose(cameras.at(frame + 0.5, "y").to_scene[:3, 3], [frame + 0.5, square, 0], rtol=1e-14)
    assert asked == [None, 5.5]
    asked.clear()
    cameras = read_cameras(moving(tmp_path / "long.usdc", -3, 1500))
    for frame in (-3, 996, 997, 1500):
        np.testing.assert_array_equal(cameras.at(frame, "y").to_scene[:3, 3], [frame, frame * frame, 0])
    assert asked == [None, 997.0]


def test_a_file_that_changes_between_two_questions_is_refused(tmp_path: Path) -> None:
    path = moving(tmp_path / "shot.usda", 1, 3)
    cameras = read_cameras(path)
    os.replace(moving(tmp_path / "other.usda", 1, 1), path)
    assert cameras.at(2, "y").to_scene[0, 3] == 2
    with pytest.raises(InputError, match="has changed since it was opened"):
        cameras.at(1.5, "y")
