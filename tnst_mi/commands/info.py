"""`tnst-mi info`: what is in density files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from tnst_mi.commands.base import Command
from tnst_mi.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from tnst_mi.frame import Frame
    from tnst_mi.io.sequence import FrameFiles


@dataclass(kw_only=True)
class Info(Command):
    """Describe files or folders of frames: arrays or grids, how they are read, shape, ranges, mass, largest velocity.

    Of a file without a density, such as the velocities of a run, what is there is described.
    """

    files: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="FILE…")]
    """Files or folders."""

    def run(self) -> int:
        """Print a paragraph for every file."""
        from tnst_mi.io import open_frames
        from tnst_mi.io.formats import describe

        if not self.files:
            raise InputError("info: expected one or more files or folders")
        for path in self.files:
            frames = open_frames(path)
            for index, file in enumerate(frames.files):
                print("\n".join([str(file), *describe(file), *_describe_contents(frames, index)]))
        return 0


def _describe_contents(frames: FrameFiles, index: int) -> list[str]:
    """How a file of a sequence is read, and what comes out."""
    from tnst_mi.io.conventions import Conventions

    stored = frames.stored(index)
    # Of an npz the shape has been told, and there is one way to read it.
    plain = frames.files[index].suffix.lower() == ".npz"
    reading = [] if plain else [f"  read as: {stored.reading(Conventions())}"]
    if stored.density is not None:
        frame = frames.frame_of(index, stored)
        shape = [] if plain else [f"  shape (z, y, x): {frame.density.shape}"]
        return reading + shape + describe_frame(frame)
    velocity = stored.velocity
    if velocity is None or velocity.ndim != 4 or velocity.shape[-1] != 3 or velocity.size == 0:
        return []
    return reading + describe_velocity(stored.centred_velocity(Conventions()))


def describe_frame(frame: Frame) -> list[str]:
    """What the arrays of a frame hold, a line each."""
    density = frame.density
    empty = 100.0 * float((density == 0.0).mean())
    lines = [f"  density: {density.min():g} to {density.max():g}, mass {frame.mass:g}, {empty:.1f}% of cells empty"]
    if frame.velocity is not None:
        lines += describe_velocity(frame.velocity)
    if frame.obstacle is not None:
        lines.append(f"  obstacle: {int(frame.obstacle.sum())} cells")
    return lines


def describe_velocity(velocity: np.ndarray) -> list[str]:
    """The largest velocity of a grid (D, H, W, 3), a line."""
    import numpy as np

    return [f"  velocity: at most {np.linalg.norm(velocity, axis=-1).max():g} cells per frame"]
