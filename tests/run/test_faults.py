"""Every write of a run fails once, or the process dies there: one line, no half file, and the same bits after --resume.

The suite takes every seventh write, each with another error; all of them with all errors (TNST_MI_EVERY_FAULT=1) take
half an hour or more.
"""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

import pytest
from command_line import Run, run, tiny_weights
from faults import Undisturbed, Writes, begun, quick, results, undisturbed, unfinished

__all__ = ["begun", "quick", "run", "tiny_weights", "undisturbed"]

ERRORS = [errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS, errno.EACCES, errno.EFBIG]

#: Writes of the run below: 2 to begin, 13 for each octave, 7 pictures in between, 11 for each frame, 4 to end.
WRITES = 2 + 2 * 13 + 7 + 2 * 11 + 4

EVERY = bool(os.environ.get("TNST_MI_EVERY_FAULT"))
FAULTS = (
    [(number, error) for number in range(1, WRITES + 1) for error in ERRORS]
    if EVERY
    else [(number, ERRORS[number % len(ERRORS)]) for number in range(1, WRITES + 1, 7)]
)
DEATHS = range(1, WRITES + 1, 1 if EVERY else 7)


def test_all_writes_are_counted(undisturbed: Undisturbed) -> None:
    names = undisturbed.names
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
    undisturbed: Undisturbed,
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"
    with Writes(number, error).counted() as writes:
        ran = run(*begun, out)
    assert len(writes.names) >= number and ran.code == 3
    told = [line for line in ran.errors if line.startswith("tnst-mi: ")]
    assert told == ran.errors[-1:] and "go on with --resume, nothing is lost" in told[0]
    reason = {errno.ENOSPC: "the disk is full", errno.EDQUOT: "the quota of its disk is used up"}
    reason[errno.EFBIG] = "a file is larger than the limit on file sizes; raise it (ulimit -f) and go on"
    assert reason.get(error, os.strerror(error)) in told[0] and "Traceback" not in "".join(ran.errors)
    assert unfinished(out) == [] and not list(out.rglob(".*.[0-9]*.*"))
    assert run(*begun, out, "--resume").code == 0
    assert results(out) == undisturbed.results


@pytest.mark.parametrize("when", ["before", "after"])
@pytest.mark.parametrize("number", DEATHS)
def test_a_process_that_dies_at_a_write_can_be_resumed(
    number: int,
    when: str,
    run: Run,
    begun: list[str],
    undisturbed: Undisturbed,
    tmp_path: Path,
) -> None:
    """What it leaves is a copy of the folder at that moment, unfinished files and the lock included."""
    out = tmp_path / "out"
    shutil.copytree(undisturbed.left / f"{number}-{when}", out)
    assert unfinished(out) == [] and (out / ".lock").exists()
    assert run(*begun, out, "--resume").code == 0
    assert results(out) == undisturbed.results
