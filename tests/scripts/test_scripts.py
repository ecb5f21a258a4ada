"""Every script can be imported and explains itself."""

from __future__ import annotations

import runpy
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"

#: Blender runs this one, with a Python of its own.
IN_BLENDER = {"blender_bake.py"}


@pytest.mark.parametrize("script", sorted(path.name for path in SCRIPTS.glob("*.py")))
def test_help(script: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    if script in IN_BLENDER:
        pytest.importorskip("bpy", reason="runs inside Blender, whose module bpy is not here")
    monkeypatch.setattr(sys, "argv", [script, "--help"])
    with pytest.raises(SystemExit) as stop:
        runpy.run_path(str(SCRIPTS / script), run_name="__main__")
    told = capsys.readouterr().out
    assert stop.value.code == 0 and "usage:" in told.lower()
    assert (SCRIPTS / script).read_text("utf-8").count(f"scripts/{script}") >= 1, "its docstring shows how it is called"


@pytest.mark.parametrize("script", sorted(IN_BLENDER))
def test_what_blender_runs_says_so(script: str) -> None:
    if find_spec("bpy"):
        pytest.skip("bpy is here")
    ran = subprocess.run([sys.executable, SCRIPTS / script, "--help"], capture_output=True, text=True, check=False)
    assert ran.returncode == 2
    assert ran.stderr.splitlines() == [f"{script}: runs inside Blender: blender -b -P scripts/{script} -- --help"]
