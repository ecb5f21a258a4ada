"""Running commands in this process: fixtures for their tests, and what every refusal must look like."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from jobs import frames
from networks import random_googlenet

from tnst_mi.cli import main
from tnst_mi.io import save_frames


@dataclass
class Ran:
    """What a command answered."""

    code: int
    out: str
    errors: list[str]


Run = Callable[..., Ran]


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Run:
    """Run a command line in this process, catching what it and the libraries below it print."""

    def run_(*arguments: object) -> Ran:
        capfd.readouterr()
        code = main([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        return Ran(code, out, err.splitlines())

    return run_


@pytest.fixture
def smoke(tmp_path: Path) -> Path:
    """A folder with three frames, 7 to 9."""
    save_frames(tmp_path / "smoke", frames(0.2, 0.4, 0.3))
    return tmp_path / "smoke"


@pytest.fixture(scope="session")
def tiny_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A GoogLeNet of random weights, an eighth as wide as the real one."""
    return random_googlenet(tmp_path_factory.mktemp("weights") / "tiny.safetensors", narrow=8)


def refused(run: Run, folder: Path, arguments: list[object], message: str) -> None:
    """The command ends with code 2, one line on stderr, nothing on stdout, and no trace in the folder."""
    before = sorted(folder.rglob("*"))
    ran = run(*arguments)
    assert ran.code == 2
    assert ran.out == ""
    assert len(ran.errors) == 1, ran.errors
    assert ran.errors[0].startswith("tnst-mi: ")
    assert re.search(message, ran.errors[0]), ran.errors[0]
    assert sorted(folder.rglob("*")) == before
