"""All frames, one after the other: where each starts from, what is shown and written meanwhile, and in the end."""

from __future__ import annotations

import math
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.fields.advection import advect
from tnst_mi.io.formats import read_stored
from tnst_mi.machine.interrupt import Interrupt
from tnst_mi.reconstruction.descent import Descent
from tnst_mi.reconstruction.one_frame import FrameReconstruction
from tnst_mi.reconstruction.preparation import Preparation
from tnst_mi.reconstruction.report import write_report
from tnst_mi.reconstruction.results import in_colour, write_frame_results
from tnst_mi.reconstruction.state import ReconstructionState
from tnst_mi.reconstruction.step_bar import LevelCost, StepBar

#: Seconds after which a reconstruction that is under way is written, to go on from there.
_WRITTEN_AFTER = 30.0

#: What a step costs besides its pixels and cells, as a number of cells: on small grids nearly all of it.
_EACH_STEP = 100_000


class FrameByFrame:
    """A reconstruction that goes on from where an earlier one stopped, or begins.

    Args:
        prepared: what it is of.
        out: folder for the results.
        format: of the densities.
        state: the file from which it goes on.
        progress: how far it is.
        shown: whether there is a progress bar.

    Attributes:
        progress: likewise.
        unfinished: the record of the frame in which Ctrl-C was pressed, if it was.
    """

    def __init__(
        self, prepared: Preparation, out: Path, format: str, state: Path, progress: ReconstructionState, shown: bool
    ) -> None:
        self._prepared, self._out, self._format, self._state, self._shown = prepared, out, format, state, shown
        self.progress = progress
        self.unfinished: tuple[dict[str, Any], ...] = ()
        self._saved = time.monotonic()

    def go_on(self, interrupt: Interrupt) -> None:
        """Reconstruct the frames that are left, until all are done or Ctrl-C was pressed."""
        while len(self.progress.records) < len(self._prepared.frames) and not self.unfinished:
            self._reconstruct(len(self.progress.records), interrupt)
            records = [*self.progress.records, *self.unfinished]
            write_report(self._out, self._prepared, records, finished=not self.unfinished)

    def _reconstruct(self, index: int, interrupt: Interrupt) -> None:
        """The next frame."""
        prepared, number = self._prepared, self._prepared.frames[index]
        begun = time.perf_counter() - self.progress.seconds
        self.progress.note(prepared.sources(index))
        frame = FrameReconstruction(
            prepared.settings,
            prepared.levels,
            prepared.photographs(number),
            *self._known_light(),
            self._start(index),
            index,
        )
        last = len(prepared.levels) - 1
        descent = None
        with closing(StepBar(self._costs(frame), frame.first_level, number, self._shown)) as bar:
            for level in range(max(frame.first_level, self.progress.level), last + 1):
                descent = frame.descent(level, descent)
                if self.progress.tensors:
                    self.progress.restore(descent, self._state)
                    self.progress.tensors = {}
                self.progress.level = level
                self._descend(descent, level, bar, begun, interrupt)
                if interrupt.requested:
                    break
        assert descent is not None
        extinction = frame.full_extinction(descent)
        finished = self.progress.level == last and descent.done == descent.steps
        colours = None
        if finished and prepared.settings.channel == "rgb":
            found = in_colour(frame, extinction, len(prepared.levels), interrupt, self._shown)
            finished = found is not None
            extinction, colours = found or (extinction, None)
        seconds = time.perf_counter() - begun
        record = write_frame_results(
            self._out, self._format, prepared, number, frame, extinction, colours, seconds, finished
        )
        record["convergence"] = self.progress.convergence
        if finished:
            self.progress = self.progress.after(record)
            self.progress.write(self._state, None)
        else:
            self.progress.seconds = seconds
            self.progress.write(self._state, descent)
            self.unfinished = (record,)

    def _descend(self, descent: Descent, level: int, bar: StepBar, begun: float, interrupt: Interrupt) -> None:
        """The steps on a grid."""
        bar.enter(level, descent.done)
        grid = "×".join(map(str, descent.octave.shape))
        while descent.done < descent.steps and not interrupt.requested:
            loss = descent.step()
            self.progress.add_error(level, loss)
            bar.advance(f"grid {grid}, step {descent.done}/{descent.steps}, RMS {loss**0.5:.2%}")
            if time.monotonic() - self._saved > _WRITTEN_AFTER:
                self.progress.seconds = time.perf_counter() - begun
                self.progress.write(self._state, descent)
                self._saved = time.monotonic()

    def _known_light(self) -> tuple[float | None, float | None]:
        """The brightness and the background as far as they are known: given, or found on the first frame."""
        if self.progress.records:
            return self.progress.records[0]["brightness"], self.progress.records[0]["background"]
        settings = self._prepared.settings
        return settings.known_brightness, None if settings.background == "auto" else float(settings.background)

    def _start(self, index: int) -> np.ndarray | None:
        """The extinction of the frame before, moved by the simulation's velocity where that is known."""
        if index == 0:
            return None
        record = self.progress.records[index - 1]
        stored = read_stored(self._out / record["density"])
        before = np.asarray(stored.density, np.float32) * np.float32(record["gamma"])
        velocity = self._prepared.velocity(self._prepared.frames[index - 1])
        return before if velocity is None else advect(before, velocity, trace="flow")

    def _costs(self, frame: FrameReconstruction) -> list[LevelCost]:
        """What the steps on each grid cost, in proportion: something each, by sample of a ray, and by cell."""
        steps = frame.step_count
        return [
            LevelCost(steps, _EACH_STEP + frame.pixel_count(level) * max(octave.shape) + math.prod(octave.shape))
            for level, octave in enumerate(self._prepared.levels)
        ]
