"""All frames, one after the other: where each starts from, what is shown and written meanwhile, and in the end."""

from __future__ import annotations

import math
import time
from contextlib import closing
from pathlib import Path
from typing import Any

from tnst_mi.machine.interrupt import Interrupt
from tnst_mi.reconstruction.fitting.motion import MotionDescent
from tnst_mi.reconstruction.fitting.resumable import ResumableDescent
from tnst_mi.reconstruction.one_frame import FrameReconstruction
from tnst_mi.reconstruction.output.report import write_report
from tnst_mi.reconstruction.output.results import in_colour, write_frame_results
from tnst_mi.reconstruction.output.step_bar import LevelCost, StepBar
from tnst_mi.reconstruction.photographs import Photograph
from tnst_mi.reconstruction.preparation import Preparation
from tnst_mi.reconstruction.resuming.state import ReconstructionState
from tnst_mi.reconstruction.velocities import FoundFrames

#: Seconds after which a reconstruction that is under way is written, to go on from there.
_WRITTEN_AFTER = 30.0

#: What a step costs besides its pixels and cells, as a number of cells: on small grids nearly all of it.
_EACH_STEP = 100_000


class FrameByFrame:
    """A reconstruction that goes on from where an earlier one stopped, or begins.

    Args:
        prepared: what it is of.
        out: folder for the results.
        state: the file from which it goes on.
        progress: how far it is.
        shown: whether there is a progress bar.

    Attributes:
        progress: likewise.
        unfinished: the record of the frame in which Ctrl-C was pressed, if it was.
        interrupted: whether it was, also between frames.
    """

    def __init__(
        self, prepared: Preparation, out: Path, state: Path, progress: ReconstructionState, shown: bool
    ) -> None:
        self._prepared, self._out, self._state, self._shown = prepared, out, state, shown
        self.progress = progress
        self.unfinished: tuple[dict[str, Any], ...] = ()
        self.interrupted = False
        self._found = FoundFrames(prepared, out)
        self._pictures: tuple[int, list[Photograph]] | None = None
        self._saved = time.monotonic()

    def go_on(self, interrupt: Interrupt) -> None:
        """Reconstruct the frames that are left, until all are done or Ctrl-C was pressed."""
        while not self.interrupted:
            done = len(self.progress.records)
            if 0 < done < len(self._prepared.frames) and "velocity" not in self.progress.records[-1]:
                self._find_velocity(done - 1, interrupt)
            elif done < len(self._prepared.frames):
                self._reconstruct(done, interrupt)
            else:
                break
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
            self._photographs(index),
            *self._known_light(),
            self._found.moved(self.progress.records[-1]) if index else None,
            index,
        )
        last = len(prepared.levels) - 1
        descent = None
        costs = self._costs(frame, frame.step_count)
        name = "reconstructing" if number is None else f"frame {number}"
        with closing(StepBar(costs, frame.first_level, name, self._shown)) as bar:
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
        # Before the light is fitted to what was found, which the next step would not have begun with.
        self.progress.seconds = time.perf_counter() - begun
        self.progress.write(self._state, descent)
        extinction = frame.full_extinction(descent)
        finished = self.progress.level == last and descent.done == descent.steps
        colours = None
        if finished and prepared.settings.channel == "rgb":
            found = in_colour(frame, extinction, len(prepared.levels), interrupt, self._shown)
            finished = found is not None
            extinction, colours = found or (extinction, None)
        seconds = time.perf_counter() - begun
        record = write_frame_results(self._out, prepared, number, frame, extinction, colours, seconds, finished)
        record["convergence"] = self.progress.convergence
        record["remarks"] = frame.remarks
        if finished:
            self.progress = self.progress.after(record)
            self.progress.write(self._state, None)
        else:
            self.unfinished, self.interrupted = (record,), True

    def _find_velocity(self, index: int, interrupt: Interrupt) -> None:
        """The velocity from a frame that is done to the next: known, estimated, or none."""
        prepared, record = self._prepared, self.progress.records[index]
        self.progress.note(prepared.sources(index + 1))
        known, told = prepared.velocity(prepared.frames[index]), None
        if known is not None:
            told = {"source": "known", **self._found.add_velocity(record, known)}
        elif prepared.estimates:
            told = self._estimate_velocity(index, interrupt)
            if told is None:
                self.interrupted = True
                return
        self.progress.records[index] = {**record, "velocity": told}
        self.progress.write(self._state, None)

    def _estimate_velocity(self, index: int, interrupt: Interrupt) -> dict[str, Any] | None:
        """Find the velocity from a frame to the next, and write it; None if Ctrl-C was pressed before its end."""
        prepared, records = self._prepared, self.progress.records
        begun, full = time.perf_counter() - self.progress.seconds, prepared.place.shape
        pictures = self._photographs(index + 1)
        extinction = self._found.extinction(records[index])
        frame = FrameReconstruction(
            prepared.settings, prepared.levels, pictures, *self._known_light(), extinction, index + 1
        )
        before = self._found.velocity(records[index - 1]) if index else None
        pixels = sum(picture.averaged(1.0).values.size for picture in pictures if not picture.held_out)
        steps, motion = prepared.settings.motion_iterations, None
        name = f"velocity {prepared.frames[index]} to {prepared.frames[index + 1]}"
        with closing(StepBar(self._costs(frame, steps), 0, name, self._shown)) as bar:
            for level in range(self.progress.level, len(prepared.levels)):
                views = frame.descent(level, None)
                motion = MotionDescent(views, before, full, motion, frame.noise, pixels, steps)
                if self.progress.tensors:
                    self.progress.restore(motion, self._state)
                    self.progress.tensors = {}
                self.progress.level = level
                self._descend(motion, level, bar, begun, interrupt)
                if motion.done < steps or (interrupt.requested and level + 1 < len(prepared.levels)):
                    self.progress.seconds = time.perf_counter() - begun
                    self.progress.write(self._state, motion)
                    return None
        assert motion is not None
        found = self._found.add_velocity(records[index], motion.velocity(full))
        seconds = time.perf_counter() - begun
        self.progress.level, self.progress.seconds, self.progress.errors = 0, 0.0, []
        return {"source": "estimated", **found, "rms": motion.misfit(), "seconds": round(seconds, 1)}

    def _photographs(self, index: int) -> list[Photograph]:
        """The pictures of a frame: those that a velocity was found from are those of the next frame."""
        if self._pictures is None or self._pictures[0] != index:
            self._pictures = index, self._prepared.photographs(self._prepared.frames[index])
        return self._pictures[1]

    def _descend(self, descent: ResumableDescent, level: int, bar: StepBar, begun: float, interrupt: Interrupt) -> None:
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

    def _costs(self, frame: FrameReconstruction, steps: int) -> list[LevelCost]:
        """What the steps on each grid cost, in proportion: something each, by sample of a ray, and by cell."""
        return [
            LevelCost(steps, _EACH_STEP + frame.pixel_count(level) * max(octave.shape) + math.prod(octave.shape))
            for level, octave in enumerate(self._prepared.levels)
        ]
