"""`tnst-mi render`: pictures and turntable videos of density files, plain or lit in a studio."""

from __future__ import annotations

import itertools
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import nullcontext

from tqdm import tqdm

from tnst_mi.commands.arguments import INTEGRATOR, LOOK, RENDER_VIEWS, RenderArguments
from tnst_mi.commands.base import cameras_of, checked, given, say, unit_of, view_of
from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Shape
from tnst_mi.frame import Frame
from tnst_mi.io import open_frames
from tnst_mi.io.pictures.exr import write_exr
from tnst_mi.io.pictures.png import write_png
from tnst_mi.io.pictures.video import FRAMES_PER_SECOND, Video, open_video
from tnst_mi.machine.backend import activate
from tnst_mi.machine.disk import require_names, require_writable
from tnst_mi.machine.progress_bar import progress_bar
from tnst_mi.machine.terminal import duration, quoted
from tnst_mi.recipe.keys import Integer
from tnst_mi.recipe.recipe import KINDS, Recipe
from tnst_mi.rendering import pictures
from tnst_mi.rendering.cameras.camera import Camera, Viewpoint
from tnst_mi.rendering.cameras.shots import camera_of
from tnst_mi.rendering.cameras.views import View, common_size
from tnst_mi.rendering.fire import find_fire
from tnst_mi.rendering.looks import gamma
from tnst_mi.rendering.pictures import Attributes, Painter, PathTracedPainter, Shot
from tnst_mi.rendering.shot_pictures import ShotPainter, shot_size
from tnst_mi.rendering.smoke_colour import colour_name, colour_said, find_colour
from tnst_mi.run.inputs import ScaledFrames, conventions_of
from tnst_mi.run.readable import Readable

#: Longest edge of a picture in pixels, the maximum of the video standard.
_LARGEST_SIDE = 8192

#: (width, height) of path-traced pictures.
DEFAULT_SIZE = (288, 384)


def run(arguments: RenderArguments) -> int:
    """Render every view of every frame, or a turntable."""
    look, studio = arguments.look, arguments.studio
    integrator = arguments.integrator or ("volpath" if look else "emission_absorption")
    path_traced = integrator != "emission_absorption"
    _check_flags(arguments, path_traced)
    turntable = None if arguments.turntable is None else checked("turntable", arguments.turntable, Integer(1, 100_000))
    samples = checked("spp", studio.spp or "64", Integer(1, 1_000_000))
    seed = checked("seed", studio.seed or "0", KINDS["seed"])
    recipe = Recipe().updated_by_flags(given(arguments.renderer) | given(arguments.reading))
    if recipe.gamma == "auto":
        raise InputError("--gamma auto: is of stylize, where it follows from its look; give --look")
    if recipe.keyframes:
        raise InputError(f"--gamma {arguments.renderer.gamma}: render takes one value, keyframes are of stylize")
    views = [view_of(text) for text in arguments.views]
    shot = arguments.camera
    cameras = None if shot is None else cameras_of(shot, arguments.views, RENDER_VIEWS, recipe.flip)
    size = None if studio.resolution is None else size_of(studio.resolution)
    remedy = None if arguments.overwrite else "give another folder, or write into this one with --overwrite"
    require_writable(arguments.out, remedy=remedy)
    stored = open_frames(arguments.input, recipe.frame_range, conventions_of(recipe))
    require_names(arguments.out, [file.stem for file in stored.files])
    readable = Readable(stored, recipe.skip_bad)
    unit = unit_of(readable, arguments.density_scale or ("auto" if path_traced else "1"))
    frames = ScaledFrames(readable.frames(), unit.factor)
    activate(recipe.variant)
    shape = frames[0].density.shape
    in_cells = [] if cameras is None else [camera_of(cameras, frame, frame.density.shape) for frame in frames]
    if in_cells:
        rows, columns = shot_size(in_cells, shape, None if size is None else (size[1], size[0]))
        size = columns, rows
        if not path_traced:
            say(readable.lines())
            unit.note()
            say(_left_out(frames))
            _write_shot(arguments, frames, in_cells, recipe, (rows, columns))
            return 0
    if turntable is None:
        of_views = pictures.shots_of_views(len(frames), views)
    else:
        of_views = pictures.shots_of_turn(len(frames), views[0], turntable)
    shots = pictures.shots_of_cameras(in_cells) or of_views
    fire = colour = None
    if path_traced:
        fire, colour = find_fire(frames, studio.fire), find_colour(frames, studio.colour)
        painter = pictures.PathTracedPainter(
            frames,
            [shot.viewpoint for shot in shots],
            look=look or "medium",
            integrator=integrator,
            size=size or DEFAULT_SIZE,
            samples=samples,
            seed=seed,
            denoise=studio.denoise,
            fire=fire,
            colour=colour,
        )
        _require_places(arguments, frames, in_cells, painter)
        if studio.denoise and not painter.denoised:
            print("warning: --denoise: OptiX is not at hand, the pictures keep their noise", file=sys.stderr)
    else:
        if turntable and size is None:
            size = _turntable_size(shape, of_views, arguments.fit)
        painter = pictures.EmissionAbsorptionPainter(
            frames,
            [shot.viewpoint for shot in of_views],
            gamma(look, shape) if look else recipe.extinction,
            recipe.quadrature,
            arguments.fit,
            size,
        )
    film = arguments.out / f"{stored.title}_turntable.mp4"
    with open_video(film, recipe.fps or FRAMES_PER_SECOND) if turntable else nullcontext() as video:
        say(readable.lines())
        unit.note()
        say([] if fire is None else [fire.in_words])
        say([] if path_traced else _left_out(frames))
        say(colour_said(colour))
        seconds = len(shots) * painter.seconds(frames[shots[0].frame], shots[0].viewpoint)
        what = "1 picture" if len(shots) == 1 else f"{len(shots)} pictures"
        say([f"{what} in about {duration(seconds)}, written to {arguments.out}"])
        _write(arguments, frames, shots, painter, video)
    if turntable:
        print(f"video     {film}")
    return 0


def _left_out(frames: Sequence[Frame]) -> list[str]:
    """That grey pictures do not show the colours which the first frame has."""
    name = colour_name(frames[0].grids)
    return [] if name is None else [f"colour: grid {quoted(name)} is not seen in grey pictures; --look shows it"]


def _require_places(
    arguments: RenderArguments, frames: Sequence[Frame], in_cells: Sequence[Camera], painter: PathTracedPainter
) -> None:
    """Raise InputError, with the name of the frame, for the camera of a frame that cannot stand in the studio."""
    for number, camera in enumerate(in_cells):
        try:
            painter.studio.require_place(camera)
        except InputError as error:
            raise InputError(f"{arguments.camera}: {frames[number].name}: {error}") from None


def _write(
    arguments: RenderArguments,
    frames: Sequence[Frame],
    shots: Sequence[Shot[Viewpoint]],
    painter: Painter,
    video: Video | None,
) -> None:
    """Render and write every picture, and add it to the video of a turntable."""
    out = arguments.out
    with progress_bar(total=len(shots), unit="picture", desc="rendering") as bar:
        for number, (shot, frame) in enumerate(_with_frames(shots, frames)):
            image = painter.paint(frame, shot.viewpoint, number)
            picture = painter.shown(image)
            name = f"{frame.name}_{shot.suffix}"
            write_png(out / f"{name}.png", picture)
            seen = shot.viewpoint
            origin: Attributes = {"camera": str(arguments.camera)} if isinstance(seen, Camera) else {"view": seen}
            write_exr(out / f"{name}.exr", image, origin | painter.attributes())
            if video is not None:
                video.add(picture)
            # tqdm.write keeps the lines apart from the progress bar.
            tqdm.write(f"picture   {out / name}.png and {name}.exr", file=sys.stdout)
            bar.update()


def _write_shot(
    arguments: RenderArguments,
    frames: Sequence[Frame],
    in_cells: Sequence[Camera],
    recipe: Recipe,
    size: tuple[int, int],
) -> None:
    """Render and write every frame as its own camera frames it, in grey."""
    thick = recipe.extinction if arguments.look is None else gamma(arguments.look, frames[0].density.shape)
    painter = ShotPainter(frames, in_cells, thick, recipe.quadrature, size)
    attributes = {"gamma": thick, "quadrature": recipe.quadrature, "exposure": painter.exposure}
    for frame, camera in zip(progress_bar(frames, "rendering", unit="picture"), in_cells, strict=True):
        image, file = painter.paint(frame.density, camera), arguments.out / f"{frame.name}_camera"
        write_png(file.with_name(f"{file.name}.png"), image)
        write_exr(file.with_name(f"{file.name}.exr"), image, {"camera": str(arguments.camera), **attributes})
        tqdm.write(f"picture   {file}.png and {file.name}.exr", file=sys.stdout)
        if frame.density.any() and not image.any():
            say([f"warning: {frame.name}: the camera sees no smoke; where files lie is in docs/cameras.md"])


def _with_frames(shots: Sequence[Shot[Viewpoint]], frames: Sequence[Frame]) -> Iterator[tuple[Shot[Viewpoint], Frame]]:
    """Every shot with the frame it shows, which is read once for consecutive shots of it."""
    for index, group in itertools.groupby(shots, key=lambda shot: shot.frame):
        frame = frames[index]
        yield from ((shot, frame) for shot in group)


def _check_flags(arguments: RenderArguments, path_traced: bool) -> None:
    """Raise InputError for choices that are none, and for flags that would have no effect."""
    studio, renderer = arguments.studio, arguments.renderer
    for flag, text, kind in (("integrator", arguments.integrator, INTEGRATOR), ("look", arguments.look, LOOK)):
        if text is not None:
            checked(flag, text, kind)
    if arguments.turntable is not None and len(arguments.views) > 1:
        raise InputError("--turntable: starts from one view, and --views gives several; give one")
    if arguments.camera is not None:
        others = {"fit": arguments.fit, "turntable": arguments.turntable is not None}
        if beside := [flag for flag, there in others.items() if there]:
            raise InputError(f"--camera and --{beside[0]}: a shot has its own framing; give one of them")
    if studio.fire is not None and not path_traced:
        raise InputError("--fire: is of the path tracers, where fire lights the smoke; add --look")
    if studio.colour is not None and not path_traced:
        raise InputError("--colour: is of the path tracers, where smoke is lit; add --look")
    if path_traced and arguments.fit:
        raise InputError("--fit: is of emission_absorption; a path tracer's camera always shows all of the grid")
    if path_traced:
        others = {"gamma": renderer.gamma, "quadrature": renderer.quadrature}
        remedy = "is of emission_absorption; for a path tracer use --look"
    else:
        others = {"spp": studio.spp, "seed": studio.seed}
        others["denoise"] = "on" if studio.denoise else None
        remedy = "is of the path tracers, and emission_absorption has no noise; add --look"
        if arguments.look is not None and renderer.gamma is not None:
            raise InputError(f"--look {arguments.look} and --gamma {renderer.gamma}: both say how dense; give one")
    for flag, value in others.items():
        if value is not None:
            raise InputError(f"--{flag}: {remedy}")


def _turntable_size(shape: Shape, shots: Sequence[Shot[View]], fit: bool) -> tuple[int, int]:
    """(width, height) of the pictures of a turntable of a grid (D, H, W), which may be small."""
    rows, columns = common_size(shape, [shot.viewpoint for shot in shots]) if fit else shape[1:]
    return pictures.enlarged(columns, rows)


def size_of(text: str) -> tuple[int, int]:
    """(width, height) from the text of --resolution.

    Raises:
        InputError: it is not such a pair, or out of range.
    """
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if not all(2 <= side <= _LARGEST_SIDE for side in size):
        raise InputError(
            f"--resolution {text}: expected WIDTHxHEIGHT in pixels, 2 to {_LARGEST_SIDE} each, such as 576x768"
        )
    return size
