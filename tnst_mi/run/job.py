"""Carries out a prepared run: stylizes its frames, reports, and writes the results."""

from __future__ import annotations

import copy
import errno
import math
import time
from collections.abc import Callable, Collection, Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from tnst_mi.errors import InputError, StoppedError
from tnst_mi.frame import Frame
from tnst_mi.io.atomic import make_folder
from tnst_mi.io.pictures.video import FRAMES_PER_SECOND
from tnst_mi.machine import environment
from tnst_mi.machine.lock import FolderLock, locked
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.network.weights import announce_fallback
from tnst_mi.optimisation.glimpse import Glimpses
from tnst_mi.optimisation.items.store import FolderStore, MemoryStore, Store
from tnst_mi.optimisation.plan import Plan
from tnst_mi.optimisation.result import Progress, Stylized
from tnst_mi.optimisation.runner import SequenceOptimisation
from tnst_mi.run.announcement import announcement
from tnst_mi.run.colour import colour_before
from tnst_mi.run.colour_record import colour_flicker
from tnst_mi.run.folder import RunFolder
from tnst_mi.run.kept_octaves import KeptOctaves
from tnst_mi.run.live_pictures import LivePictures
from tnst_mi.run.prepare import Prepared
from tnst_mi.run.progress import ProgressBar
from tnst_mi.run.record import run_identity, sequence_record
from tnst_mi.run.results import recorded, write_results
from tnst_mi.run.resuming import record_in
from tnst_mi.run.stored_arrays import StoredArrays, StoredGrids
from tnst_mi.run.time_left import octave_sizes

#: What else than the system's own words is said of why something could not be written.
_REASONS = {
    errno.ENOSPC: "the disk is full; free some space",
    getattr(errno, "EDQUOT", errno.ENOSPC): "the quota of its disk is used up; free some space",
    errno.EFBIG: "a file is larger than the limit on file sizes; raise it (ulimit -f)",
}


class Optimisation(Protocol):
    """The interface of an optimisation as seen by a run; `SequenceOptimisation` implements it."""

    interrupted: bool

    def run(
        self,
        on_iteration: Callable[[Progress], None] | None,
        finished: Collection[int],
        on_octave: Callable[[Glimpses], None] | None,
    ) -> Generator[tuple[int, Stylized], None, None]:
        """Stylize the frames that are not finished, and yield each with its index; see `SequenceOptimisation.run`."""
        ...


#: Creates the optimisation of a plan, from its frames, the network that judges them, and the store for the state.
Optimiser = Callable[[Plan, Sequence[Frame], GoogLeNet, Store], Optimisation]


@dataclass(frozen=True)
class FinishedFrame:
    """One finished frame: its record in run.json, and its iterations, one dict each."""

    record: dict[str, Any]
    history: list[dict[str, Any]]


@dataclass(frozen=True)
class StylizedFrame(FinishedFrame):
    """One that was finished in this process: likewise the input, and the result of the optimisation."""

    source: Frame
    stylized: Stylized


class Run(Iterator[FinishedFrame]):
    """Iterates over the frames of a prepared run; each is stylized and written on demand.

    Args:
        prepared: the run, from `prepare`.
        progress: show a progress bar on stderr.
        optimiser: makes the optimisation; None for `SequenceOptimisation`.

    Attributes:
        prepared: the run.
        record: the contents of run.json so far.
    """

    def __init__(self, prepared: Prepared, progress: bool = True, optimiser: Optimiser | None = None) -> None:
        self.prepared = prepared
        self._optimiser = optimiser or partial(SequenceOptimisation, cache_bytes=prepared.cache_bytes)
        self.record: dict[str, Any] = copy.deepcopy(dict(prepared.record))
        shape, left = prepared.plan.shape, len(prepared.wanted) - len(self.record["frames"])
        self._bar = ProgressBar(progress, octave_sizes(prepared.recipe, shape), math.prod(shape), left)
        self._interrupted = False
        #: Called at the end of every octave but the last.
        self._octave_listeners: list[Callable[[Glimpses], None]] = []
        self._frames = self._stylized()

    def __next__(self) -> FinishedFrame:
        """The next frame.

        Raises:
            InputError: a frame has changed or been damaged since the run began, or another run writes to the folder.
            StoppedError: nothing can be written any more, for instance because the disk is full; the run can be
                resumed.
        """
        return next(self._frames)

    def close(self) -> None:
        """End the run here, and let others write to its folder; it can be resumed."""
        self._frames.close()

    def _stylized(self) -> Generator[FinishedFrame, None, None]:
        out = self.prepared.out
        try:
            if out is None:
                yield from self._stylized_into(None)
                return
            make_folder(out)
            with locked(out) as lock:
                # Two runs may have been prepared at once; the folder then is that of the first to write.
                if not self.prepared.overwrite and record_in(out) != self.prepared.found:
                    raise InputError(
                        f"{out}: another run has written there since this one began; continue that with --resume, or "
                        "give another folder"
                    )
                yield from self._stylized_into(lock)
        except BrokenPipeError:
            raise  # the reader of what is said has left
        except OSError as error:
            if out is None or error.errno is None:
                raise
            file = error.filename or "a file"
            ours = error.filename is None or Path(str(file)).absolute().is_relative_to(out.absolute())
            reason = _REASONS.get(error.errno) if ours else None
            reason = reason or f"{file} cannot be {'written' if ours else 'read'} ({error.strerror}); mend that"
            raise StoppedError(f"{out}: {reason} and go on with --resume, nothing is lost") from error
        finally:
            self._bar.close()

    def _stylized_into(self, lock: FolderLock | None) -> Iterator[FinishedFrame]:
        """The frames that are left, written to the run's folder if it has one, which is locked."""
        prepared, started = self.prepared, time.perf_counter() - self.record.get("seconds", 0.0)
        finished = {record["name"] for record in self.record["frames"]}
        folder: RunFolder | None = None
        store: Store = MemoryStore()
        if prepared.out is not None and lock is not None:
            recipe, may_write = prepared.recipe, lock.require_held
            folder = RunFolder(prepared.out, recipe, prepared.overwrite, prepared.suffix, finished, may_write)
            store = FolderStore(folder.work, run_identity(recipe, self.record), may_write, self._bar.say)
        if len(finished) == len(prepared.wanted) and (len(prepared.wanted) == 1 or "sequence" in self.record):
            self.record["status"] = "done"
            if folder is not None:
                # The earlier run may have been killed before it cleaned up.
                folder.write_run(self.record)
                folder.remove_work()
            return
        if folder is not None:
            folder.write_run(self.record)
        for line in announcement(prepared):
            self._bar.say(line)
        if prepared.network.fallback:
            announce_fallback()
        names, wanted = prepared.names, prepared.wanted
        done = [index for index, name in enumerate(names) if name in finished or index in prepared.context]
        live = None
        if folder is not None:
            shown, colours = {index: names[index] for index in wanted}, partial(colour_before, prepared)
            live = LivePictures(folder, shown, prepared.plan.full.size, finished, colours)
            self._octave_listeners.append(live.octave_done)
            if prepared.recipe.keep_octaves and lock is not None:
                middle, may_write = wanted[len(wanted) // 2], lock.require_held
                kept = KeptOctaves(folder.out, prepared.recipe, self.record, middle, colours, may_write)
                self._octave_listeners.append(kept.octave_done)
        with closing(self._computed(folder, store, live, done)) as frames:
            for frame in frames:
                self.record["frames"].append(frame.record)
                if folder is not None:
                    folder.write_history(frame.record["name"], frame.history)
                    folder.write_run(self._progressed(started))
                self._bar.frame_done()
                yield frame
        self.record["status"] = "interrupted" if self._interrupted else "done"
        self._progressed(started)
        if folder is None:
            return
        if self._interrupted:
            folder.write_run(self.record)
        else:
            self._conclude(folder, started)

    def _computed(
        self, folder: RunFolder | None, store: Store, live: LivePictures | None, done: Sequence[int]
    ) -> Generator[FinishedFrame, None, None]:
        """The frames that are not done, computed and written, but for what the folder holds of all frames."""
        prepared = self.prepared
        optimisation = self._optimiser(prepared.plan, prepared.moving, prepared.network.model, store)
        with closing(optimisation.run(self._bar.advance, done, self._octave_done)) as results:
            for index, stylized in results:
                source = prepared.unchanged[index]
                if folder is None:
                    record = recorded(prepared, index, source, stylized)
                else:
                    record, before, after = write_results(prepared, folder, index, source, stylized)
                    if live is not None:
                        live.frame_done(source.name, (before, after))
                yield StylizedFrame(record, stylized.history, source, stylized)
                # Callers may keep every frame of a run; what moves its grids and its state are not part of the result.
                stylized.movement = stylized.state = None
        self._interrupted = optimisation.interrupted

    def _octave_done(self, glimpses: Glimpses) -> None:
        for listener in self._octave_listeners:
            listener(glimpses)

    def _conclude(self, folder: RunFolder, started: float) -> None:
        """Write the results for all frames together, and clean up."""
        prepared = self.prepared
        names = [prepared.names[index] for index in prepared.wanted]
        place = {name: index for index, name in enumerate(names)}
        self.record["frames"].sort(key=lambda record: place[record["name"]])
        if len(names) > 1:
            frames = (prepared.moving[index] for index in prepared.wanted)
            densities = StoredArrays(folder.out, "density", names, prepared.suffix, prepared.frames)
            records = self.record["frames"]
            grids = StoredGrids(folder.out, names, prepared.suffix, prepared.frames)
            self.record["sequence"] = sequence_record(prepared.recipe, frames, densities, records)
            self.record["sequence"] |= colour_flicker(prepared, densities, grids)
            folder.write_sequence(self.record, prepared.recipe.fps or FRAMES_PER_SECOND)
            self.record["results"] = folder.recorded_pictures()
        folder.write_run(self._progressed(started))
        folder.remove_work()

    def _progressed(self, started: float) -> dict[str, Any]:
        """The record, with the time and memory used so far."""
        self.record["seconds"] = round(time.perf_counter() - started, 3)
        self.record["peak_memory_bytes"] = max(
            environment.peak_memory() or 0, self.record.get("peak_memory_bytes") or 0
        )
        return self.record
