"""`tnst-mi convert`: density files from one format to another, with other axes and units, or on a stage of USD."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from tqdm import tqdm

from tnst_mi.commands.arguments import ConvertArguments
from tnst_mi.commands.base import checked, given, say
from tnst_mi.commands.convert_stage import convert_to_stage
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import open_frames
from tnst_mi.io.formats import FORMATS, files_around, held, require_format
from tnst_mi.io.interpretation.grid_names import listed
from tnst_mi.io.sequence import FrameFiles, checked_shapes, save_frame
from tnst_mi.io.stages.usd_stage import STAGES
from tnst_mi.machine.disk import require_names, require_writable
from tnst_mi.machine.lazy import LazyModule
from tnst_mi.machine.progress_bar import progress_bar
from tnst_mi.recipe.recipe import KINDS, Recipe
from tnst_mi.run.inputs import conventions_of
from tnst_mi.run.readable import Readable

if TYPE_CHECKING:
    from tnst_mi.realtime import model, onnx_export
else:
    # They import torch, which smoke does not need.
    model, onnx_export = LazyModule("tnst_mi.realtime.model"), LazyModule("tnst_mi.realtime.onnx_export")


def run(arguments: ConvertArguments) -> int:
    """Convert every frame."""
    if arguments.format is not None:
        checked("format", arguments.format, KINDS["format"])
    if arguments.output.suffix.lower() == ".onnx":
        return _model(arguments)
    # Other programs expect the whole grid, at rest.
    recipe = Recipe().updated_by_flags({"crop": "off"} | given(arguments.reading))
    every = open_frames(arguments.input, recipe.frame_range, conventions_of(recipe))
    if arguments.output.suffix.lower() in STAGES and not arguments.output.is_dir():
        return convert_to_stage(arguments, recipe, every)
    _files(arguments, every)  # what is asked for is checked before anything is read
    readable = Readable(every, recipe.skip_bad)
    for _ in readable:  # damaged frames are to be found before the first is written
        pass
    frames = every.only(readable.kept)
    files = _files(arguments, frames)
    say(readable.lines())
    suffix, lost = files[0].suffix.lower(), dict[str, None]()
    try:
        for file, frame in progress_bar(
            zip(files, checked_shapes(frames), strict=True), total=len(files), unit="frame"
        ):
            lost |= dict.fromkeys(_lost(frame, file))
            save_frame(file, frame)
            # tqdm.write keeps the lines apart from the progress bar.
            tqdm.write(f"frame     {file}", file=sys.stdout)
    except InputError as error:
        if len(files) == 1 or not files[0].exists():
            raise
        raise InputError(
            f"{error}; the frames before it have been written: empty {arguments.output} before converting again"
        ) from None
    say(f"note: {suffix} files do not hold {what}" for what in lost)
    return 0


def _model(arguments: ConvertArguments) -> int:
    """Write a model of `tnst-mi train` as ONNX."""
    if unused := [*(["format"] if arguments.format else []), *given(arguments.reading)]:
        raise InputError(
            f"--{unused[0].replace('_', '-')}: says how smoke is read, and {arguments.output} is a network"
        )
    require_writable(arguments.output.parent, remedy=None)
    onnx_export.write_onnx(model.read_model(arguments.input), arguments.output)
    print(f"model     {arguments.output}")
    return 0


def _files(arguments: ConvertArguments, frames: FrameFiles) -> list[Path]:
    """The output file of each frame."""
    output = arguments.output
    if not output.suffix or output.is_dir():
        suffix = f".{arguments.format}" if arguments.format else FORMATS[0]
        require_writable(output, arguments.input)
        require_names(output, [file.stem for file in frames.files])
        return [output / f"{file.stem}{suffix}" for file in frames.files]
    suffix = require_format(output, (*FORMATS, *STAGES))
    if arguments.format not in (None, suffix[1:]):
        raise InputError(f"--format {arguments.format}: {output} is named as a {suffix} file; give one of both")
    if len(frames) > 1:
        raise InputError(f"{output}: a file holds one frame and there are {len(frames)}; give a folder")
    require_writable(output.parent, remedy=None)
    if set(map(_identity, files_around(output))) & set(map(_identity, frames.sources(0))):
        raise InputError(f"{output}: is the input, or would replace a part of it; give another name")
    return [output]


def _identity(path: Path) -> object:
    """A key that is equal for all names of a file, which need not exist."""
    if not path.exists():
        return path.resolve()
    status = path.stat()
    return status.st_dev, status.st_ino


def _lost(frame: Frame, file: Path) -> Iterator[str]:
    """What the format of a file cannot store of a frame, in words; for all frames of a sequence the same."""
    place, suffix = frame.placement, file.suffix.lower()
    kept = held(file.stem, suffix, frame.grids)
    if left := [name for name in frame.grids if name not in kept]:
        yield f"grids of such names: {listed(left, in_quotes=False)}"
    if place is not None and suffix != ".vdb":
        corner = ", ".join(f"{coordinate:g}" for coordinate in place.corner)
        yield f"where the grid lies in its scene: voxel size {place.voxel_size:g}, corner ({corner}), {place.up} up"
