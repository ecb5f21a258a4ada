"""How long an iteration takes, and how many of them take equally long."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import Any

#: Differences of the time of an iteration up to which variants count as equally fast: the clock is not more exact.
_SAME_SPEED = 0.05


def equal_time(seconds: Mapping[str, float], first: str, iterations: int) -> dict[str, int]:
    """Iterations, 1 or more, by variant, that take as long as some of the first one; see `_SAME_SPEED`."""
    found = {}
    for name, of_one in seconds.items():
        ratio = seconds[first] / of_one
        found[name] = iterations if abs(ratio - 1) <= _SAME_SPEED else max(1, round(iterations * ratio))
    return found


def seconds_per_iteration(history: Sequence[Mapping[str, Any]]) -> float:
    """The time of one iteration in every octave, by the medians of each but the first, which compiles."""
    octaves = sorted({entry["octave"] for entry in history})
    of_octaves = [[e["seconds"] for e in history if e["octave"] == o and e["iteration"] > 0] for o in octaves]
    return sum(statistics.median(seconds) for seconds in of_octaves)
