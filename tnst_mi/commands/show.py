"""`tnst-mi show`: runs as they will be seen, lit and side by side, before and after."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tnst_mi.commands.arguments import LOOK, ShowArguments
from tnst_mi.commands.base import checked, say, unit_of
from tnst_mi.commands.render import DEFAULT_SIZE, size_of
from tnst_mi.errors import InputError
from tnst_mi.fields.density_unit import scaled
from tnst_mi.fields.grid import Shape
from tnst_mi.frame import Frame
from tnst_mi.io.pictures.png import write_png
from tnst_mi.io.pictures.video import FRAMES_PER_SECOND, open_video
from tnst_mi.machine.backend import activate
from tnst_mi.machine.blender import require_blender
from tnst_mi.machine.disk import require_writable
from tnst_mi.machine.progress_bar import progress_bar
from tnst_mi.machine.terminal import duration, one_line
from tnst_mi.recipe.keys import Integer
from tnst_mi.recipe.recipe import KINDS, Recipe
from tnst_mi.rendering.blender import BlenderPainter
from tnst_mi.rendering.cameras.views import View
from tnst_mi.rendering.fire import Fire, find_fire
from tnst_mi.rendering.pictures import PathTracedPainter, Shot, shots_of_turn
from tnst_mi.rendering.smoke_colour import colour_said, find_colour
from tnst_mi.rendering.studio_camera import shows_all
from tnst_mi.run.panels import row
from tnst_mi.run.reopened import Reopened, reopened, shared_frames


@dataclass(frozen=True)
class _Column:
    """Frames that are shown in one place of each picture.

    Attributes:
        name: what is written above them.
        frames: all of them.
        indices: those that are shown, in order.
    """

    name: str
    frames: Sequence[Frame]
    indices: tuple[int, ...]


@dataclass(frozen=True)
class _Exhibits:
    """All that is shown: columns of frames, whose densities are multiplied by a factor."""

    columns: Sequence[_Column]
    factor: float = 1.0

    def frame(self, column: int, number: int) -> Frame:
        """The frame of a column in the order in which they are shown."""
        shown = self.columns[column]
        frame = shown.frames[shown.indices[number]]
        return replace(frame, density=scaled(frame.density, self.factor))

    def __iter__(self) -> Iterator[Frame]:
        """All frames, checked to be on grids of one shape; each is read once."""
        shape = None
        for column, shown in enumerate(self.columns):
            for number in range(len(shown.indices)):
                frame = self.frame(column, number)
                if shape not in (None, frame.density.shape):
                    raise InputError(
                        f"{shown.name}: has grids of {frame.density.shape} cells (z, y, x) and what is beside it "
                        f"{shape}: show them one by one"
                    )
                shape = frame.density.shape
                yield frame


def run(arguments: ShowArguments) -> int:
    """Say what it will take, render every panel, and write a picture or a film."""
    studio = arguments.studio
    look = checked("look", arguments.look, LOOK)
    turntable = None if arguments.turntable is None else checked("turntable", arguments.turntable, Integer(1, 100_000))
    samples = checked("spp", studio.spp or "64", Integer(1, 1_000_000))
    seed = checked("seed", studio.seed or "0", KINDS["seed"])
    size = DEFAULT_SIZE if studio.resolution is None else size_of(studio.resolution)
    selection = Recipe().updated_by_flags({} if arguments.frames is None else {"frames": arguments.frames})
    if not arguments.files:
        raise InputError("show: expected one or more runs or densities")
    if arguments.blender:
        require_blender()
        if studio.denoise:
            raise InputError("--denoise: is of OptiX, which denoises pictures of Mitsuba; leave it out with --blender")
    parts = [reopened(path) for path in arguments.files]
    chosen = _chosen(parts, selection.frame_range)
    count = len(chosen)
    out = _output(arguments, turntable or count)
    say(note for part in parts for note in part.notes)
    activate()
    exhibits = _Exhibits(_columns(parts, chosen))
    unit = unit_of(exhibits, "auto")
    views = _views(parts, chosen, exhibits.frame(0, 0).density.shape, size)
    if turntable is None:
        shots = [Shot(number, view, "") for number, view in enumerate(views)]
    else:
        shots = shots_of_turn(count, views[0], turntable)
    exhibits = replace(exhibits, factor=unit.factor)
    fire = find_fire(exhibits, studio.fire)
    colour = find_colour(exhibits, studio.colour)
    unit.note()
    say([] if fire is None else [fire.in_words])
    say(colour_said(colour))
    painter = _painter(arguments, exhibits, [shot.viewpoint for shot in shots], look, size, samples, seed, fire, colour)
    width, height = size
    panels = len(exhibits.columns) * len(shots)
    seconds = panels * painter.seconds(exhibits.frame(0, shots[0].frame), shots[0].viewpoint)
    what = f"{len(exhibits.columns)} × {width}x{height}" + (f", {len(shots)} pictures" if len(shots) > 1 else "")
    say([f"{what} in about {duration(seconds)}, written to {out}"])
    fps = next((part.recipe.fps for part in parts if part.recipe and part.recipe.fps), FRAMES_PER_SECOND)
    with (
        open_video(out, fps) if len(shots) > 1 else nullcontext() as film,
        progress_bar(total=panels, unit="panel", desc="rendering") as bar,
    ):
        for number, shot in enumerate(shots):
            images: list[tuple[str, np.ndarray]] = []
            for index, column in enumerate(exhibits.columns):
                image = painter.paint(exhibits.frame(index, shot.frame), shot.viewpoint, number)
                images.append((column.name, painter.shown(image)))
                bar.update()
            picture = row(images, least=1)
            if film is None:
                write_png(out, picture)
            else:
                film.add(picture)
    print(f"{'picture' if len(shots) == 1 else 'video'}   {out}")
    return 0


def _chosen(parts: Sequence[Reopened], frames: tuple[float, float] | None) -> list[tuple[int, ...]]:
    """The frames to show, each by its index in every part: the last that all have, or those with numbers in a range.

    Raises:
        InputError: there are none.
    """
    together = shared_frames(parts)
    if frames is None:
        return together[-1:]
    first, last = frames
    numbers = [parts[0].numbers[indices[0]] for indices in together]
    chosen = [
        indices
        for indices, number in zip(together, numbers, strict=True)
        if number is not None and first <= number <= last
    ]
    if not chosen:
        known = ", ".join(str(number) for number in numbers)
        raise InputError(one_line(f"--frames {first}:{last}: selects none; the frames that all have are {known}"))
    return chosen


def _columns(parts: Sequence[Reopened], chosen: Sequence[tuple[int, ...]]) -> list[_Column]:
    """Each part in a column, and before it the input of its run, unless another has the same."""
    columns, known = [], set()
    for place, part in enumerate(parts):
        indices = tuple(at[place] for at in chosen)
        source = None if part.record is None else part.record.get("input")
        if part.inputs is not None and source not in known:
            known.add(source)
            several = len({other.record.get("input") for other in parts if other.record is not None}) > 1
            columns.append(_Column(f"before {part.title}" if several else "before", part.inputs, indices))
        columns.append(_Column(part.title, part.frames, indices))
    return columns


def _views(
    parts: Sequence[Reopened], chosen: Sequence[tuple[int, ...]], shape: Shape, size: tuple[int, int]
) -> list[View]:
    """The main view of the first run for each chosen frame, which follows the camera of its shot; else the front.

    A shot's camera that cannot stand in the studio is said, and its frames are seen from the studio's distance.
    """
    place = next((place for place, part in enumerate(parts) if part.recipe is not None), None)
    recipe = None if place is None else parts[place].recipe
    if place is None or recipe is None:
        return [Recipe().main_view] * len(chosen)
    views, moved = [], []
    for indices in chosen:
        name = parts[place].names[indices[place]]
        shot = parts[place].shots.get(name)
        view = recipe.main_view if shot is None else replace(recipe, shots=(shot,)).main_view
        if shot is not None and not shows_all(view, shape, size):
            view = (view[0], max(view[1], 0.0))
            moved.append(name)
        views.append(view)
    if moved:
        frames = moved[0] if len(moved) == 1 else f"{moved[0]} and {len(moved) - 1} more"
        say(
            [
                f"note: {frames}: the shot's camera is below the studio's ground, or too near to show all of the grid; "
                "shown from its azimuth, at the studio's distance"
            ]
        )
    return views


def _output(arguments: ShowArguments, count: int) -> Path:
    """The file for so many pictures.

    Raises:
        InputError: it has another kind of name, cannot be written, or is there already.
    """
    suffix = ".png" if count == 1 else ".mp4"
    out = arguments.out or Path(f"tnst_mi-show{suffix}")
    if out.suffix.lower() != suffix:
        what = "one picture" if count == 1 else f"{count} pictures"
        raise InputError(f"--out {out}: expected a name that ends in {suffix}, for {what}")
    require_writable(out.parent, remedy=None)
    if out.is_dir() or (out.exists() and not arguments.overwrite):
        raise InputError(f"{out}: is there already; give another name with --out, or replace it with --overwrite")
    return out


def _painter(
    arguments: ShowArguments,
    exhibits: _Exhibits,
    views: Sequence[View],
    look: str,
    size: tuple[int, int],
    samples: int,
    seed: int,
    fire: Fire | None,
    colour: str | None,
) -> PathTracedPainter | BlenderPainter:
    """What renders the panels."""
    if arguments.blender:
        shape = exhibits.frame(0, 0).density.shape
        return BlenderPainter(shape, views, look, size, samples, seed, fire, colour)
    denoise = arguments.studio.denoise
    painter = PathTracedPainter(exhibits, views, look, "volpath", size, samples, seed, denoise, fire, colour)
    if arguments.studio.denoise and not painter.denoised:
        say(["warning: --denoise: OptiX is not at hand, the pictures keep their noise"])
    return painter
