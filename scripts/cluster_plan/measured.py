"""What was measured of the tasks of a run: their times, and the bytes that they read and write."""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError, naming

#: Kinds of tasks, as runs name them, with a window and without.
WINDOWED = ("inputs", "fields", "gain", "scales", "step", "average", "finish")
ALONE = ("inputs", "fields", "scales", "iterate", "finish")

_REQUIRED = {True: ("inputs", "fields", "step", "average"), False: ("inputs", "fields", "iterate")}
_SECONDS = ("prepare_seconds", "conclude_seconds", "coordinator_seconds", "scheduler_seconds", "latency_seconds")
_KEYS = ("window", "iterations", *_SECONDS, "tasks")
_COSTS = ("seconds", "bytes_read", "bytes_written", "first_seconds")


@dataclass(frozen=True)
class Cost:
    """What one task costs.

    Attributes:
        seconds: on a core of its own.
        bytes_read: by a task whose window is whole, if its worker has nothing yet; None for all of the items that it
            needs, of which it may read a part only.
        bytes_written: into the shared folder.
        first_seconds: in place of `seconds`, of the first one that a worker does, for which it loads libraries and
            compiles kernels; None if that takes no longer.
    """

    seconds: float
    bytes_read: float | None = None
    bytes_written: float = 0.0
    first_seconds: float | None = None


@dataclass(frozen=True)
class Measured:
    """What was measured of a run.

    Attributes:
        window: frames in a window, odd; 1 where each frame is stylized by itself.
        iterations: of each octave.
        costs: by kind and octave; those of "finish" by the last octave.
        prepare_seconds: what the coordinator does before the first task.
        conclude_seconds: what it does after the last.
        coordinator_seconds: what it does before or after them for each frame, beside that.
        scheduler_seconds: what scheduler and coordinator, which do one thing at a time, compute for each task.
        latency_seconds: from the end of a task, as the scheduler knows it, to the start of one that waited for it.
    """

    window: int
    iterations: tuple[int, ...]
    costs: dict[tuple[str, int], Cost]
    prepare_seconds: float = 0.0
    conclude_seconds: float = 0.0
    coordinator_seconds: float = 0.0
    scheduler_seconds: float = 0.0
    latency_seconds: float = 0.0

    def serial_seconds(self, frames: int) -> float:
        """What the coordinator does while there are no tasks."""
        return self.prepare_seconds + self.conclude_seconds + frames * self.coordinator_seconds

    def has(self, kind: str, octave: int) -> bool:
        """Whether there are tasks of a kind in an octave."""
        return (kind, octave) in self.costs

    def cost(self, kind: str, octave: int) -> Cost:
        """What a task of a kind costs in an octave: nothing, where there are none."""
        return self.costs.get((kind, octave), Cost(0.0))


def read_measured(path: Path) -> Measured:
    """Read a file of measurements, TOML or JSON by the end of its name; see `scripts/plan_cluster.py`.

    Raises:
        InputError: it is neither, or a key or value in it cannot be used.
        OSError: it cannot be read.
    """
    parsers = {".toml": tomllib.loads, ".json": json.loads}
    if path.suffix not in parsers:
        raise InputError(f"{path}: expected measurements in a file whose name ends in .toml or .json")
    with naming(path):
        try:
            found = parsers[path.suffix](path.read_text("utf-8"))
        except (ValueError, RecursionError) as error:
            raise InputError(f"not valid {path.suffix[1:].upper()} ({error})") from None
        return measured_of(found)


def measured_of(found: Any) -> Measured:
    """The measurements that the values of a file stand for.

    Raises:
        InputError: a key or value cannot be used.
    """
    _require_keys("the file", found, _KEYS, ("window", "iterations", "tasks"))
    window, iterations, tasks = found["window"], found["iterations"], found["tasks"]
    if type(window) is not int or window < 1 or window % 2 == 0:
        raise InputError(f"window = {window!r}: expected an odd number, 1 where there is no window")
    if not isinstance(iterations, list) or not iterations or any(type(n) is not int or n < 1 for n in iterations):
        raise InputError(f"iterations = {iterations!r}: expected a list of numbers of 1 or more, one of each octave")
    _require_keys("tasks", tasks, WINDOWED if window > 1 else ALONE, _REQUIRED[window > 1])
    costs = {}
    for kind, entries in tasks.items():
        octaves = range(len(iterations))[-1:] if kind == "finish" else range(len(iterations))
        if not isinstance(entries, list) or len(entries) != len(octaves):
            raise InputError(f"tasks.{kind}: expected a list of {len(octaves)}, {_each(kind)}")
        for octave, entry in zip(octaves, entries, strict=True):
            _require_keys(f"tasks.{kind}", entry, _COSTS, ("seconds",))
            costs[kind, octave] = Cost(**{key: _amount(f"tasks.{kind}: {key}", entry[key]) for key in entry})
    others = {key: _amount(key, found[key]) for key in _SECONDS if key in found}
    return Measured(window, tuple(iterations), costs, **others)


def _each(kind: str) -> str:
    return "since frames are finished once" if kind == "finish" else "an entry for each octave"


def _require_keys(where: str, found: Any, known: tuple[str, ...], required: tuple[str, ...]) -> None:
    """Check that something is a table that has all keys that it needs, and no others than it may have.

    Raises:
        InputError: it is not.
    """
    if not isinstance(found, dict):
        raise InputError(f"{where}: expected a table with {', '.join(required)}")
    for key in found:
        if key not in known:
            raise InputError(f"{where}: unknown key {key!r}; known are {', '.join(known)}")
    for key in required:
        if key not in found:
            raise InputError(f"{where}: {key} is missing")


def _amount(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value < 0:
        raise InputError(f"{name} = {value!r}: expected a number of 0 or more")
    return float(value)
