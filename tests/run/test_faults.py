"""Every write of a run fails once, or the process dies there: one line, no half file, and the same bits after --resume.

The suite takes every seventh write, each with another error; all of them with all errors (TNST_MI_EVERY_FAULT=1) take
a quarter of an hour.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import Run, run, tiny_weights
from faults import Writes, copied, plain_pictures, results, unfinished
from moving_smoke import moving_smoke

from tnst_mi.cli import main
from tnst_mi.io import save_frames

__all__ = ["run", "tiny_weights"]

ERRORS = [errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS, errno.EACCES]

#: Writes of the run below: 2 to begin, 13 for each octave, 10 for each frame, 4 to end.
WRITES = 2 + 2 * 13 + 2 * 10 + 4

EVERY = bool(os.environ.get("TNST_MI_EVERY_FAULT"))
FAULTS = (
    [(number, error) for number in range(1, WRITES + 1) for error in ERRORS]
    if EVERY
    else [(number, ERRORS[number % len(ERRORS)]) for number in range(1, WRITES + 1, 7)]
)
DEATHS = range(1, WRITES + 1, 1 if EVERY else 7)


@pytest.fixture(autouse=True)
def quick() -> Iterator[None]:
    with plain_pictures():
        yield


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory, tiny_weights: Path) -> list[str]:
    """The arguments of the run, without its folder: two frames, a window of 3, two octaves."""
    folder = tmp_path_factory.mktemp("input")
    save_frames(folder / "smoke", moving_smoke(2))
    goal = ["--semantic", "inception_3a/3x3:2", "--octaves", "2", "--iterations", "1", "--views", "1"]
    kept = ["--window", "3", "--coherence", "1", "--lam", "0.5", "--weights", str(tiny_weights)]
    return ["stylize", str(folder / "smoke"), *goal, *kept, "--out"]


@pytest.fixture(scope="module")
def undisturbed(begun: list[str], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any], list[str]]:
    """What every write left of a run that nothing disturbed, its results, and the names of what it wrote."""
    folder = tmp_path_factory.mktemp("undisturbed")
    out, left = folder / "out", folder / "left"
    writes = Writes(seen=lambda number, when: copied(out, left / f"{number}-{when}"))
    with plain_pictures(), writes.counted():
        assert main([*begun, str(out)]) == 0
    return left, results(out), writes.names


def test_all_writes_are_counted(undisturbed: tuple[Path, dict[str, Any], list[str]]) -> None:
    _, _, names = undisturbed
    assert len(names) == WRITES
    assert names[:2] == ["recipe.toml", "run.json"] and names[-1] == "run.json"
    assert names.count("metrics.jsonl") == 2 * 2 + 2 and names.count("numbers.json") == 2
    assert {"preview.mp4", "contact_sheet.png", "sequence.png", "s_005.npz", "s_005_loss.png"} < set(names)


@pytest.mark.parametrize(("number", "error"), FAULTS)
def test_a_write_that_fails_stops_the_run(
    number: int,
    error: int,
    run: Run,
    begun: list[str],
    undisturbed: tuple[Path, dict[str, Any], list[str]],
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"
    with Writes(number, error).counted() as writes:
        ran = run(*begun, out)
    assert len(writes.names) >= number and ran.code == 3
    told = [line for line in ran.errors if line.startswith("tnst-mi: ")]
    assert told == ran.errors[-1:] and "go on with --resume, nothing is lost" in told[0]
    reason = {errno.ENOSPC: "the disk is full", errno.EDQUOT: "the quota of its disk is used up"}
    assert reason.get(error, os.strerror(error)) in told[0] and "Traceback" not in "".join(ran.errors)
    assert unfinished(out) == [] and not list(out.rglob(".*.[0-9]*.*"))
    assert run(*begun, out, "--resume").code == 0
    assert results(out) == undisturbed[1]


@pytest.mark.parametrize("when", ["before", "after"])
@pytest.mark.parametrize("number", DEATHS)
def test_a_process_that_dies_at_a_write_can_be_resumed(
    number: int,
    when: str,
    run: Run,
    begun: list[str],
    undisturbed: tuple[Path, dict[str, Any], list[str]],
    tmp_path: Path,
) -> None:
    """What it leaves is a copy of the folder at that moment, unfinished files and the lock included."""
    out = tmp_path / "out"
    shutil.copytree(undisturbed[0] / f"{number}-{when}", out)
    assert unfinished(out) == [] and (out / ".lock").exists()
    assert run(*begun, out, "--resume").code == 0
    assert results(out) == undisturbed[1]
