"""Checks everything that can be checked before the work of a run starts."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from tnst_mi.errors import InputError
from tnst_mi.fields.kernels import LARGEST_COUNT, require_indexable
from tnst_mi.frame import Frame
from tnst_mi.io.files.frame_numbers import frame_step
from tnst_mi.io.formats import FORMATS
from tnst_mi.io.sequence import FrameFiles
from tnst_mi.machine import environment
from tnst_mi.machine.backend import activate, network_threads
from tnst_mi.machine.disk import require_names, require_space
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.network.weights import find_weights
from tnst_mi.optimisation.goals import objective_of, require_known, require_meant
from tnst_mi.optimisation.plan import plan_of
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.targets import targets_of
from tnst_mi.regions.measured_masks import measured_masks
from tnst_mi.regions.regions import regions_of
from tnst_mi.rendering.cameras.shots import ShotView, shot_views, with_shots
from tnst_mi.rendering.exposure import Brightness, brightness
from tnst_mi.rendering.levels import by_frame, levels_of, levels_seen
from tnst_mi.resources import expanded
from tnst_mi.run.carry import require_there
from tnst_mi.run.colour import colour_grids
from tnst_mi.run.from_model import begun_by, model_of_run
from tnst_mi.run.going_on import going_on
from tnst_mi.run.inputs import Frames, UnchangedFrames
from tnst_mi.run.measure import (
    Measure,
    digests,
    file_digests,
    measured,
    require_coherent,
    require_same_input,
    require_same_masks,
    require_same_shots,
    shot_record,
)
from tnst_mi.run.memory import Need, cache_bytes, free_bytes, require_memory, working_bytes
from tnst_mi.run.readable import Readable, watched
from tnst_mi.run.record import target_record
from tnst_mi.run.request import FromModel, requested_frames
from tnst_mi.run.resuming import record_in, resumable_run
from tnst_mi.run.work import Work
from tnst_mi.run.written import recipe_digest

#: Height at which the objective is tried, with the aspect ratio of the frames, to which pictures are cropped.
_TRIAL_ROWS = 64

#: Bytes from which on memory for items is mentioned.
_WORTH_TELLING = 50_000_000

#: Largest density that can be rendered: sums along rays and squares must stay within single precision.
_DENSEST = 1e15

#: Entries of its earlier record that a resumed run keeps.
_KEPT = ("started", "frames", "sequence", "results", "seconds", "peak_memory_bytes", "threads", "cluster")


@dataclass(frozen=True)
class Network:
    """The network of a run; `fallback` if it was not requested but no other was found."""

    model: GoogLeNet
    fallback: bool = False


@dataclass(frozen=True)
class Prepared(Work):
    """A run that has been checked and can begin.

    Attributes:
        brightness: measurements of each frame, rendered.
        network: judges the images.
        shots: where the shot's camera sees each frame from; empty without one.
        reading: lines that say how the frames were read.
        memory: a line that says how much of it the run takes.
        overwrite: whether a run in `out` is replaced.
        record: the contents of run.json before the first frame is done, with those of an earlier run that is resumed.
        found: the bytes of the run.json that was in `out` when the checks began, or None.
    """

    brightness: Sequence[Brightness]
    network: Network
    shots: Sequence[ShotView]
    reading: Sequence[str]
    memory: str
    overwrite: bool
    record: Mapping[str, Any] = field(repr=False)
    found: bytes | None = field(repr=False)

    @property
    def work(self) -> Work:
        """What another process has to know of it."""
        return Work(**{of_work.name: getattr(self, of_work.name) for of_work in fields(Work)})

    def frames_named(self, names: Sequence[str]) -> Sequence[Frame]:
        """The input frames with these names, in input order; if these are all, the input sequence itself."""
        if len(names) == len(self.frames):
            return self.frames
        chosen = set(names)
        return [self.frames[i] for i, measure in enumerate(self.measures) if measure.name in chosen]


def load_network(recipe: Recipe) -> Network:
    """The network that a recipe names, or else the first that is found.

    Raises:
        InputError: it cannot be found or read, or lacks or does not mean what the recipe names.
    """
    weights = find_weights(recipe.weights)
    network = GoogLeNet.from_file(weights.path)
    for target in targets_of(recipe):
        require_meant(target.recipe, network, weights.fallback)
        require_known(target.recipe, network, weights.fallback)
    return Network(network, weights.fallback)


def prepare(
    frames: Frames,
    recipe: Recipe,
    out: str | Path | None = None,
    *,
    resume: bool = False,
    overwrite: bool = False,
    start_from: Path | None = None,
    model: FromModel | None = None,
    network: Network | None = None,
    processes: int = 1,
    progress: bool = False,
) -> Prepared:
    """Check everything that can be checked before the work starts; nothing is written.

    Args:
        frames: a file (one frame) or folder (a sequence), a frame, several, or a density grid (D, H, W).
        recipe: the recipe.
        out: the folder of the results, or None.
        resume: continue the run in `out` where it stopped.
        overwrite: replace the run in `out`.
        start_from: the folder of an earlier run to go on from, or None.
        model: the trained network whose potentials the run begins with, or None.
        network: judges the images; None loads the one that the recipe names.
        processes: how many on this machine share the work, and its memory.
        progress: show a progress bar on stderr while frames are read.

    Raises:
        InputError: something cannot be used, or another run writes to `out`.
    """
    recipe = recipe.located(Path.cwd())
    targets = targets_of(recipe)
    source = Path(frames) if isinstance(frames, str | Path) else None
    out = None if out is None else expanded(Path(out))
    found = None if out is None else record_in(out)
    sequence = requested_frames(frames, recipe, out, resume=resume, overwrite=overwrite, start_from=start_from)
    # Reading the first frame finds most bad inputs before the network is loaded.
    first = next(iter(Readable(sequence, recipe.skip_bad)))
    shape = first.density.shape
    # A file of cameras that cannot be used is found as early; the other frames follow once they are measured.
    recipe = with_shots(recipe, shot_views(recipe, [first], shape))
    require_indexable(3 * math.prod(shape), f"{first.name}: its velocity is an array")
    rows, columns = levels_of(recipe, shape)[-1].size
    if recipe.views * rows * columns >= LARGEST_COUNT:
        raise InputError(
            f"views = {recipe.views}: images of {rows}×{columns} pixels have {recipe.views * rows * columns} values "
            f"together, expected fewer than {LARGEST_COUNT}; take fewer views"
        )
    variant = activate(recipe.variant)
    threads = network_threads(recipe.threads)
    # Layers, tags and pictures are checked before the frames: if all frames are empty, nothing else would check them.
    network = network or load_network(recipe)
    objectives = [objective_of(target.recipe) for target in targets]
    trial_size = _TRIAL_ROWS, max(8, round(_TRIAL_ROWS * columns / rows))
    saved = max(objective.bind(network.model, *trial_size).saved_bytes for objective in objectives)
    saved /= math.prod(trial_size)
    need, free = Need(shape, recipe, len(sequence), saved, on_disk=out is not None), free_bytes()
    memory, cache = require_memory(need, free, processes), cache_bytes(need, free, len(sequence), recipe, processes)
    if cache >= _WORTH_TELLING:
        memory += f", and up to {cache / 1e9:.2g} GB to keep what is read again"
    readable = Readable(sequence, recipe.skip_bad, recipe.window)
    measures, reference = measured(watched(readable, "reading", progress), recipe.carry)
    movable = list(dict.fromkeys(name for measure in measures for name in measure.movable))
    require_there(recipe.carry, movable)
    sequence = readable.frames()
    colours = colour_grids(recipe, measures, sequence)
    if out is not None:
        require_names(out, [measure.name for measure in measures])
    require_coherent(measures, recipe)
    numbers = [measure.number for measure in measures]
    recipe = with_shots(recipe, shots := shot_views(recipe, measures, shape))
    step = frame_step(numbers)
    unchanged = UnchangedFrames(sequence, [measure.sha256 for measure in measures])
    regions = regions_of(recipe, unchanged, numbers, sequence)
    target_records = None
    if regions is not None:
        masks = measured_masks(regions, targets, watched(unchanged, "masking", progress))
        target_records = [target_record(target, mask) for target, mask in zip(targets, masks, strict=True)]
    recipes = by_frame(recipe, numbers, shape)
    density_scale = reference.scale(recipe.density_scale)
    densest = max(measure.densest for measure in measures)
    if densest * density_scale > _DENSEST:
        raise InputError(
            f"density_scale = {density_scale:g}: makes the density of {densest:g} larger than {_DENSEST:g}, with which "
            'images cannot be computed; take density_scale = "auto"'
        )
    if progress and recipe.integrator != "emission_absorption":
        tqdm.write("measuring how bright the frames are path traced …", file=sys.stderr)
    watch = partial(watched, doing="measuring", shown=progress)
    bright = brightness(unchanged, recipes, levels_seen(recipe, shape), density_scale, watch)
    exposures = [of_frame.exposure for of_frame in bright]
    suffix = _suffix(recipe, sequence)
    record: dict[str, Any] = {
        "status": "running",
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": environment.versions(),
        "device": environment.device(variant),
        "threads": threads,
        "recipe": recipe_digest(recipe),
        "seed": recipe.seed,
        "weights": {
            "file": str(network.model.source),
            "sha256": network.model.sha256,
            "flavour": network.model.flavour,
        },
        "main_view": list(recipe.main_view),
        "format": suffix[1:],
        "input": None if source is None else str(expanded(source).absolute()),
        "inputs": digests(measures),
        "files": file_digests(recipe),
        "reference_density": reference.value,
        "density_scale": density_scale,
        **({} if colours.temperature is None else {"temperature": list(colours.temperature)}),
        # Frames of different γ have exposures of their own, which are with the frames.
        "carried": colours.carried(recipe, measures, suffix),
        "exposure": exposures[0] if len(set(exposures)) == 1 else None,
        "frames": [],
    }
    record |= ({} if target_records is None else {"targets": target_records}) | shot_record(measures, shots)
    earlier = resumable_run(out, recipe, record["weights"], suffix) if resume and out is not None else None
    if earlier is not None and out is not None:
        require_same_input(measures, recipe, earlier, out)
        require_same_masks(targets, target_records or [], earlier, out)
        require_same_shots(record, earlier, out)
        record |= {key: earlier[key] for key in _KEPT if key in earlier}
        network_threads(record["threads"])
    elif out is not None:
        require_space(out, working_bytes(shape, len(sequence), recipe, states=True))
    plan = plan_of(
        recipe,
        [measure.name for measure in measures],
        numbers,
        [of_frame.step_scale for of_frame in bright],
        exposures,
        shape,
        density_scale,
        regions=regions,
        colour_names=colours.begins_with,
        colour_written=colours.written or "Cd",
    )
    model = model or model_of_run(earlier)
    if model is None:
        plan, record = going_on(plan, record, start_from, earlier)
    else:
        plan, record = begun_by(model, plan, record, unchanged, earlier)
    said = [
        *readable.lines(),
        *colours.notes,
        *(f"note: {note}" for note in (regions.notes if regions is not None else ())),
    ]
    if earlier is not None:
        said += earlier["notes"]
    return Prepared(
        recipe,
        sequence,
        step,
        measures,
        plan,
        cache,
        out,
        suffix,
        _context(recipe, measures),
        bright,
        network,
        shots,
        said,
        memory,
        overwrite,
        record,
        found,
    )


def _context(recipe: Recipe, measures: Sequence[Measure]) -> frozenset[int]:
    """The indices of the frames beside those that the recipe selects."""
    if recipe.frame_range is None:
        return frozenset()
    first, last = recipe.frame_range
    return frozenset(i for i, of in enumerate(measures) if of.number is not None and not first <= of.number <= last)


def _suffix(recipe: Recipe, frames: Sequence[Frame]) -> str:
    if recipe.format is not None:
        return f".{recipe.format}"
    return frames.suffix if isinstance(frames, FrameFiles) and frames.suffix in FORMATS else FORMATS[0]
