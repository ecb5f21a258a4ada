"""A whole run: check the input, expose it, stylize its frames, report, and write the results."""

from __future__ import annotations

import errno
import math
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tnst_mi.errors import InputError, StoppedError
from tnst_mi.frame import Frame
from tnst_mi.io.formats import FORMATS
from tnst_mi.io.sequence import FrameFiles, open_frames
from tnst_mi.machine import environment
from tnst_mi.machine.backend import activate
from tnst_mi.machine.disk import require_space, require_writable
from tnst_mi.optimisation.store import FolderStore, MemoryStore
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.folder import (
    RunFolder,
    StoredArrays,
    frame_names,
    holds_run,
    resumable_run,
)
from tnst_mi.run.measure import (
    digests,
    exposure_of,
    file_digests,
    measured,
    require_coherent,
    require_same_input,
)
from tnst_mi.run.memory import free_bytes, needed, require_memory, working_bytes
from tnst_mi.run.progress import ProgressBar
from tnst_mi.run.record import frame_record, sequence_record

if TYPE_CHECKING:
    from tnst_mi.optimisation.result import Stylized

#: A full disk, and a quota that is used up.
_NO_ROOM = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC))

#: What can be stylized: a file or folder, one frame, several, or a density grid (D, H, W).
Frames = str | Path | Frame | Sequence[Frame] | np.ndarray

#: Height that the objective is tried at, with the aspect of the frames, by which pictures are cropped.
_TRIAL_ROWS = 64


@dataclass(frozen=True)
class StylizedFrame:
    """One finished frame: what came in, what the optimisation gave, and what run.json says of it."""

    source: Frame
    stylized: Stylized
    record: dict[str, Any]


class Job:
    """One run over the frames of an input; `run` does it, `record` tells what was done."""

    def __init__(
        self,
        frames: Frames,
        recipe: Recipe,
        out: str | Path | None = None,
        *,
        progress: bool = True,
        resume: bool = False,
        overwrite: bool = False,
    ) -> None:
        """Check everything that can be checked before the work starts; see `stylize`.

        Args:
            frames: as for `stylize`.
            recipe: the recipe.
            out: the folder of the results, or None.
            progress: show a progress bar on stderr.
            resume: continue the run in `out` where it stopped.
            overwrite: replace the run in `out`.

        Raises:
            InputError: something cannot be used; nothing has been written then.
        """
        if not (recipe.style or recipe.semantic or recipe.tag or recipe.content):
            raise InputError("nothing to stylize towards: give --style, --semantic, --tag or --content, or a recipe")
        if resume and overwrite:
            raise InputError("--resume and --overwrite: expected only one of them")
        self.recipe = recipe = recipe.located(Path.cwd())
        self.out = None if out is None else Path(out)
        if self.out is not None:
            source = Path(frames) if isinstance(frames, str | Path) else None
            require_writable(self.out, source, None if resume or overwrite else _remedy(self.out))
            if overwrite:
                frame_names(self.out)  # refuses what is no run
        self.frames = _sequence_of(frames, recipe)
        # Reading the first frame finds most bad inputs before the network is loaded.
        shape = self.frames[0].density.shape
        self._bar = ProgressBar(progress)
        self._overwrite = overwrite

        variant = activate(recipe.variant)
        from tnst_mi.network.googlenet import GoogLeNet
        from tnst_mi.network.weights import find_weights
        from tnst_mi.optimisation.goals import objective_of, require_meant

        # Layers, tags and pictures are checked before the frames, all of which may be empty and need none of them.
        weights = find_weights(recipe.weights)
        self._fallback = weights.fallback
        self._network = GoogLeNet.from_file(weights.path)
        require_meant(recipe, self._network, weights.fallback)
        trial_size = _TRIAL_ROWS, max(8, round(_TRIAL_ROWS * shape[2] / shape[1]))
        trial = objective_of(recipe).bind(self._network, *trial_size)
        need = needed(shape, recipe, len(self.frames), trial.saved_bytes / math.prod(trial_size), self.out is not None)
        self._memory = require_memory(need, free_bytes())
        self._measures = measured(self.frames, recipe)
        require_coherent(self._measures, recipe)
        self.record = {
            "status": "running",
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "versions": environment.versions(),
            "device": environment.device(variant),
            "seed": recipe.seed,
            "weights": {
                "file": str(self._network.source),
                "sha256": self._network.sha256,
                "flavour": self._network.flavour,
            },
            "main_view": list(recipe.main_view),
            "format": self.suffix[1:],
            "inputs": digests(self._measures),
            "files": file_digests(recipe),
            "exposure": self.exposure,
            "frames": [],
        }
        earlier = None
        if resume and self.out is not None:
            earlier = resumable_run(self.out, recipe, self.record["weights"], self.suffix)
        if earlier is not None:
            require_same_input(self._measures, recipe, earlier, self.out)
            kept = ("started", "frames", "sequence", "seconds", "peak_memory_bytes")
            self.record |= {key: earlier[key] for key in kept if key in earlier}
        elif self.out is not None:
            require_space(self.out, working_bytes(shape, len(self.frames), recipe))

    def run(self) -> Iterator[StylizedFrame]:
        """Stylize the frames, write each and give it once it is done; stops early when interrupted.

        Raises:
            InputError: a frame or the working state has been damaged since the run began.
            StoppedError: the disk is full; the run can be resumed.
        """
        finished = {record["name"] for record in self.record["frames"]}
        if len(finished) == len(self.frames) and (len(self.frames) == 1 or "sequence" in self.record):
            self.record["status"] = "done"
            if self.out is not None:
                # It may have been killed before it had cleaned up.
                folder = RunFolder(self.out, self.recipe, suffix=self.suffix)
                folder.write_run(self.record)
                folder.remove_work()
            return
        try:
            yield from self._run(finished)
        except OSError as error:
            if error.errno not in _NO_ROOM:
                raise
            raise StoppedError(
                f"{self.out}: the disk is full; free some space and go on with --resume, nothing is lost"
            ) from error
        finally:
            self._bar.close()

    def _run(self, finished: set[str]) -> Iterator[StylizedFrame]:
        from tnst_mi.network.weights import announce_fallback
        from tnst_mi.optimisation.runner import SequenceOptimisation

        started = time.perf_counter() - self.record.get("seconds", 0.0)
        folder, store = None, MemoryStore()
        if self.out is not None:
            folder = RunFolder(self.out, self.recipe, self._overwrite, self.suffix)
            folder.write_run(self.record)
            store = FolderStore(folder.work)
        self._bar.say(f"network: {self._network.flavour}, {self._network.source}")
        self._bar.say(self._memory)
        if self._fallback:
            announce_fallback()
        if self.recipe.coherence > 0 and (self.recipe.window == 1 or len(self.frames) == 1):
            self._bar.say(f"warning: coherence = {self.recipe.coherence:g} has no effect without a window")
        for measure in self._measures:
            if measure.brightest == 0.0 and measure.mass > 0.0:
                gamma = self.recipe.at(measure.number).gamma
                self._bar.say(f"warning: {measure.name} renders black at gamma {gamma:g} in the main view")
        largest = max(measure.pixel_sum for measure in self._measures)
        optimisation = SequenceOptimisation(
            self.frames,
            [measure.name for measure in self._measures],
            [measure.number for measure in self._measures],
            self.recipe,
            self._network,
            store,
            self.exposure,
            step_scales := [measure.pixel_sum / largest if largest > 0.0 else 0.0 for measure in self._measures],
        )
        done = [index for index, measure in enumerate(self._measures) if measure.name in finished]
        with closing(optimisation.run(self._bar.advance, done)) as results:
            for index, stylized in results:
                frame = StylizedFrame(
                    source := self.frames[index],
                    stylized,
                    frame_record(source, step_scales[index], stylized),
                )
                self.record["frames"].append(frame.record)
                if folder is not None:
                    self._write(folder, frame)
                    folder.write_run(self._progressed(started))
                yield frame
        self.record["status"] = "interrupted" if optimisation.interrupted else "done"
        self._progressed(started)
        if folder is None:
            return
        if optimisation.interrupted:
            folder.write_run(self.record)
        else:
            self._conclude(folder)

    def _conclude(self, folder: RunFolder) -> None:
        """Write what there is to say of all frames together, and clean up."""
        names = [measure.name for measure in self._measures]
        self.record["frames"].sort(key=lambda record: names.index(record["name"]))
        if len(names) > 1:
            densities = StoredArrays(folder.out, "density", names, self.suffix)
            self.record["sequence"] = sequence_record(self.recipe, self.frames, densities, self.record["frames"])
            folder.write_sequence(self.record, self.recipe.fps)
        folder.write_run(self.record)
        folder.remove_work()

    def _progressed(self, started: float) -> dict[str, Any]:
        """The record, with the time and memory used so far."""
        self.record["seconds"] = round(time.perf_counter() - started, 3)
        self.record["peak_memory_bytes"] = max(
            environment.peak_memory() or 0, self.record.get("peak_memory_bytes") or 0
        )
        return self.record

    @property
    def suffix(self) -> str:
        """How the names of the files of the results end: in the recipe's format, or else the input's."""
        if self.recipe.format is not None:
            return f".{self.recipe.format}"
        return self.frames.suffix if isinstance(self.frames, FrameFiles) else FORMATS[0]

    @property
    def exposure(self) -> float:
        """1 / the largest pixel of the unstylized main views; 1 where all of them are black."""
        return exposure_of(self._measures)

    def frames_named(self, names: Sequence[str]) -> Sequence[Frame]:
        """The input's frames of these names, in their order; all of them as the sequence that they came in."""
        if len(names) == len(self.frames):
            return self.frames
        return [self.frames[i] for i, measure in enumerate(self._measures) if measure.name in names]

    def _write(self, folder: RunFolder, frame: StylizedFrame) -> None:
        from tnst_mi.rendering.driving import main_view

        source, recipe = frame.source, self.recipe.at(frame.source.number)
        pair = (source.density, frame.stylized.density)
        before, after = (self.exposure * main_view(density, recipe) for density in pair)
        attributes = {
            "view": recipe.main_view,
            "gamma": recipe.gamma,
            "quadrature": recipe.quadrature,
            "exposure": self.exposure,
        }
        folder.write_arrays(source, frame.stylized.density, frame.stylized.velocity)
        folder.write_images(source.name, before, after, attributes)
        folder.write_history(source.name, frame.stylized.history)
        # Whole runs keep every frame; the largest arrays are not part of the result.
        frame.stylized.potential = (None, None)


def _remedy(out: Path) -> str:
    if holds_run(out):
        return "continue its run with --resume, or replace it with --overwrite"
    return "give an empty or new folder"


def _sequence_of(frames: Frames, recipe: Recipe) -> Sequence[Frame]:
    if isinstance(frames, str | Path):
        return open_frames(frames, recipe.frame_range)
    if recipe.frames is not None:
        raise InputError(f"frames = {recipe.frames!r}: selects from a folder, but the frames were given as arrays")
    if isinstance(frames, np.ndarray):
        return [Frame(frames)]
    if isinstance(frames, Frame):
        return [frames]
    if not isinstance(frames, Sequence) or not frames or not all(isinstance(frame, Frame) for frame in frames):
        raise InputError("frames: expected a path, a density grid, or frames (tnst_mi.Frame)")
    return frames
