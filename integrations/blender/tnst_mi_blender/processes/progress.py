"""How far a job has got by its log: runs and batches of tnst-mi, where stderr is no terminal, and installations."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass

#: Such as "frame_0057 octave 2/3:  56% 9/16 [00:01<00:03, iteration 1/4, loss 27.98]".
_ITERATION = re.compile(r"(?:(.*) )?octave (\d+/\d+): +(\d+)% (\d+)/(\d+) \[[\d:]+<([\d:]+)[,\]]")

#: Such as "batch: run 2 of 3, about 1 min left: soft on jet".
_RUN = re.compile(r"batch: run (\d+) of (\d+)")

#: Such as "Collecting torch>=2.6 (from tnst_mi==0.1.0)" and "Downloading torch-2.13.0-cp311-….whl (915.6 MB)".
_COLLECTING = re.compile(r"Collecting ([\w.-]+)")
_DOWNLOADING = re.compile(r"(?:Downloading|Using cached) ([\w.]+)-\S+ \((.+)\)")


@dataclass(frozen=True)
class Progress:
    """How far a job has got.

    Attributes:
        fraction: of its work, 0 to 1; None while that is not known.
        doing: what it is at, such as "octave 2/3, frame 12, 40%".
        left: the time that is left, such as "1:20"; empty where it is not known.
    """

    fraction: float | None
    doing: str
    left: str = ""

    @property
    def text(self) -> str:
        """One short line for a status bar, such as "octave 2/3, frame 12, 40%, 1:20 left"."""
        return f"{self.doing}, {self.left} left" if self.left else self.doing


class ProgressReader:
    """Follows the lines of a log.

    Args:
        clock: seconds that pass.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._run, self._runs = 1, 1
        self._begin("starting")

    def read(self, line: str) -> None:
        """Take note of a line."""
        if found := _RUN.match(line):
            self._run, self._runs = int(found[1]), int(found[2])
            self._begin("starting")
        elif found := _ITERATION.match(line):
            name, octave, percent, done, total, left = found.groups()
            self._text = f"octave {octave}, {_frame(name)}{percent}%"
            self._share = int(done) / max(1, int(total))
            self._ends = self._clock() + _seconds(left)
            if done == total:
                self._text, self._ends = "writing results", None
        elif self._share is None and line.startswith("device: "):
            self._text = "reading the smoke"

    def progress(self) -> Progress:
        """How far it has got by what was read; the time left goes on between two lines."""
        run = f"run {self._run}/{self._runs}, " if self._runs > 1 else ""
        known = self._share is not None or self._run > 1
        fraction = (self._run - 1 + (self._share or 0.0)) / self._runs if known else None
        left = "" if self._ends is None else _clock_text(self._ends - self._clock())
        return Progress(fraction, f"{run}{self._text}", left)

    def _begin(self, text: str) -> None:
        self._text = text
        self._share: float | None = None
        self._ends: float | None = None


class InstallationReader:
    """Follows the lines of an installation, of which nobody knows beforehand how many packages it will download."""

    def __init__(self) -> None:
        self._text = "starting"

    def read(self, line: str) -> None:
        """Take note of a line."""
        if found := _DOWNLOADING.match(line):
            self._text = f"downloading {found[1]} ({found[2]})"
        elif found := _COLLECTING.match(line):
            self._text = f"looking for {found[1]}"
        elif line.startswith("Installing collected packages: "):
            self._text = f"installing {line.count(',') + 1} packages, this takes a while"
        elif line in ("making the environment", "trying it"):
            self._text = line

    def progress(self) -> Progress:
        """What it is doing."""
        return Progress(None, self._text)


def _frame(name: str | None) -> str:
    """What an artist calls a frame: its number, where its file's name ends in one."""
    if not name:
        return ""
    number = re.search(r"(\d+)$", name)
    return f"frame {int(number[1])}, " if number else f"{name}, "


def _seconds(text: str) -> float:
    """Of a time such as 01:20 or 1:02:03."""
    total = 0
    for part in text.split(":"):
        total = total * 60 + int(part)
    return float(total)


def _clock_text(seconds: float) -> str:
    """A time such as 1:20 or 1:02:03."""
    minutes, rest = divmod(max(0, round(seconds)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
