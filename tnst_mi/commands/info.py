"""`tnst-mi info`: what is in density files, and what trained models are of.

Of each input it is said first how its frames are read, then what each of them is: a line for a frame, and below it the
grids or arrays of its file, where they are others than those of the file before.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tnst_mi.commands.arguments import InfoArguments
from tnst_mi.commands.base import given
from tnst_mi.errors import InputError
from tnst_mi.fields.density_unit import ReferenceDensity
from tnst_mi.frame import Frame
from tnst_mi.io import open_frames
from tnst_mi.io.files.listing import SeveralSequencesError
from tnst_mi.io.formats import describe
from tnst_mi.io.grids.contents import Contents
from tnst_mi.io.interpretation.conventions import Conventions, StoredFrame
from tnst_mi.io.sequence import FrameFiles, checked_shapes
from tnst_mi.machine.lazy import LazyModule
from tnst_mi.machine.terminal import printable
from tnst_mi.recipe.paths import MODELS
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.inputs import conventions_of
from tnst_mi.run.readable import Readable

#: It imports torch, which files of smoke do not need.
info_model = LazyModule("tnst_mi.commands.info_model")


def run(arguments: InfoArguments) -> int:
    """Describe every input; fails as the commands that read frames do, with their words."""
    if not arguments.files:
        raise InputError("info: expected one or more files or folders")
    recipe = Recipe().updated_by_flags(given(arguments.reading))
    shipped = {path.stem for path in MODELS.glob("*.safetensors")}
    for path in arguments.files:
        if path.suffix.lower() == ".safetensors" or (str(path) in shipped and not path.exists()):
            _show(info_model.lines_of_model(path))
            continue
        try:
            _describe_sequence(path, recipe)
        except SeveralSequencesError as error:
            for pattern in error.patterns:
                _describe_sequence(pattern, recipe)
            raise
    return 0


def _describe_sequence(path: Path, recipe: Recipe) -> None:
    """Print what is true of all frames of an input, then a line for each.

    Raises:
        InputError: frames cannot be read; what is in the files is printed nevertheless if they have no density, so that
            one can be chosen.
    """
    conventions = conventions_of(recipe)
    frames = open_frames(path, recipe.frame_range, conventions)
    described = _Described(frames, conventions)
    readable, reference = Readable(frames, recipe.skip_bad), ReferenceDensity()
    try:
        for frame in checked_shapes(described.frames(readable)):
            reference.add(frame.density)
        readable.require()
    except InputError:
        if described.lines:
            _show([_heading(path, frames), *described.lines])
        raise
    _show([_heading(path, frames), *described.readings, *(f"  {line}" for line in readable.lines())])
    if reference.value > 0:
        _show(
            [
                f"  reference density: {reference.value:.4g}, the 99th percentile of the smoky cells, which stylize "
                f"takes as 1 (density_scale = {reference.scale():.4g})"
            ]
        )
    _show(described.lines)


class _Described:
    """The frames of an input, and what is printed of each.

    Attributes:
        lines: of the frames and the contents of their files.
        readings: how velocities without a density are read.
    """

    def __init__(self, frames: FrameFiles, conventions: Conventions) -> None:
        self._frames, self._conventions = frames, conventions
        self.lines: list[str] = []
        self.readings: list[str] = []
        self._kinds: list[str] = []

    def frames(self, readable: Readable) -> Iterable[Frame]:
        """Read the frames, one after the other, and note how that went.

        Of a file without a density its contents are listed. One that holds but a velocity, as those that runs write, is
        left at that: nothing is wrong with it.
        """
        for index, file in enumerate(self._frames.files):
            try:
                stored = self._frames.stored(index)
                if stored.density is None:
                    contents = describe(file)
                    if stored.velocity is not None and not _has_more(stored):
                        self._add_velocity(file, stored, contents)
                        continue
                    self._add(f"{file.name}: no density", contents)
                frame = self._frames.frame_of(index, stored)
                contents = describe(file)
            except InputError as error:
                readable.reject(error)
                continue
            readable.keep(index, frame)
            self._add(f"{file.name}: {', '.join(_parts(frame, _box_of(stored, contents)))}", contents)
            yield frame

    def _add_velocity(self, file: Path, stored: StoredFrame, contents: list[Contents]) -> None:
        velocity, words = stored.velocity, []
        if velocity is not None and velocity.ndim == 4 and velocity.shape[-1] == 3 and velocity.size > 0:
            centred = stored.centred_velocity(self._conventions)
            words = [] if centred is None else [_velocity_in_words(centred)]
        reading = f"  read as: {stored.reading(self._conventions)}"
        self.readings += [reading] if reading not in self.readings else []
        self._add(f"{file.name}: {', '.join(['no frame', stored.lacking, *words])}", contents)

    def _add(self, line: str, contents: list[Contents]) -> None:
        kinds = [grid.kind for grid in contents]
        self.lines.append(f"  {line}")
        if kinds != self._kinds:
            self.lines += [f"    {grid}" for grid in contents]
        self._kinds = kinds


def _show(lines: Iterable[str]) -> None:
    for line in lines:
        print(printable(line))


def _heading(path: Path, frames: FrameFiles) -> str:
    if len(frames) == 1:
        return str(path)
    return f"{path}: {len(frames)} frames, {frames.numbers[0]} to {frames.numbers[-1]}"


def _has_more(stored: StoredFrame) -> bool:
    """Whether a file holds anything but a velocity."""
    return bool(stored.taken.others or stored.taken.left or stored.taken.obstacle)


def _box_of(stored: StoredFrame, contents: list[Contents]) -> str:
    """Where the density of a file is."""
    named = f"grid {stored.taken.density}: "
    return next((grid.box for grid in contents if grid.kind.startswith(named)), "")


def _parts(frame: Frame, box: str) -> list[str]:
    """The arrays of a frame, in words."""
    density = frame.density
    parts = [f"shape (z, y, x) {density.shape}", *([f"active {box}"] if box else [])]
    parts.append(f"density {density.min():g} to {density.max():g}, mass {frame.mass:g}")
    parts.append(f"{100.0 * float((density == 0.0).mean()):.1f}% of cells empty")
    if frame.velocity is not None:
        # Beyond the smoke a velocity matters little, and may be anything.
        smoke = density > 0.0
        parts.append(_velocity_in_words(frame.velocity[smoke] if smoke.any() else frame.velocity))
    if frame.obstacle is not None:
        parts.append(f"obstacle of {int(frame.obstacle.sum())} cells")
    return parts


def _velocity_in_words(velocity: np.ndarray) -> str:
    """The largest of some velocities (…, 3)."""
    return f"velocity at most {np.linalg.norm(velocity, axis=-1).max():g} cells per frame"
