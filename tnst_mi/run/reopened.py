"""Results, opened again: the frames that a run has finished, beside those of its input; or other densities."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import open_frames
from tnst_mi.io.files.frame_numbers import Number
from tnst_mi.io.interpretation.conventions import Conventions
from tnst_mi.io.sequence import FrameFiles
from tnst_mi.machine.terminal import displayable, one_line
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.views import View, distance_of
from tnst_mi.rendering.smoke_colour import own_colours, shown_colours, shown_grid
from tnst_mi.run.folder import DAMAGE, holds_run, is_file_name
from tnst_mi.run.inputs import FramesOnAccess, conventions_of
from tnst_mi.run.resuming import recipe_of_run


@dataclass(frozen=True)
class Reopened:
    """What a path holds.

    Attributes:
        path: as it was given.
        frames: the stylized frames of a run with what it carried, or other densities; each access reads a file.
        names: of the frames.
        numbers: of the frames; None for a single file without one.
        record: the contents of run.json; None for densities.
        recipe: of the run; None likewise.
        shots: where the camera of the run's shot sees each frame from, by its name; empty without one.
        temperature: the grid whose temperatures a run shows as colours, and the largest; None if it shows none.
        inputs: the frames that were stylized, in the same order; None where they cannot be read.
        notes: what is to be said.
    """

    path: Path
    frames: Sequence[Frame]
    names: tuple[str, ...]
    numbers: tuple[Number | None, ...]
    record: Mapping[str, Any] | None = None
    recipe: Recipe | None = None
    shots: Mapping[str, View] = field(default_factory=dict)
    temperature: tuple[str, float] | None = None
    inputs: Sequence[Frame] | None = None
    notes: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """A short name."""
        path = self.path.resolve()
        return displayable(path.name if path.is_dir() else path.stem)

    def recorded(self, name: str) -> Mapping[str, Any]:
        """The record of a frame of a run; empty for densities."""
        frames = () if self.record is None else self.record["frames"]
        return next((frame for frame in frames if frame["name"] == name), {})

    def colour(self, frame: Frame) -> np.ndarray | None:
        """The colours in which a frame is shown, (D, H, W, 3) display values, 0 or more; None for a grey one.

        Runs show colours as their recipe says, other densities those that they have.

        Raises:
            InputError: the colours cannot be used.
        """
        if self.recipe is None:
            return own_colours(frame)
        if self.recipe.colour == "off":
            return None
        name, hottest = shown_grid(tuple(frame.grids), self.temperature)
        return shown_colours(frame.grids, name, frame.name, frame.density.shape, hottest)


def reopened(path: Path) -> Reopened:
    """Open the folder of a run, finished or not, or densities in a file, a folder or a pattern.

    Raises:
        InputError: nothing is there, the record of the run is damaged, or it has not finished a frame.
    """
    if not holds_run(path):
        files = open_frames(path)
        return Reopened(path, files, tuple(displayable(file.stem) for file in files.files), tuple(files.numbers))
    recipe = recipe_of_run(path)
    try:
        record = json.loads((path / "run.json").read_text("utf-8"))
        suffix = f".{record.get('format', 'npz')}"
        finished = {str(frame["name"]): frame["number"] for frame in record["frames"] if frame["complete"]}
        _require_numbers(record)
        source = record.get("input")
        shots = {str(name): _view(view) for name, view in record.get("shots", {}).items()}
        temperature = _temperature(record.get("temperature"))
    except DAMAGE:
        raise InputError(f"{path / 'run.json'}: damaged, so it does not tell what its run has finished") from None
    names = [name for name in finished if is_file_name(name) and (path / "density" / f"{name}{suffix}").is_file()]
    if not names:
        raise InputError(f"{path}: its run has not finished a frame; go on with it, or wait for the first")
    inputs, notes = _inputs(path, source, recipe, names)
    results = _results(path, names, suffix, inputs)
    numbers = tuple(finished[name] for name in names)
    return Reopened(path, results, tuple(names), numbers, record, recipe, shots, temperature, inputs, notes)


def _require_numbers(record: Mapping[str, Any]) -> None:
    """Check what is compared of a record, and of its frames.

    Raises:
        ValueError, TypeError, LookupError: something is missing, or is no number.
    """
    if not 0 < float(record["density_scale"]) < np.inf:
        raise ValueError
    for key in ("inputs", "files", "weights", "versions"):
        dict(record.get(key, {}))
    for frame in record["frames"]:
        for key in ("mass_before", "mass_after", "largest_displacement"):
            float(frame[key])
        for key in ("loss_before", "loss_after", "folded"):
            float(frame.get(key) or 0.0)


def shared_frames(parts: Sequence[Reopened]) -> list[tuple[int, ...]]:
    """Which frames go together: for each, its index in every part.

    They are those of one number, or of one name where there are none; a single frame goes with any other single one.

    Raises:
        InputError: there are none.
    """
    if all(len(part.frames) == 1 for part in parts):
        return [(0,) * len(parts)]
    keys = [part.numbers if None not in part.numbers else part.names for part in parts]
    together = [tuple(part.index(key) for part in keys) for key in keys[0] if all(key in part for part in keys)]
    if not together:
        ranges = "; ".join(f"{part.path} has {_range(key)}" for part, key in zip(parts, keys, strict=True))
        raise InputError(one_line(f"no frame is in all of them: {ranges}"))
    return together


def _view(numbers: Sequence[float]) -> View:
    """A view of a record.

    Raises:
        ValueError, TypeError: it is none.
    """
    azimuth, elevation, *distance = (float(number) for number in numbers)
    if len(distance) > 1 or not np.isfinite([azimuth, elevation, *distance]).all():
        raise ValueError(f"{numbers} are not a view")
    view: View = (azimuth, elevation, distance[0]) if distance else (azimuth, elevation)
    distance_of(view)
    return view


def _temperature(grid: Sequence[Any] | None) -> tuple[str, float] | None:
    """What a record says of the temperatures that are shown as colours.

    Raises:
        ValueError, TypeError: it is damaged.
    """
    if grid is None:
        return None
    name, hottest = grid
    if not isinstance(name, str) or not 0 < float(hottest) < np.inf:
        raise ValueError(f"{grid} are not a grid and its largest value")
    return name, float(hottest)


class _Results(FramesOnAccess):
    """The stylized frames of a run, on the grid of its input."""

    def __init__(self, files: Sequence[Path], inputs: FrameFiles) -> None:
        self._files, self._inputs = files, inputs

    def __len__(self) -> int:
        return len(self._files)

    def _part(self, chosen: slice) -> _Results:
        return _Results(self._files[chosen], self._inputs.only(range(len(self))[chosen]))

    def _frame(self, index: int) -> Frame:
        file = self._files[index]
        stored = self._inputs.result(file, simulated=True)
        return stored.frame(Conventions(), displayable(file.stem), self._inputs.numbers[index])


def _inputs(
    path: Path, source: object, recipe: Recipe, names: Sequence[str]
) -> tuple[FrameFiles | None, tuple[str, ...]]:
    """The frames of the given names in the input of a run, or a note that there are none."""
    if not isinstance(source, str):
        return None, (f"note: {path}: its input was no file, so what was before is not known",)
    try:
        files = open_frames(source, recipe.frame_range, conventions_of(recipe))
    except InputError as error:
        return None, (one_line(f"note: {path}: its input cannot be read again ({error})"),)
    places = {displayable(file.stem): index for index, file in enumerate(files.files)}
    if not set(names) <= set(places):
        return None, (one_line(f"note: {path}: its input {source} does not have all of its frames any more"),)
    return files.only(places[name] for name in names), ()


def _results(path: Path, names: Sequence[str], suffix: str, inputs: FrameFiles | None) -> Sequence[Frame]:
    if inputs is not None:
        return _Results([path / "density" / f"{name}{suffix}" for name in names], inputs)
    files = open_frames(path / "density")
    places = {displayable(file.stem): index for index, file in enumerate(files.files)}
    return files.only(places[name] for name in names)


def _range(keys: Sequence[object]) -> str:
    return f"{keys[0]}" if len(keys) == 1 else f"{keys[0]} to {keys[-1]}"
