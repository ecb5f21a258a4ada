"""How far a run has got: the losses of its iterations as they come, and the time that is left."""

from __future__ import annotations

import json
import math
import os
from collections import defaultdict
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Shape
from tnst_mi.run.folder import DAMAGE, WORK
from tnst_mi.run.time_left import TimeLeft, octave_sizes
from tnst_mi.studio.plain import opened_plain, plain_json, plain_recipe

#: Bytes that are read of a log at a time, at most.
_CHUNK = 1 << 20

#: What no octave, no iteration and no loss reaches: means of larger ones would not be finite, and curves show nothing.
_OCTAVES, _ITERATIONS, _LOSSES = 100, 10**9, 1e100


class LiveRun:
    """What the log of a run tells, read as it grows.

    Args:
        folder: of the run.
        recipe_file: its recipe.
        shape: (D, H, W) of its frames.
    """

    def __init__(self, folder: Path, recipe_file: Path, shape: Shape) -> None:
        self._folder, self._recipe_file, self._shape = folder, recipe_file, shape
        #: By iteration and frame, once each: a resumed run may repeat the last one.
        self._losses: dict[tuple[int, int], dict[str, float]] = defaultdict(dict)
        self._read: dict[Path, int] = {}
        self._time_left: TimeLeft | None = None
        self._left: float | None = None
        self._total: int | None = None
        self._skipped, self._timed = 0, False

    @property
    def losses(self) -> list[float]:
        """The mean over the frames of each iteration, in order."""
        return [sum(of.values()) / len(of) for _, of in sorted(self._losses.items())]

    @property
    def octaves(self) -> list[int]:
        """The octave of each of these."""
        return [octave for octave, _ in sorted(self._losses)]

    @property
    def reached(self) -> tuple[int, int] | None:
        """The octave that has been reached, from 0, and the iterations that are done in it; None before the first."""
        if not self._losses:
            return None
        octave, iteration = max(self._losses)
        return octave, iteration + 1

    @property
    def done(self) -> int:
        """Iterations of all frames that are done, those of the run that this one goes on from included."""
        return self._skipped + sum(len(of) for of in self._losses.values())

    @property
    def total(self) -> int | None:
        """Iterations of all frames; None as long as the run has not begun."""
        return self._total

    @property
    def left(self) -> float | None:
        """Seconds left; None while they cannot be told."""
        return self._left

    def update(self) -> bool:
        """Read what is new; whether there was something."""
        before = self.done
        logs = [self._folder / WORK / "metrics.jsonl", self._folder / "metrics.jsonl"]
        for log in [*logs, *sorted((self._folder / WORK).glob("log/*.jsonl"))]:
            self._read_on(log)
        if self._total is None and self._losses:
            self._plan()
            return True
        changed = self.done != before
        if changed and self._time_left is not None and self._total is not None:
            left = self._time_left.after(self.octaves[-1], min(self.done, self._total), self._total)
            # The first time tells only when looking on began, not how long an iteration takes.
            self._left, self._timed = left if self._timed else None, True
        return changed

    def _read_on(self, log: Path) -> None:
        """Read the lines that have been added to a log since it was read last."""
        try:
            with opened_plain(log) as opened:
                size, begin = os.fstat(opened.fileno()).st_size, self._read.get(log, 0)
                if size < begin:  # it was written anew
                    begin = 0
                if size == begin:
                    return
                opened.seek(begin)
                added = opened.read(_CHUNK)
        except OSError:
            return
        # The working log has its line breaks first: its last line is whole if it can be read, and is read once more.
        self._read[log] = begin + max(added.rfind(b"\n"), 0)
        for line in added.splitlines():
            self._take(line[line.find(b"{") :])

    def _take(self, line: bytes) -> None:
        try:
            entry: Any = json.loads(line)
            octave, iteration, loss = int(entry["octave"]), int(entry["iteration"]), float(entry["loss"])
            frame = str(entry["frame"])
        except (ValueError, LookupError, TypeError, RecursionError, OverflowError):
            return
        sound = math.isfinite(loss) and abs(loss) < _LOSSES
        if sound and 0 <= octave < _OCTAVES and 0 <= iteration < _ITERATIONS:
            self._losses[octave, iteration][frame] = loss

    def _plan(self) -> None:
        """What there is to do, from the recipe and run.json."""
        try:
            sizes = octave_sizes(plain_recipe(self._recipe_file), self._shape)
            run = plain_json(self._folder / "run.json")
            frames, earlier = len(run["inputs"]), run.get("from")
            if earlier is not None:
                done = [size.iterations for size in sizes[: int(earlier["octave"])]]
                self._skipped = frames * (sum(done) + int(earlier["iterations"]))
        except (InputError, *DAMAGE):
            return
        d, h, w = self._shape
        self._total = frames * sum(size.iterations for size in sizes)
        self._time_left = TimeLeft(sizes, d * h * w, frames)
