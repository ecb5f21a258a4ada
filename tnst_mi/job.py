"""A whole run: check the input, expose it, stylize frame after frame, report, and write the results."""

from __future__ import annotations

import hashlib
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
from tnst_mi.io.sequence import FrameFiles, checked_shapes, open_frames
from tnst_mi.outputs import RunFolder, finished_frames, require_writable
from tnst_mi.progress import ProgressBar
from tnst_mi.recipe import Recipe

if TYPE_CHECKING:
    from tnst_mi.optimise import Stylized

#: What can be stylized: a file or folder, one frame, several, or a density grid (D, H, W).
Frames = str | Path | Frame | Sequence[Frame] | np.ndarray


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

    Interrupting it with Ctrl-C ends it after the best state so far has been taken (and written).

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
            require_writable(self.out, source, occupied_ok=resume or overwrite)
        self.frames = _sequence_of(frames, recipe)
        self._bar = ProgressBar(progress)
        self._overwrite = overwrite

        variant = activate(recipe.variant)
        self._measure_frames()
        from tnst_mi.googlenet import GoogLeNet

        self._network = GoogLeNet.load(recipe.weights)
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
            self.record["frames"] = finished_frames(self.out, recipe, self.record["weights"])
            self._require_same_input()

    def run(self) -> Iterator[StylizedFrame]:
        """Stylize the frames one after the other, write each and give it; stops early when interrupted."""
        started = time.perf_counter()
        finished = {record["name"] for record in self.record["frames"]}
        left = [index for index, measure in enumerate(self._measures) if measure.name not in finished]
        self.record["status"] = "running" if left else "done"
        self._bar.frames = len(left)
        folder = None
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
        brightest = max(measure.brightest for measure in self._measures)
        return 1.0 / brightest if brightest > 0.0 else 1.0

    def _stylize_frame(self, index: int) -> StylizedFrame:
        # Looked up late: importing it loads torch.
        from tnst_mi.optimise import optimise

        frame, measure = self.frames[index], self._measures[index]
        largest = max(measure.pixel_sum for measure in self._measures)
        step_scale = measure.pixel_sum / largest if largest > 0.0 else 1.0
        self._bar.frame = frame.name
        stylized = optimise(frame, self.recipe, self._network, self.exposure, self._bar.advance, step_scale=step_scale)
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
        name = frame.source.name
        before, after = (self.exposure * self._main_view(density) for density in (frame.source.density, frame.density))
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

    def _main_view(self, density: np.ndarray) -> np.ndarray:
        from tnst_mi.scene import render

        return np.asarray(render(density, self.recipe.main_view, self.recipe.gamma, self.recipe.quadrature))

    def _measure_frames(self) -> None:
        """Read every frame once, so that bad ones are found before any work, and measure its main view."""
        self._measures = []
        for frame in checked_shapes(self.frames):
            image = self._main_view(frame.density)
            digest = hashlib.sha256(frame.density.tobytes()).hexdigest()
            self._measures.append(_Measure(frame.name, float(image.max()), float(image.sum()), digest))
        names = [measure.name for measure in self._measures]
        double = next((name for name in names if names.count(name) > 1), None)
        if double is not None:
            raise InputError(f"frames: the name {double!r} is there more than once, expected one name per frame")

    def _require_same_input(self) -> None:
        digests = {measure.name: measure.sha256 for measure in self._measures}
        for record in self.record["frames"]:
            if digests.get(record["name"]) != record.get("input_sha256"):
                raise InputError(
                    f"{self.out}: its run stylized another {record['name']} than the input has now; "
                    "resume with the same input, or use --overwrite"
                )


@dataclass(frozen=True)
class _Measure:
    """What is known of a frame before it is stylized."""

    name: str
    brightest: float
    pixel_sum: float
    sha256: str


def _require_supported(recipe: Recipe) -> None:
    if not (recipe.style or recipe.semantic or recipe.tag or recipe.content):
        raise InputError("nothing to stylize towards: give --style, --semantic, --tag or --content, or a recipe")
    if recipe.window > 1:
        raise InputError(f"window = {recipe.window}: temporal windows come with a later version, expected 1")
    if recipe.integrator == "prbvolpath":
        raise InputError("integrator = 'prbvolpath': comes with a later version, expected 'emission_absorption'")


def _path_keys(recipe: Recipe) -> dict[str, Any]:
    return {key: getattr(recipe, key) for key in ("style", "content", "weights")}


def _sequence_of(frames: Frames, recipe: Recipe) -> Sequence[Frame]:
    if isinstance(frames, str | Path):
        files: FrameFiles = open_frames(frames)
        return files if recipe.frame_range is None else files.numbered(*recipe.frame_range)
    if recipe.frames is not None:
        raise InputError(f"frames = {recipe.frames!r}: selects from a folder, but the frames were given as arrays")
    if isinstance(frames, np.ndarray):
        return [Frame(frames)]
    if isinstance(frames, Frame):
        return [frames]
    if not frames or not all(isinstance(frame, Frame) for frame in frames):
        raise InputError("frames: expected a path, a density grid, or frames (tnst_mi.Frame)")
    return frames


def _losses_by_octave(history: list[dict[str, Any]]) -> list[list[float]]:
    octaves: dict[int, list[float]] = {}
    for entry in history:
        octaves.setdefault(entry["octave"], []).append(entry["loss"])
    return [octaves[octave] for octave in sorted(octaves)]
