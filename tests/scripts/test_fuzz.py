"""Damaged files of every format give one line each, in bounded time and memory; and the fuzzer finds what does not."""

from __future__ import annotations

import itertools
import random
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path

import fuzz
import numpy as np
import pytest
from fuzzing import corpus
from fuzzing.mutations import mutated
from fuzzing.readers import READERS, Reader
from fuzzing.trials import trial
from fuzzing.workers import Worker

from tnst_mi.errors import InputError

INPUTS = 200

#: Of readers that start a process for each.
FEW = {"usd": 10, "usdz": 10}

#: Readers that leave out what is damaged, and go on with the rest.
LENIENT = ("log", "atlas")


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    worker = Worker()
    yield worker
    worker.close()


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_give_one_line(name: str, worker: Worker, tmp_path: Path) -> None:
    inputs = FEW.get(name, INPUTS)
    tally = fuzz.fuzzed(name, inputs, None, 0, tmp_path / "out", worker)
    said = "".join(path.read_text("utf-8") for path in tmp_path.glob("out/*.txt"))
    assert not tally.faults, said
    assert tally.inputs == inputs
    # If all were refused or none, damage would not reach what it is meant for.
    assert tally.refused == 0 if name in LENIENT else 0.3 * inputs < tally.refused < inputs


@pytest.mark.parametrize("name", READERS)
def test_undamaged_files_are_read(name: str, tmp_path: Path) -> None:
    """But for those that are in the corpus since they are refused."""
    files = READERS[name].corpus(tmp_path)
    read = 0
    for content in files:
        found = trial(name, content, tmp_path)
        assert not found.faults
        read += not found.refused
    assert read >= len(files) / 2


def test_an_input_is_decided_by_seed_and_number() -> None:
    one, again, other = ([*itertools.islice(fuzz.inputs("uni", seed), 20)] for seed in (1, 1, 2))
    assert one == again and one != other


def test_damage_inside_of_archives_has_right_checksums(tmp_path: Path) -> None:
    data = corpus.npz({"density": np.arange(240.0).reshape(6, 8, 5)})
    read = 0
    for seed in range(300):
        (tmp_path / "a.npz").write_bytes(mutated(data, [data], random.Random(seed)))
        try:
            with np.load(tmp_path / "a.npz") as archive:
                read += not np.array_equal(archive["density"].ravel(), np.arange(240.0))
        except Exception:
            continue
    assert read > 20


def _raise(error: Exception) -> None:
    raise error


@pytest.mark.parametrize(
    ("fault", "read"),
    [
        ("exception", lambda path: _raise(zlib.error("bad"))),
        ("message", lambda path: _raise(InputError("a" * 301))),
        ("message", lambda path: _raise(InputError("a\x1b[31mb"))),
        ("memory", lambda path: np.ones(110_000_000, np.uint8)),
        ("time", lambda path: sum(range(100_000_000))),
        ("output", lambda path: print("\x1b[31m")),
        ("output", lambda path: print("n" * 1001)),
    ],
)
def test_faults_are_found(fault: str, read: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if fault == "memory" and sys.platform != "linux":
        pytest.skip("the peak of memory cannot be reset on this system, and the process may have been there before")
    monkeypatch.setattr("fuzzing.trials.MOST_MEMORY", 100_000_000)
    monkeypatch.setattr("fuzzing.trials.LONGEST_TIME", 0.5)
    monkeypatch.setitem(READERS, "bad", Reader("a", lambda folder: [b""], read))  # pyright: ignore[reportArgumentType]
    assert [*trial("bad", b"", tmp_path).faults] == [fault]


def test_a_process_that_dies_is_a_fault_and_the_next_read_goes_on(
    worker: Worker,
) -> None:
    worker.read("toml", b"seed = 3")
    assert worker._process is not None
    worker._process.kill()
    assert [*worker.read("toml", b"seed = 3").faults] == ["crash"]
    assert not worker.read("toml", b"seed = 3").refused
