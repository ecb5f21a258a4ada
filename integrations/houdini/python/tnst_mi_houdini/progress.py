"""What tnst-mi prints, as progress: its lines in logs, and the line that says what was wrong."""

from __future__ import annotations

import re
from dataclasses import dataclass

# A line of progress: "frame 3 octave 1/2: 40% 16/40 [00:10<00:15, iteration 4/20, loss 0.12]".
_PROGRESS = re.compile(r"(?P<what>.*?): +(?P<percent>\d{1,3})%.*?\d+/\d+ \[(?P<elapsed>[\d:.]+)<(?P<left>[\d:.?]+)")

#: How lines begin that say why a run has ended.
ERROR = "tnst-mi: "


@dataclass(frozen=True)
class Progress:
    """How far a run has got.

    Attributes:
        fraction: of its work, 0 to 1.
        text: one short line for a status bar, such as "frame 3 octave 1/2, 40%, 00:15 left".
    """

    fraction: float
    text: str


def progress_of(line: str) -> Progress | None:
    """The progress that a line of tnst-mi tells; None for other lines.

    Example:
        >>> progress_of("frame 3 octave 1/2:  40% 16/40 [00:10<00:15, iteration 4/20, loss 0.12]")
        Progress(fraction=0.4, text='frame 3 octave 1/2, 40%, 00:15 left')
    """
    found = _PROGRESS.search(line)
    if found is None:
        return None
    percent = min(int(found["percent"]), 100)
    return Progress(percent / 100, f"{found['what'].strip()}, {percent}%, {found['left']} left")


def error_of(log: str) -> str | None:
    """The last line of a log that says what was wrong, without the program's name; None if there is none."""
    lines = [line for line in log.splitlines() if line.startswith(ERROR)]
    return lines[-1][len(ERROR) :] if lines else None
