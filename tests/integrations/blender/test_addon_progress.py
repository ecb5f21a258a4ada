"""Progress as the Blender add-on reads it, of what tnst-mi really writes."""

from __future__ import annotations

import io
import sys

import blender_addon  # noqa: F401  (makes tnst_mi_blender importable)
import pytest
from tnst_mi_blender.processes.progress import InstallationReader, ProgressReader

from tnst_mi.optimisation.result import Progress
from tnst_mi.run.progress import ProgressBar
from tnst_mi.run.time_left import OctaveSize


class Clock:
    """Seconds that pass as told."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def log_of(monkeypatch: pytest.MonkeyPatch, frame: str, done: int, total: int) -> list[str]:
    """What a run writes on a stream that is no terminal when it has done so many iterations of ten in each octave."""
    log = io.StringIO()
    monkeypatch.setattr(sys, "stderr", log)
    bar = ProgressBar(True, [OctaveSize(1000, 1000, 10)] * 2, 1000, 1)
    for number in range(done):
        bar.advance(
            Progress(
                frame=frame, octave=number // 10, octaves=2, iteration=number % 10, iterations=10, loss=0.5,
                terms={}, done=number + 1, total=total, workers=0,
            )
        )  # fmt: skip
    bar.close()
    return log.getvalue().splitlines()


@pytest.mark.parametrize(
    ("frame", "name"), [("frame_0012", "frame 12"), ("fluid_data_0120", "frame 120"), ("veil", "veil")]
)
def test_an_iteration_is_read_as_it_is_written(monkeypatch: pytest.MonkeyPatch, frame: str, name: str) -> None:
    lines = log_of(monkeypatch, frame, 15, 20)
    reader = ProgressReader(Clock())
    for line in lines:
        reader.read(line)
    progress = reader.progress()
    assert progress.fraction == 0.75
    assert progress.text.startswith(f"octave 2/2, {name}, 75%, 0:0") and progress.text.endswith(" left")


def test_at_the_end_results_are_written(monkeypatch: pytest.MonkeyPatch) -> None:
    reader = ProgressReader(Clock())
    for line in log_of(monkeypatch, "frame_0012", 20, 20):
        reader.read(line)
    assert (reader.progress().fraction, reader.progress().text) == (1.0, "writing results")


def test_the_time_left_goes_on_between_lines() -> None:
    clock = Clock()
    reader = ProgressReader(clock)
    reader.read("frame_0057 octave 2/3:  40% 24/60 [00:10<1:02:03, iteration 4/20, loss 27.98]")
    texts = []
    for clock.now in (0.0, 3.0, 3600.0, 9999.0):
        texts.append(reader.progress().text.removeprefix("octave 2/3, frame 57, 40%, "))
    assert texts == ["1:02:03 left", "1:02:00 left", "2:03 left", "0:00 left"]


def test_before_the_first_iteration_nothing_is_guessed() -> None:
    reader = ProgressReader(Clock())
    assert (reader.progress().fraction, reader.progress().text) == (None, "starting")
    for line in ("device: CPU, 2 threads (llvm_ad_rgb)", "memory: about 0.5 GB", "", "a \x1b[31m octave of whales"):
        reader.read(line)
    assert (reader.progress().fraction, reader.progress().text) == (None, "reading the smoke")


def test_the_fraction_of_a_batch_is_that_of_all_its_runs() -> None:
    """The line is one of `tnst-mi batch`, which test_addon_runs.py reads from a real one too."""
    reader = ProgressReader(Clock())
    reader.read("batch: run 3 of 4, about 1 min left: soft on jet")
    assert (reader.progress().fraction, reader.progress().text) == (0.5, "run 3/4, starting")
    reader.read("f_1 octave 1/1:  50% 5/10 [00:10<00:10, iteration 5/10, loss 1]")
    assert (reader.progress().fraction, reader.progress().text) == (
        0.625,
        "run 3/4, octave 1/1, frame 1, 50%, 0:10 left",
    )


def test_an_installation_says_what_it_does() -> None:
    """Lines of pip 23 and 25, which test_addon_environment.py reads from a real installation too."""
    reader, texts = InstallationReader(), []
    for line in (
        "making the environment",
        "Processing /zip/carried/tnst_mi-0.1.0-py3-none-any.whl",
        "Collecting torch>=2.6",
        "Downloading torch-2.13.0-cp311-none-manylinux_2_28_x86_64.whl (887.9 MB)",
        "Using cached numpy-2.4.6-cp311-cp311-manylinux_2_27_x86_64.whl (16.6 MB)",
        "Installing collected packages: mpmath, typing-extensions, sympy",
        "trying it",
    ):
        reader.read(line)
        texts.append(reader.progress().text)
    assert texts == [
        "making the environment",
        "making the environment",
        "looking for torch",
        "downloading torch (887.9 MB)",
        "downloading numpy (16.6 MB)",
        "installing 3 packages, this takes a while",
        "trying it",
    ]
    assert reader.progress().fraction is None
