"""`tnst-mi render`: pictures and turntable videos of density files, plain or lit in a studio."""

from __future__ import annotations

import contextlib
import re
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from tnst_mi.commands.base import Command, Folder, given, recipe_flags, view_of
from tnst_mi.errors import InputError
from tnst_mi.recipe.recipe import Recipe

if TYPE_CHECKING:
    from tnst_mi.io.sequence import FrameFiles
    from tnst_mi.rendering.pictures import Painter, Shot

RendererFlags = recipe_flags(("gamma", "quadrature", "variant"))

#: Largest picture: what the standard of the videos allows at most.
_LARGEST_SIDE = 8192


@dataclass(kw_only=True)
class StudioFlags:
    """What is asked of the path tracers."""

    spp: Annotated[int | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="(default: 64)")] = None
    """Paths per pixel; four times as many halve the noise and take four times as long."""
    seed: Annotated[int | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="(default: 0)")] = None
    """Seed of the noise; the same seed gives the same pictures."""
    resolution: Annotated[
        str | None, tyro.conf.arg(metavar="WIDTHxHEIGHT", help_behavior_hint="(default: 288x384)")
    ] = None
    """Size of the pictures in pixels."""
    denoise: bool = False
    """Remove the noise with OptiX, where an NVIDIA GPU with it is used; elsewhere pictures keep their noise."""


@dataclass(kw_only=True)
class Render(Command):
    """Render a density file, or each file of a folder, as PNG and EXR, or as a turntable video.

    `--look` puts the smoke into a studio with a key light, a ground and a sky, where the path tracers of Mitsuba
    scatter light in it; the EXR has the linear radiance, the PNG the same through the sRGB curve. Without it, or with
    `--integrator emission_absorption`, pictures are grey, with one exposure for all, 1 / the largest value in the first
    view of any frame, and the PNG is linear.
    """

    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="INPUT")]
    """Density file or folder of numbered ones."""
    out: Folder
    """New or empty folder for the pictures."""
    views: Annotated[tuple[str, ...], tyro.conf.arg(metavar="AZIMUTH,ELEVATION…")] = ("0,0",)
    """Views in degrees, one or more; 0,0 is the front, + is to the right and upwards."""
    turntable: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: no video)")] = None
    """Make a video of one turn around the smoke in N pictures, from the view given; a sequence plays once meanwhile."""
    fps: float = 24.0
    """Pictures per second of the video."""
    integrator: Annotated[
        Literal["emission_absorption", "prbvolpath", "volpath"] | None,
        tyro.conf.arg(help_behavior_hint="(default: emission_absorption; volpath with --look)"),
    ] = None
    """Emission and absorption alone, or a path tracer of Mitsuba."""
    look: Annotated[
        Literal["thin", "medium", "thick"] | None,
        tyro.conf.arg(help_behavior_hint="(default: medium for a path tracer)"),
    ] = None
    """How dense the smoke appears in the studio; for emission_absorption the γ of the same optical thickness."""
    overwrite: bool = False
    """Write into a folder that is not empty, replacing pictures of the same names."""
    studio: StudioFlags = field(default_factory=StudioFlags)
    """For --look and the path tracers."""
    renderer: RendererFlags = field(default_factory=RendererFlags)
    """How emission_absorption renders the smoke, and where is computed."""

    def run(self) -> int:
        """Render every view of every frame, or a turntable."""
        from tnst_mi.io import open_frames
        from tnst_mi.machine.backend import activate
        from tnst_mi.machine.disk import require_writable

        path_traced = (self.integrator or ("volpath" if self.look else "emission_absorption")) != "emission_absorption"
        self._check_flags(path_traced)
        recipe = Recipe().updated_by_flags(given(self.renderer))
        views = [view_of(text) for text in self.views]
        size = _size(self.studio.resolution or "288x384")
        remedy = None if self.overwrite else "give another folder, or write into this one with --overwrite"
        require_writable(self.out, remedy=remedy)
        frames = open_frames(self.input)
        activate(recipe.variant)
        from tnst_mi.rendering import pictures
        from tnst_mi.rendering.looks import gamma

        if self.turntable is None:
            shots = pictures.shots_of_views(len(frames), views)
        else:
            shots = pictures.shots_of_turn(len(frames), views[0], self.turntable)
        if path_traced:
            painter = pictures.PathTraced(
                frames,
                [shot.view for shot in shots],
                look=self.look or "medium",
                integrator=self.integrator or "volpath",
                size=size,
                samples=_or(self.studio.spp, 64),
                seed=_or(self.studio.seed, 0),
                denoise=self.studio.denoise,
            )
            if self.studio.denoise and not painter.denoised:
                print("warning: --denoise: OptiX is not at hand, the pictures keep their noise", file=sys.stderr)
        else:
            shape = frames[0].density.shape
            painter = pictures.EmissionAbsorption(
                frames, views[0], gamma(self.look, shape) if self.look else recipe.gamma, recipe.quadrature
            )
        self._write(frames, shots, painter)
        return 0

    def _write(self, frames: FrameFiles, shots: list[Shot], painter: Painter) -> None:
        """Make and write every picture, and the video of a turntable."""
        from tqdm import tqdm

        from tnst_mi.io.exr import write_exr
        from tnst_mi.io.png import write_png
        from tnst_mi.io.video import open_video

        with contextlib.ExitStack() as stack:
            video = None
            if self.turntable is not None:
                source = self.input.resolve()
                path = self.out / f"{source.name if source.is_dir() else source.stem}_turntable.mp4"
                video = stack.enter_context(open_video(path, self.fps))
            bar = stack.enter_context(tqdm(total=len(shots), unit="picture", dynamic_ncols=True))
            shown_frame, frame = None, None
            for number, shot in enumerate(shots):
                if shot.frame != shown_frame:
                    shown_frame, frame = shot.frame, frames[shot.frame]
                image = painter.paint(frame.density, shot.view, number)
                picture = painter.shown(image)
                name = f"{frame.name}_{shot.suffix}"
                write_png(self.out / f"{name}.png", picture)
                write_exr(self.out / f"{name}.exr", image, {"view": shot.view, **painter.attributes()})
                if video is not None:
                    video.add(picture)
                # tqdm.write keeps the lines apart from the progress bar.
                tqdm.write(f"picture   {self.out / name}.png and {name}.exr", file=sys.stdout)
                bar.update()
        if video is not None:
            print(f"video     {path}")

    def _check_flags(self, path_traced: bool) -> None:
        """Raise InputError for values out of range, and for flags that would not change anything."""
        studio, renderer = self.studio, self.renderer
        for flag, value, low, high in (
            ("turntable", self.turntable, 1, 100_000),
            ("spp", studio.spp, 1, 1_000_000),
            ("seed", studio.seed, 0, 2**32 - 1),
        ):
            if value is not None and not low <= value <= high:
                raise InputError(f"--{flag} {value}: expected a whole number from {low} to {high}")
        if not 0.1 <= self.fps <= 1000.0:
            raise InputError(f"--fps {self.fps:g}: expected pictures per second from 0.1 to 1000")
        if self.turntable is not None and len(self.views) > 1:
            raise InputError("--turntable: starts from one view, and --views gives several; give one")
        if path_traced:
            others = {"gamma": renderer.gamma, "quadrature": renderer.quadrature}
            remedy = "is of emission_absorption; for a path tracer use --look"
        else:
            others = {"spp": studio.spp, "seed": studio.seed, "resolution": studio.resolution}
            others["denoise"] = studio.denoise or None
            remedy = "is of the path tracers, and emission_absorption has no noise and one pixel per cell; add --look"
            if self.look is not None and renderer.gamma is not None:
                raise InputError(f"--look {self.look} and --gamma {renderer.gamma}: both say how dense; give one")
        for flag, value in others.items():
            if value is not None:
                raise InputError(f"--{flag}: {remedy}")


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if not all(2 <= side <= _LARGEST_SIDE for side in size):
        raise InputError(
            f"--resolution {text}: expected WIDTHxHEIGHT in pixels, 2 to {_LARGEST_SIDE} each, such as 576x768"
        )
    return size


def _or(value: int | None, default: int) -> int:
    return default if value is None else value
