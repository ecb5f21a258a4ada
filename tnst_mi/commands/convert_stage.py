"""`tnst-mi convert INPUT out.usda`: frames as a volume on a stage of USD."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

from tnst_mi.commands.arguments import ConvertArguments
from tnst_mi.commands.base import given, say
from tnst_mi.errors import InputError, UnforeseenError
from tnst_mi.io.atomic import UNFINISHED, remove_folder, sync
from tnst_mi.io.files.folders import densities_of_run
from tnst_mi.io.files.frame_numbers import Number
from tnst_mi.io.pictures.video import FRAMES_PER_SECOND
from tnst_mi.io.sequence import FrameFiles, checked_shapes, save_frame
from tnst_mi.io.stages.own_stages import require_own
from tnst_mi.io.stages.smoke_volume import VolumeFrame, up_axis, volume_frame
from tnst_mi.io.stages.usd_stage import usd_library, write_stage
from tnst_mi.machine.disk import require_names, require_writable
from tnst_mi.machine.progress_bar import progress_bar
from tnst_mi.machine.terminal import printable, some_of
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.folder import holds_run
from tnst_mi.run.readable import Readable, require_readable

# Flags that choose among frames, or say of them what the stage says: with others, files hold something else than asked.
_OF_THE_STAGE = ("frames", "up", "fps", "skip_bad")

# Names of grids in the line that says what was written.
_SHOWN = 8


def convert_to_stage(arguments: ConvertArguments, recipe: Recipe, frames: FrameFiles) -> int:
    """Write a stage that shows frames. OpenVDB files stay where they are; others are written beside the stage.

    Raises:
        InputError: there is no library, the stage cannot be written, or a frame cannot be used.
    """
    output = arguments.output
    if arguments.format not in (None, "vdb"):
        raise InputError(f"--format {arguments.format}: a stage shows .vdb files; leave it out")
    usd_library(output)
    if densities := densities_of_run(frames.files[0]):
        raise InputError(f"{arguments.input}: holds the velocity v* of a run, whose smoke is in {densities}; give that")
    require_writable(output.parent, remedy=None)
    require_own(output)
    changes = [flag for flag in given(arguments.reading) if flag not in _OF_THE_STAGE]
    if not changes and all(file.suffix.lower() == ".vdb" for file in frames.files):
        volumes = _volumes(frames.files, frames.numbers, recipe.skip_bad)
        say(f"note: {note}" for note in frames.notes)
        _write(arguments, volumes, recipe.fps, recipe.up)
        return 0
    folder = output.with_name(f"{output.stem}_vdb")
    require_writable(folder, arguments.input, "remove it, or give the stage another name")
    require_names(folder, [file.stem for file in frames.files])
    readable = Readable(frames, recipe.skip_bad)
    for _ in readable:  # damaged frames are to be found before the first is written
        pass
    frames = frames.only(readable.kept)
    say(readable.lines())
    _write_files(folder, frames)
    try:
        files = [folder / f"{file.stem}.vdb" for file in frames.files]
        _write(arguments, _volumes(files, frames.numbers), recipe.fps)
    except BaseException:
        remove_folder(folder)
        raise
    return 0


def _volumes(files: Sequence[Path], numbers: Sequence[Number | None], skip_bad: bool = False) -> list[VolumeFrame]:
    """What the stage says of each file; all that cannot be read are named at once."""
    volumes, bad = list[VolumeFrame](), list[str]()
    for file, number in zip(files, numbers, strict=True):
        try:
            volumes.append(volume_frame(file, number))
        except UnforeseenError:  # it may be our fault: leaving the frame out would hide it
            raise
        except InputError as error:
            bad.append(str(error))
    require_readable(bad, len(files), skip_bad)
    if bad:
        say([f"note: left out, since they cannot be read: {some_of(bad)}"])
    return volumes


def _write_files(folder: Path, frames: FrameFiles) -> None:
    """Write frames as OpenVDB files into a new folder, which appears once it has all of them."""
    unfinished = folder.with_name(f"{UNFINISHED}{folder.name}.{os.getpid()}")
    try:
        for file, frame in progress_bar(
            zip(frames.files, checked_shapes(frames), strict=True), total=len(frames), unit="frame"
        ):
            save_frame(unfinished / f"{file.stem}.vdb", frame)
        os.replace(unfinished, folder)
        sync(folder.parent)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _write(
    arguments: ConvertArguments, volumes: Sequence[VolumeFrame], fps: float | None, up: str | None = None
) -> None:
    """Write the stage, and say what is in it and what was assumed."""
    notes = list[str]()
    if up is None:
        up, because = up_axis(volumes)
        notes += [f"note: {up} is up, {because} (--up)"] if because else []
    frames_per_second = fps or _rate_of_run(arguments.input)
    if frames_per_second is None:
        frames_per_second = FRAMES_PER_SECOND
        notes.append(f"note: {frames_per_second:g} frames per second are assumed (--fps)")
    paths = write_stage(arguments.output, volumes, up, frames_per_second)
    if any(Path(path).is_absolute() for path in paths):
        notes.append(
            f"note: {arguments.output} names its files by absolute paths, since links, or another drive, are between: "
            "once they are moved, convert again"
        )
    say(notes)
    numbers = [volume.number for volume in volumes if volume.number is not None]
    span = f"frames {numbers[0]} to {numbers[-1]}" if len(numbers) > 1 else "1 frame"
    grids = some_of(list(dict.fromkeys(field.grid for volume in volumes for field in volume.fields)), _SHOWN)
    print(printable(f"stage     {arguments.output}: {span}, {up} up, in metres, {frames_per_second:g} fps: {grids}"))


def _rate_of_run(path: Path) -> float | None:
    """The frames per second of the recipe of a run; None if it has none, or the path is no run."""
    if not holds_run(path):
        return None
    try:
        return Recipe.from_toml(path / "recipe.toml").fps
    except InputError:  # such as a picture that is gone: what is assumed instead is said
        return None
