"""`tnst-mi info`: what is in density files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from tnst_mi.commands.arguments import InfoArguments
from tnst_mi.commands.base import given
from tnst_mi.errors import InputError
from tnst_mi.fields.density_unit import ReferenceDensity
from tnst_mi.frame import Frame
from tnst_mi.io import open_frames
from tnst_mi.io.array_frames import ARRAY_FORMATS
from tnst_mi.io.files.listing import SeveralSequencesError
from tnst_mi.io.formats import describe
from tnst_mi.io.interpretation.conventions import Conventions, StoredFrame
from tnst_mi.io.sequence import FrameFiles, checked_shapes
from tnst_mi.machine.terminal import printable
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.inputs import conventions_of
from tnst_mi.run.readable import require_readable


def run(arguments: InfoArguments) -> int:
    """Print a paragraph for every file; fails as the commands that read frames do, with their words."""
    if not arguments.files:
        raise InputError("info: expected one or more files or folders")
    recipe = Recipe().updated_by_flags(given(arguments.reading))
    for path in arguments.files:
        try:
            _describe_sequence(path, conventions_of(recipe), recipe.skip_bad)
        except SeveralSequencesError as error:
            for pattern in error.patterns:
                _describe_sequence(pattern, conventions_of(recipe), recipe.skip_bad)
            raise
    return 0


def _describe_sequence(path: Path, conventions: Conventions, skip_bad: bool) -> None:
    """Print a paragraph for every file of an input, and what is true of all."""
    frames = open_frames(path, given=conventions)
    reference = ReferenceDensity()
    for frame in checked_shapes(_described(frames, conventions, skip_bad)):
        reference.add(frame.density)
    of_grid = frames.grid_notes if reference.value > 0 else ()
    _show([f"{path}: note: {note}" for note in (*frames.notes, *of_grid)])
    if reference.value > 0:
        _show(
            [
                f"{path}: reference density {reference.value:.4g}: the 99th percentile of the smoky cells, which "
                f"stylize takes as 1 (density_scale = {reference.scale():.4g})"
            ]
        )


def _show(lines: Iterable[str]) -> None:
    for line in lines:
        print(printable(line))


def _described(frames: FrameFiles, conventions: Conventions, skip_bad: bool) -> Iterator[Frame]:
    """The frames that can be read, of each of which it is printed what is in its file and how that is read.

    Of a file without a density it is printed what is there instead, so that it can be chosen. One that holds but a
    velocity, as those that runs write, is left at that.
    """
    bad = []
    for index, file in enumerate(frames.files):
        try:
            stored = frames.stored(index)
            if stored.density is None:
                _show([str(file), *describe(file), *_describe_alone(stored, conventions)])
                if stored.velocity is not None and not (
                    stored.taken.others or stored.taken.left or stored.taken.obstacle
                ):
                    print(f"  no frame: {stored.lacking}")
                    continue  # nothing is wrong with it: runs write velocities by themselves
            frame = frames.frame_of(index, stored)
        except InputError as error:
            bad.append(str(error))
            continue
        _show([str(file), *describe(file), f"  read as: {frame.reading}", *_describe_notes(frame)])
        # The shape of plain arrays has been described already.
        if file.suffix.lower() not in ARRAY_FORMATS:
            print(f"  shape (z, y, x): {frame.density.shape}")
        _show(describe_frame(frame))
        yield frame
    require_readable(bad, len(frames), skip_bad)


def _describe_alone(stored: StoredFrame, conventions: Conventions) -> list[str]:
    """The velocity of a file without a density."""
    velocity = stored.velocity
    if velocity is None or velocity.ndim != 4 or velocity.shape[-1] != 3 or velocity.size == 0:
        return []
    centred = stored.centred_velocity(conventions)
    return [] if centred is None else [f"  read as: {stored.reading(conventions)}", *describe_velocity(centred)]


def _describe_notes(frame: Frame) -> list[str]:
    return [f"  note: {note.text}" + (f" ({note.detail})" if note.detail else "") for note in frame.notes]


def describe_frame(frame: Frame) -> list[str]:
    """The contents of the arrays of a frame, one line each."""
    density = frame.density
    empty = 100.0 * float((density == 0.0).mean())
    lines = [f"  density: {density.min():g} to {density.max():g}, mass {frame.mass:g}, {empty:.1f}% of cells empty"]
    if frame.velocity is not None:
        lines += describe_velocity(frame.velocity)
    if frame.obstacle is not None:
        lines.append(f"  obstacle: {int(frame.obstacle.sum())} cells")
    return lines


def describe_velocity(velocity: np.ndarray) -> list[str]:
    """The largest velocity of a grid (D, H, W, 3), in one line."""
    return [f"  velocity: at most {np.linalg.norm(velocity, axis=-1).max():g} cells per frame"]
