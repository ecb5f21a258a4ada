"""Nothing reaches for the network unless it is asked to: the path of the README, with every socket denied."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from jobs import frames

from tnst_mi.io import save_frames

ROOT = Path(__file__).resolve().parents[1]

# An audit hook sees every use of sockets by Python code, however it is imported. It is installed before the package is,
# and writes down what it denies, since the exception could be caught.
GUARD = """
import os, sys

def deny(event, arguments):
    if event in ("socket.connect", "socket.getaddrinfo", "socket.gethostbyname", "socket.sendto", "socket.bind"):
        with open(os.environ["DENIED"], "a") as file:
            file.write(f"{event} {arguments[1:] if event == 'socket.connect' else arguments}\\n")
        raise OSError("the network is denied")

sys.addaudithook(deny)
"""


@pytest.fixture
def offline(tmp_path: Path) -> dict[str, str]:
    """The environment of a process without network, weights and earlier settings."""
    (tmp_path / "guard").mkdir()
    (tmp_path / "guard" / "sitecustomize.py").write_text(GUARD)
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("TNST_MI_", "XDG_"))}
    path = os.pathsep.join(map(str, (tmp_path / "guard", ROOT)))
    return kept | {"PYTHONPATH": path, "HOME": str(tmp_path), "DENIED": str(tmp_path / "denied")}


def run(environment: dict[str, str], folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tnst_mi", *map(str, arguments)]
    return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, check=False)


def test_the_path_of_the_readme_uses_no_network(offline: dict[str, str], tmp_path: Path) -> None:
    """The demo's recipe, for a frame that is small enough for a test."""
    recipe = ROOT / "scenes" / "suzanne" / "recipe.toml"
    save_frames(tmp_path / "smoke.npz", frames(0.3)[0])
    short = ("--octaves", 1, "--iterations", 1, "--views", 1)
    for arguments in (
        ("info", "smoke.npz"),
        ("weights",),
        ("stylize", "smoke.npz", "--recipe", recipe, "--out", "out", *short),
    ):
        ran = run(offline, tmp_path, *arguments)
        assert ran.returncode == 0, ran.stderr
    assert (tmp_path / "out" / "images" / "smoke_comparison.png").is_file()
    assert not (tmp_path / "denied").exists(), (tmp_path / "denied").read_text()


def test_the_guard_sees_a_download_that_is_asked_for(offline: dict[str, str], tmp_path: Path) -> None:
    ran = run(offline, tmp_path, "weights", "--download", "inception5h")
    assert ran.returncode == 2
    (line,) = ran.stderr.splitlines()
    assert "inception5h weights: no download" in line and "the network is denied" in line
    assert "getaddrinfo" in (tmp_path / "denied").read_text()
