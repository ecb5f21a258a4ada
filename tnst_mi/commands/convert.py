"""`tnst-mi convert`: density files from one format to another, or with other axes and units."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from tnst_mi.commands.base import Command
from tnst_mi.errors import InputError
from tnst_mi.recipe.recipe import Recipe

if TYPE_CHECKING:
    from collections.abc import Iterable

    from tnst_mi.frame import Frame
    from tnst_mi.io.conventions import Conventions
    from tnst_mi.io.sequence import FrameFiles


@dataclass(kw_only=True)
class ReadingFlags:
    """What the input's files do not say; the default is what they say, or what their format implies."""

    up: Annotated[
        Literal["y", "z"] | None, tyro.conf.arg(help_behavior_hint="(default: of .uni and Blender's .vdb z, else y)")
    ] = None
    """Axis of the files that points up."""
    flip: Annotated[str, tyro.conf.arg(metavar="AXES", help_behavior_hint="(default: none)")] = ""
    """Axes to mirror, such as x or xz, once y is up."""
    velocity_units: Annotated[
        Literal["cells-per-frame", "cells-per-time", "length-per-time"] | None,
        tyro.conf.arg(
            help_behavior_hint="(default: of .uni and Blender's .vdb cells-per-time, of other .vdb length-per-time, "
            "else cells-per-frame)"
        ),
    ] = None
    """What velocities count: cells per frame, or cells or the scene's units of length per unit of time."""
    dt: Annotated[
        float | None,
        tyro.conf.arg(metavar="TIME", help_behavior_hint="(default: 0.1 for cells-per-time, 1/24 for length-per-time)"),
    ] = None
    """Duration of a frame in that unit of time: 2.5 / fps for Blender's Mantaflow, 1 / fps for seconds."""
    voxel_size: Annotated[float | None, tyro.conf.arg(metavar="LENGTH", help_behavior_hint="(default: the file's)")] = (
        None
    )
    """Edge of a cell in the scene's unit of length, which .vdb files are written with."""


@dataclass(kw_only=True)
class Convert(Command):
    """Convert a density file, or a folder of numbered ones, to npz, .vol (Mitsuba), .uni (Mantaflow) or .vdb (OpenVDB).

    Velocities come out at the cell centres in cells per frame; npz and .vol have y up, .uni and .vdb z, as Blender.
    """

    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="INPUT")]
    """Density file, or folder of numbered ones."""
    output: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUTPUT")]
    """File, whose name tells the format, or new or empty folder."""
    format: Annotated[
        Literal["npz", "vol", "uni", "vdb"] | None, tyro.conf.arg(help_behavior_hint="(default: npz)")
    ] = None
    """Format of the files in a folder."""
    frames: Annotated[str | None, tyro.conf.arg(metavar="FIRST:LAST", help_behavior_hint="(default: all)")] = None
    """Numbers of the first and the last frame of a folder to convert."""
    reading: ReadingFlags = field(default_factory=ReadingFlags)
    """How to read the input."""

    def run(self) -> int:
        """Convert every frame."""
        from tqdm import tqdm

        from tnst_mi.io import open_frames
        from tnst_mi.io.sequence import save_frame

        selection = Recipe() if self.frames is None else Recipe().updated_by_flags({"frames": self.frames})
        frames = open_frames(self.input, selection.frame_range, _conventions(self.reading))
        files = self._files(frames)
        suffix, lost = files[0].suffix.lower(), None
        try:
            for file, frame in tqdm(
                zip(files, _one_shape(frames), strict=True), total=len(files), unit="frame", dynamic_ncols=True
            ):
                lost = lost or _lost(frame, suffix)
                save_frame(file, frame)
                # tqdm.write keeps the lines apart from the progress bar.
                tqdm.write(f"frame     {file}", file=sys.stdout)
        except InputError as error:
            if len(files) == 1 or not files[0].exists():
                raise
            raise InputError(
                f"{error}; the frames before it have been written: empty {self.output} before converting again"
            ) from None
        if lost:
            print(f"note: {suffix} files do not hold {lost}", file=sys.stderr)
        return 0

    def _files(self, frames: FrameFiles) -> list[Path]:
        """The files that the frames go to."""
        from tnst_mi.io.formats import FORMATS, files_around, require_format
        from tnst_mi.machine.disk import require_writable

        if not self.output.suffix or self.output.is_dir():
            suffix = f".{self.format}" if self.format else FORMATS[0]
            require_writable(self.output, self.input)
            return [self.output / f"{file.stem}{suffix}" for file in frames.files]
        suffix = require_format(self.output)
        if self.format not in (None, suffix[1:]):
            raise InputError(f"--format {self.format}: {self.output} is named as a {suffix} file; give one of both")
        if len(frames) > 1:
            raise InputError(f"{self.output}: a file holds one frame and there are {len(frames)}; give a folder")
        require_writable(self.output.parent, remedy=None)
        if set(map(_identity, files_around(self.output))) & set(map(_identity, frames.sources(0))):
            raise InputError(f"{self.output}: is the input, or would replace a part of it; give another name")
        return [self.output]


def _identity(path: Path) -> object:
    """What is equal for all names of a file, which does not have to exist."""
    if not path.exists():
        return path.resolve()
    status = path.stat()
    return status.st_dev, status.st_ino


def _one_shape(frames: FrameFiles) -> Iterable[Frame]:
    from tnst_mi.io.sequence import checked_shapes

    return checked_shapes(frames)


def _conventions(flags: ReadingFlags) -> Conventions:
    from tnst_mi.io.conventions import Conventions

    if not set(flags.flip) <= set("xyz,"):
        raise InputError(f"--flip {flags.flip}: expected axes out of x, y and z, such as x or xz")
    for flag, value in (("dt", flags.dt), ("voxel-size", flags.voxel_size)):
        if value is not None and not 0.0 < value < 1e9:
            raise InputError(f"--{flag} {value:g}: expected a number above 0")
    return Conventions(flags.up, flags.flip.replace(",", ""), flags.velocity_units, flags.dt, flags.voxel_size)


def _lost(frame: Frame, suffix: str) -> str | None:
    """What of a frame a format cannot hold, in words."""
    place = frame.placement
    if place is None or suffix == ".vdb":
        return None
    corner = ", ".join(f"{coordinate:g}" for coordinate in place.corner)
    return f"where the grid lies in its scene: voxel size {place.voxel_size:g}, corner ({corner}), {place.up} up"
