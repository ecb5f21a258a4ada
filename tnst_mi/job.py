"""A whole run: check the input, expose it, stylize frame after frame, report, and write the results."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tnst_mi import environment
from tnst_mi.backend import activate
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io.sequence import open_frames
from tnst_mi.measure import exposure_of, measured, require_same_input
from tnst_mi.outputs import RunFolder, frame_names, holds_run, require_writable, resumable_run
from tnst_mi.progress import ProgressBar
from tnst_mi.recipe import Recipe
from tnst_mi.shipped import DOWNLOAD_COMMAND, PATTERNS

if TYPE_CHECKING:
    from tnst_mi.googlenet import GoogLeNet
    from tnst_mi.optimise import Stylized

#: What can be stylized: a file or folder, one frame, several, or a density grid (D, H, W).
Frames = str | Path | Frame | Sequence[Frame] | np.ndarray

#: Height that the objective is tried at, with the aspect of the frames, by which pictures are cropped.
_TRIAL_ROWS = 64


@dataclass(frozen=True)
class Result:
    """What a stylization gives, one entry per frame.

    Attributes:
        densities: stylized densities, (D, H, W) float32, blended as the recipe says.
        velocities: the velocities v* that transport the smoke, (D, H, W, 3) float32 in cells per frame; 0
            where the recipe changes densities in place.
        frames: the frames as they came in.
        history: one dict per iteration: octave, iteration, loss, terms, seconds.
        run: the content of run.json.
        out: the folder of the results, or None.
    """

    densities: list[np.ndarray]
    velocities: list[np.ndarray]
    frames: list[Frame]
    history: list[list[dict[str, Any]]]
    run: dict[str, Any]
    out: Path | None


def stylize(
    frames: Frames,
    recipe: Recipe | str | Path | Mapping[str, Any],
    out: str | Path | None = None,
    progress: bool = True,
) -> Result:
    """Stylize one frame or a sequence.

    Interrupting it with Ctrl-C ends it after the last state has been taken (and written).

    Args:
        frames: a file (one frame) or folder (a sequence), a frame, several, or a density grid (D, H, W).
        recipe: a recipe, the path of a recipe file, or a dict of recipe keys.
        out: an empty or new folder for the results; None to write nothing.
        progress: show a progress bar on stderr.

    Raises:
        InputError: the frames, the recipe, the weights or `out` cannot be used; then nothing is written.
    """
    if isinstance(recipe, str | Path):
        recipe = Recipe.from_toml(recipe)
    elif isinstance(recipe, Mapping):
        recipe = Recipe.from_dict(recipe)
    elif not isinstance(recipe, Recipe):
        raise InputError(f"recipe: is a {type(recipe).__name__}, expected a recipe, its path, or a dict of its keys")
    job = Job(frames, recipe, out, progress=progress)
    done = list(job.run())
    return Result(
        densities=[frame.density for frame in done],
        velocities=[frame.stylized.velocity for frame in done],
        frames=[frame.source for frame in done],
        history=[frame.stylized.history for frame in done],
        run=job.record,
        out=job.out,
    )


@dataclass(frozen=True)
class StylizedFrame:
    """One finished frame: what came in, what the optimisation gave, and the blended density."""

    source: Frame
    stylized: Stylized
    density: np.ndarray
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
            resume: continue the run in `out`: frames that it has finished are left as they are.
            overwrite: replace the run in `out`.

        Raises:
            InputError: something cannot be used; nothing has been written then.
        """
        _require_supported(recipe)
        if resume and overwrite:
            raise InputError("--resume and --overwrite: expected only one of them")
        self.recipe = recipe = recipe.updated(_path_keys(recipe), "recipe: ", Path.cwd())
        self.out = None if out is None else Path(out)
        if self.out is not None:
            source = Path(frames) if isinstance(frames, str | Path) else None
            require_writable(self.out, source, None if resume or overwrite else _remedy(self.out))
            if overwrite:
                frame_names(self.out)  # refuses what is no run
        self.frames = _sequence_of(frames, recipe)
        # Reading the first frame finds most bad inputs before the network is loaded.
        _, rows, columns = self.frames[0].density.shape
        self._bar = ProgressBar(progress)
        self._overwrite = overwrite

        variant = activate(recipe.variant)
        from tnst_mi.googlenet import GoogLeNet
        from tnst_mi.optimise import objective_of
        from tnst_mi.weights import find_weights

        # Layers, tags and pictures are checked before the frames, all of which may be empty and need none of them.
        weights = find_weights(recipe.weights)
        self._fallback = weights.fallback
        self._network = GoogLeNet.from_file(weights.path)
        _require_meant(recipe, self._network, weights.fallback)
        self._objective = objective_of(recipe)
        self._objective.bind(self._network, _TRIAL_ROWS, max(8, round(_TRIAL_ROWS * columns / rows)))
        self._measures = measured(self.frames, recipe)
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
            "exposure": self.exposure,
            "frames": [],
        }
        if resume and self.out is not None:
            earlier = resumable_run(self.out, recipe, self.record["weights"])
            if earlier is not None:
                require_same_input(self._measures, earlier, self.out)
                self.record["frames"] = earlier["frames"]

    def run(self) -> Iterator[StylizedFrame]:
        """Stylize the frames one after the other, write each and give it; stops early when interrupted."""
        from tnst_mi.weights import announce_fallback

        started = time.perf_counter()
        finished = {record["name"] for record in self.record["frames"]}
        left = [index for index, measure in enumerate(self._measures) if measure.name not in finished]
        self.record["status"] = "running" if left else "done"
        self._bar.frames = len(left)
        folder = None
        if left:
            self._bar.say(f"network: {self._network.flavour}, {self._network.source}")
            if self._fallback:
                announce_fallback()
        try:
            for index in left:
                frame = self._stylize_frame(index)
                interrupted = frame.stylized.interrupted
                self.record["frames"].append(frame.record)
                if interrupted or index == left[-1]:
                    self.record["status"] = "interrupted" if interrupted else "done"
                self.record["seconds"] = round(time.perf_counter() - started, 3)
                self.record["peak_memory_bytes"] = environment.peak_memory()
                if self.out is not None:
                    folder = folder or RunFolder(self.out, self.recipe, self._overwrite)
                    self._write(folder, frame)
                yield frame
                if interrupted:
                    break
        finally:
            self._bar.close()

    @property
    def exposure(self) -> float:
        """1 / the largest pixel of the unstylized main views; 1 where all of them are black."""
        return exposure_of(self._measures)

    def _stylize_frame(self, index: int) -> StylizedFrame:
        # Looked up late: importing it loads torch.
        from tnst_mi.optimise import optimise

        frame, measure = self.frames[index], self._measures[index]
        largest = max(measure.pixel_sum for measure in self._measures)
        step_scale = measure.pixel_sum / largest if largest > 0.0 else 1.0
        self._bar.frame = frame.name
        if measure.brightest == 0.0 and frame.density.any():
            self._bar.say(f"warning: {frame.name} renders black at gamma {self.recipe.gamma:g} in the main view")
        stylized = optimise(
            frame,
            self.recipe,
            self._network,
            self.exposure,
            self._bar.advance,
            step_scale=step_scale,
            objective=self._objective,
        )
        blend = self.recipe.blend
        density = np.float32((1.0 - blend) * frame.density + blend * stylized.density)
        record = {
            "name": frame.name,
            "number": frame.number,
            "input_sha256": measure.sha256,
            "complete": not stylized.interrupted,
            "note": stylized.note,
            "mass_before": frame.mass,
            "mass_after": float(density.sum(dtype=np.float64)),
            "largest_displacement": float(np.linalg.norm(stylized.velocity, axis=-1).max()),
            "step_scale": step_scale,
            "losses": _losses_by_octave(stylized.history),
            "timings": stylized.timings,
        }
        return StylizedFrame(frame, stylized, density, record)

    def _write(self, folder: RunFolder, frame: StylizedFrame) -> None:
        from tnst_mi.driving import main_view

        name = frame.source.name
        pair = (frame.source.density, frame.density)
        before, after = (self.exposure * main_view(density, self.recipe) for density in pair)
        attributes = {
            "view": self.recipe.main_view,
            "gamma": self.recipe.gamma,
            "quadrature": self.recipe.quadrature,
            "exposure": self.exposure,
        }
        folder.write_arrays(name, frame.density, frame.stylized.velocity)
        folder.write_images(name, before, after, attributes)
        folder.write_history(name, frame.stylized.history)
        folder.write_run(self.record)
        # Whole runs keep every frame; the largest arrays are not part of the result.
        frame.stylized.potential = (None, None)


def _require_supported(recipe: Recipe) -> None:
    if not (recipe.style or recipe.semantic or recipe.tag or recipe.content):
        raise InputError("nothing to stylize towards: give --style, --semantic, --tag or --content, or a recipe")
    if recipe.window > 1:
        raise InputError(f"window = {recipe.window}: temporal windows come with a later version, expected 1")


def _require_meant(recipe: Recipe, network: GoogLeNet, fallback: bool) -> None:
    """Refuse channel numbers of another network on `patterns`, which a recipe means only if it says so.

    Nothing in a number shows which network it was chosen for; recipes name channels of those trained on ImageNet.
    Names of classes, and pictures, mean the same to any network.
    """
    if network.flavour != PATTERNS or recipe.weights is not None or not recipe.semantic:
        return
    from tnst_mi.weights import ENVIRONMENT_VARIABLE

    if fallback:
        reason, remedy = "no other was found", f"get the paper's network with `{DOWNLOAD_COMMAND}`"
    else:
        reason, remedy = f"${ENVIRONMENT_VARIABLE} names it", "name the network that they are of with --weights"
    tags = ", ".join(repr(name.partition(",")[0].strip()) for name in network.class_names[:5])
    raise InputError(
        f"semantic {recipe.semantic[0]!r}: channel numbers are those of one network, and this run would be on the "
        f'shipped network {PATTERNS} ({reason}); {remedy}, or say weights = "{PATTERNS}" if its own channels are '
        f"meant, or choose a tag, such as {tags}"
    )


def _remedy(out: Path) -> str:
    if holds_run(out):
        return "continue its run with --resume, or replace it with --overwrite"
    return "give an empty or new folder"


def _path_keys(recipe: Recipe) -> dict[str, Any]:
    return {key: getattr(recipe, key) for key in ("style", "content", "weights", "light")}


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


def _losses_by_octave(history: list[dict[str, Any]]) -> list[list[float]]:
    octaves: dict[int, list[float]] = {}
    for entry in history:
        octaves.setdefault(entry["octave"], []).append(entry["loss"])
    return [octaves[octave] for octave in sorted(octaves)]
