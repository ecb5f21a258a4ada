"""`tnst-mi info`: what is in density files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from tnst_mi.commands.base import Command
from tnst_mi.errors import InputError


@dataclass(kw_only=True)
class Info(Command):
    """Describe files or folders of frames: arrays, shapes, ranges, mass, empty cells, largest velocity."""

    files: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="FILE…")]
    """Files or folders."""

    def run(self) -> int:
        """Print a paragraph for every frame."""
        from tnst_mi.io import open_frames

        if not self.files:
            raise InputError("info: expected one or more files or folders")
        for path in self.files:
            frames = open_frames(path)
            for file, frame in zip(frames.files, frames, strict=True):
                print(describe(file, frame))
        return 0


def describe(file: Path, frame: object) -> str:
    """A paragraph on one frame."""
    import numpy as np

    from tnst_mi.io.npz import read_headers

    density, velocity, obstacle = frame.density, frame.velocity, frame.obstacle
    lines = [str(file)]
    for name, header in read_headers(file).items():
        lines.append(f"  array {name!r}: {header.dtype}, shape {header.shape}")
    empty = 100.0 * float((density == 0.0).mean())
    lines.append(f"  density: {density.min():g} to {density.max():g}, mass {frame.mass:g}, {empty:.1f}% of cells empty")
    if velocity is not None:
        lines.append(f"  velocity: at most {np.linalg.norm(velocity, axis=-1).max():g} cells per frame")
    if obstacle is not None:
        lines.append(f"  obstacle: {int(obstacle.sum())} cells")
    return "\n".join(lines)
