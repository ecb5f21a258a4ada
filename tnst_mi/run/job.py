"""Carries out a prepared run: stylizes its frames, reports, and writes the results."""

from __future__ import annotations

import copy
import errno
import time
from collections.abc import Callable, Collection, Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from tnst_mi.errors import StoppedError
from tnst_mi.fields.density_unit import scaled
from tnst_mi.frame import Frame
from tnst_mi.machine import environment
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.network.weights import announce_fallback
from tnst_mi.optimisation.items.store import FolderStore, MemoryStore, Store
from tnst_mi.optimisation.plan import FramePlan, Plan
from tnst_mi.optimisation.result import Progress, Stylized
from tnst_mi.optimisation.runner import SequenceOptimisation
from tnst_mi.rendering.driving import main_view
from tnst_mi.run.folder import RunFolder, StoredArrays
from tnst_mi.run.prepare import Prepared
from tnst_mi.run.progress import ProgressBar
from tnst_mi.run.record import frame_record, sequence_record

#: Optical thickness of a cell from which on the inclusive sum shows less than 5% of what the cell emits.
_THICK = 3.0

#: Share of the steps of the frame with the most smoke in view from which on a frame is practically left alone.
_FAINT = 1e-3

#: Share of the smoke from which on it is mentioned that images do not show it.
_CUT_OFF = 0.01

#: A full disk, or an exhausted quota.
_NO_ROOM = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC))


class Optimisation(Protocol):
    """The interface of an optimisation as seen by a run; `SequenceOptimisation` implements it."""

    interrupted: bool

    def run(
        self, on_iteration: Callable[[Progress], None] | None, finished: Collection[int]
    ) -> Generator[tuple[int, Stylized], None, None]:
        """Stylize the frames that are not finished, and yield each with its index."""
        ...


#: Creates the optimisation of a plan, from its frames, the network that judges them, and the store for the state.
Optimiser = Callable[[Plan, Sequence[Frame], GoogLeNet, Store], Optimisation]


@dataclass(frozen=True)
class StylizedFrame:
    """One finished frame: the input, the result of the optimisation, and the record in run.json."""

    source: Frame
    stylized: Stylized
    record: dict[str, Any]


class Run(Iterator[StylizedFrame]):
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
        self._bar = ProgressBar(progress)
        self._frames = self._stylized()

    def __next__(self) -> StylizedFrame:
        """The next frame.

        Raises:
            InputError: a frame or the working state has been damaged since the run began.
            StoppedError: the disk is full; the run can be resumed.
        """
        return next(self._frames)

    def _stylized(self) -> Iterator[StylizedFrame]:
        prepared = self.prepared
        finished = {record["name"] for record in self.record["frames"]}
        if len(finished) == len(prepared.frames) and (len(prepared.frames) == 1 or "sequence" in self.record):
            self.record["status"] = "done"
            if prepared.out is not None:
                # The earlier run may have been killed before it cleaned up.
                folder = RunFolder(prepared.out, prepared.recipe, suffix=prepared.suffix)
                folder.write_run(self.record)
                folder.remove_work()
            return
        try:
            yield from self._stylized_but(finished)
        except OSError as error:
            if error.errno not in _NO_ROOM:
                raise
            raise StoppedError(
                f"{prepared.out}: the disk is full; free some space and go on with --resume, nothing is lost"
            ) from error
        finally:
            self._bar.close()

    def _stylized_but(self, finished: Collection[str]) -> Iterator[StylizedFrame]:
        prepared, started = self.prepared, time.perf_counter() - self.record.get("seconds", 0.0)
        folder: RunFolder | None = None
        store: Store = MemoryStore()
        if prepared.out is not None:
            folder = RunFolder(prepared.out, prepared.recipe, prepared.overwrite, prepared.suffix)
            folder.write_run(self.record)
            store = FolderStore(folder.work)
        self._announce()
        optimisation = self._optimiser(prepared.plan, prepared.frames, prepared.network.model, store)
        done = [index for index, measure in enumerate(prepared.measures) if measure.name in finished]
        with closing(optimisation.run(self._bar.advance, done)) as results:
            for index, stylized in results:
                source = prepared.frames[index]
                record = frame_record(source, prepared.plan.frames[index], stylized)
                frame = StylizedFrame(source, stylized, record)
                self.record["frames"].append(record)
                if folder is not None:
                    self._write(folder, frame, prepared.plan.frames[index])
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

    def _announce(self) -> None:
        """Report the device, the network and the memory of the run, and what in its recipe has no effect."""
        prepared, network = self.prepared, self.prepared.network
        self._bar.say(f"device: {environment.device_line(prepared.record['device']['variant'])}")
        self._bar.say(f"network: {network.model.flavour}, {network.model.source}")
        self._bar.say(prepared.memory)
        if network.fallback:
            announce_fallback()
        if prepared.recipe.coherence > 0 and prepared.plan.window == 1:
            self._bar.say(f"warning: coherence = {prepared.recipe.coherence:g} has no effect without a window")
        self._announce_density()
        for measure, plan in zip(prepared.measures, prepared.plan.frames, strict=True):
            if plan.still and measure.mass > 0.0:
                self._bar.say(f"warning: {measure.name} renders black at gamma {plan.recipe.gamma:g} in the main view")
        cut_off = max(bright.cut_off for bright in prepared.brightness)
        if cut_off > _CUT_OFF:
            self._bar.say(
                f"warning: up to {cut_off:.0%} of the smoke is outside the images of views from the side; fit = true "
                "makes room for it"
            )
        faint = [plan.name for plan in prepared.plan.frames if 0 < plan.step_scale < _FAINT]
        if faint:
            names = ", ".join(faint[:3]) + (f" and {len(faint) - 3} others" if len(faint) > 3 else "")
            self._bar.say(
                f"warning: {names}: hardly changed, since in view is less than {_FAINT:.1%} of the smoke of another "
                "frame"
            )

    def _announce_density(self) -> None:
        """Report the range of the density, its factor, and whether it is too thick for the quadrature."""
        prepared = self.prepared
        densest, scale = max(measure.densest for measure in prepared.measures), prepared.plan.density_scale
        line = f"density: up to {densest:.4g}, taken times {scale:.4g} (density_scale)"
        if prepared.recipe.density_scale == "auto":
            line += f", so that gamma is per cell of density {1 / scale:.4g}"
        self._bar.say(line)
        # Frames that are black altogether are named below.
        seen = zip(prepared.brightness, prepared.plan.frames, strict=True)
        thickness = max((bright.thickest for bright, plan in seen if not plan.still), default=0.0)
        inclusive = prepared.recipe.integrator == "emission_absorption" and prepared.recipe.quadrature == "paper"
        if inclusive and thickness > _THICK:
            self._bar.say(
                f"warning: gamma times the thickness of a cell is up to {thickness:.3g}: the paper's inclusive sum "
                'hides such cells from the network, quadrature = "exact" does not; or lower gamma'
            )

    def _write(self, folder: RunFolder, frame: StylizedFrame, plan: FramePlan) -> None:
        run, source, recipe, exposure = self.prepared.plan, frame.source, plan.recipe, plan.exposure
        before, after = (
            exposure * main_view(scaled(density, run.density_scale), recipe, run.image_size(run.octaves[-1]))
            for density in (source.density, frame.stylized.density)
        )
        attributes = {
            "view": recipe.main_view,
            "gamma": recipe.gamma,
            "quadrature": recipe.quadrature,
            "exposure": exposure,
        }
        folder.write_arrays(source, frame.stylized.density, frame.stylized.velocity)
        folder.write_images(source.name, before, after, attributes)
        folder.write_history(source.name, frame.stylized.history)
        # Callers may keep every frame of a run; its largest arrays are not part of the result.
        frame.stylized.potential = (None, None)

    def _conclude(self, folder: RunFolder) -> None:
        """Write the results for all frames together, and clean up."""
        prepared = self.prepared
        names = [measure.name for measure in prepared.measures]
        self.record["frames"].sort(key=lambda record: names.index(record["name"]))
        if len(names) > 1:
            densities = StoredArrays(folder.out, "density", names, prepared.suffix)
            records = self.record["frames"]
            self.record["sequence"] = sequence_record(prepared.recipe, prepared.frames, densities, records)
            folder.write_sequence(self.record, prepared.recipe.fps)
        folder.write_run(self.record)
        folder.remove_work()

    def _progressed(self, started: float) -> dict[str, Any]:
        """The record, with the time and memory used so far."""
        self.record["seconds"] = round(time.perf_counter() - started, 3)
        self.record["peak_memory_bytes"] = max(
            environment.peak_memory() or 0, self.record.get("peak_memory_bytes") or 0
        )
        return self.record
