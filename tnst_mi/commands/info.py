"""`tnst-mi info`: what is in density files."""

from __future__ import annotations

import numpy as np

from tnst_mi.commands.arguments import InfoArguments
from tnst_mi.commands.base import open_input
from tnst_mi.errors import InputError
from tnst_mi.fields.density_unit import ReferenceDensity
from tnst_mi.frame import Frame
from tnst_mi.io.conventions import Conventions
from tnst_mi.io.formats import describe
from tnst_mi.io.sequence import FrameFiles


def run(arguments: InfoArguments) -> int:
    """Print a paragraph for every file."""
    if not arguments.files:
        raise InputError("info: expected one or more files or folders")
    for path in arguments.files:
        frames = open_input(path)
        reference = ReferenceDensity()
        for index, file in enumerate(frames.files):
            print("\n".join([str(file), *describe(file), *_describe_contents(frames, index, reference)]))
        if reference.value > 0:
            print(
                f"{path}: reference density {reference.value:.4g}: the 99th percentile of the smoky cells, which "
                f"stylize takes as 1 (density_scale = {reference.scale():.4g})"
            )
    return 0


def _describe_contents(frames: FrameFiles, index: int, reference: ReferenceDensity) -> list[str]:
    """How a file of a sequence is read, and what it contains, which is added to the reference density."""
    stored = frames.stored(index)
    # For npz, the shape is already described, and there is only one way to read it.
    plain = frames.files[index].suffix.lower() == ".npz"
    reading = [] if plain else [f"  read as: {stored.reading(Conventions())}"]
    if stored.density is not None:
        frame = frames.frame_of(index, stored)
        reference.add(frame.density)
        shape = [] if plain else [f"  shape (z, y, x): {frame.density.shape}"]
        return reading + shape + describe_frame(frame)
    velocity = stored.velocity
    if velocity is None or velocity.ndim != 4 or velocity.shape[-1] != 3 or velocity.size == 0:
        return []
    centred = stored.centred_velocity(Conventions())
    return [] if centred is None else reading + describe_velocity(centred)


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
