"""What each command of `tnst-mi` accepts: a dataclass whose fields are its arguments and flags, explained for --help.

tyro makes parser and help of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from tnst_mi.commands.base import Arguments, Folder, recipe_flags
from tnst_mi.network.shipped import PAPERS_FLAVOUR
from tnst_mi.recipe.sections import Goals, Method, Resources

#: Of `compare` without --quick.
FULL_SPP, FULL_DIRECTIONS = 256, 64

ATLAS_FOLDER = "tnst_mi-atlas"

# Dataclasses that are made while the program runs: a type checker cannot know them, so their fields are `Any`.
_GoalFlags = recipe_flags(Goals.__annotations__)
_MethodFlags = recipe_flags(Method.__annotations__)
_ResourceFlags = recipe_flags(Resources.__annotations__)
_RendererFlags = recipe_flags(("gamma", "quadrature", "variant"))
_NetworkFlags = recipe_flags(("weights", "variant"))


@dataclass(kw_only=True)
class DemoArguments(Arguments):
    """Stylize the bundled frame with the bundled recipe; needs nothing else."""

    out: Folder = Path("tnst_mi-demo")
    """Folder for the results; those of an earlier demo in it are replaced."""


@dataclass(kw_only=True)
class StylizeArguments(Arguments):
    """Stylize a density file, or a folder of numbered ones, towards pictures, features or classes.

    Values come from the defaults, then from the recipe file, then from the flags.
    """

    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="INPUT")]
    """Density file (one frame) or folder (a sequence)."""
    out: Folder
    """New or empty folder for the results."""
    recipe: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Recipe file (TOML); its keys are the flags below."""
    resume: bool = False
    """Continue the run in --out where it stopped, however it did."""
    overwrite: bool = False
    """Replace the run in --out."""
    goals: Annotated[Any, tyro.conf.arg(constructor=_GoalFlags)] = field(default_factory=_GoalFlags)
    """What to stylize towards."""
    method: Annotated[Any, tyro.conf.arg(constructor=_MethodFlags)] = field(default_factory=_MethodFlags)
    """How to get there."""
    resources: Annotated[Any, tyro.conf.arg(constructor=_ResourceFlags)] = field(default_factory=_ResourceFlags)
    """What to read, compute with and write."""


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
class RenderArguments(Arguments):
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
    renderer: Annotated[Any, tyro.conf.arg(constructor=_RendererFlags)] = field(default_factory=_RendererFlags)
    """How emission_absorption renders the smoke, and where is computed."""


@dataclass(kw_only=True)
class CompareArguments(Arguments):
    """Compare our images and gradients of a density file with those of Mitsuba's path tracer, prbvolpath.

    Writes report.html, report.json, figures and EXR images, and ends with a verdict: exit code 0 if all checks pass, 1
    if not. A folder of numbered files is represented by its first one.
    """

    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="INPUT")]
    """Density file or folder of numbered ones."""
    out: Folder
    """New or empty folder for the report."""
    views: Annotated[tuple[str, ...], tyro.conf.arg(metavar="AZIMUTH,ELEVATION…")] = ("0,0", "35,12", "-80,-25")
    """Views in degrees, one or more; 0,0 is the front, + is to the right and upwards."""
    gamma: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NUMBER…")] = ("0.05", "0.5", "2")
    """Extinctions γ for density 1, per cell, one or more."""
    spp: Annotated[str | None, tyro.conf.arg(metavar="INTEGER", help_behavior_hint=f"(default: {FULL_SPP})")] = None
    """Paths per pixel, 32 or more; a quarter of them for gradients."""
    directions: Annotated[
        str | None, tyro.conf.arg(metavar="INTEGER", help_behavior_hint=f"(default: {FULL_DIRECTIONS})")
    ] = None
    """Random smooth directions for derivatives, 3 or more."""
    quick: bool = False
    """Fewer paths and directions, and gradients at the middle γ alone."""
    seed: Annotated[str, tyro.conf.arg(metavar="INTEGER")] = "0"
    """Seed of paths and directions."""
    overwrite: bool = False
    """Write into a folder that is not empty, replacing files of the same names."""


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
class ConvertArguments(Arguments):
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


@dataclass(kw_only=True)
class AtlasArguments(Arguments):
    """Show every channel of a layer: the picture that excites it, and the smoke patch it makes of a ball of smoke.

    Writes a contact sheet and a page for the browser, to choose a channel for stylize --semantic LAYER:CHANNEL.
    Finished channels are kept: the same command goes on where it stopped, and adds channels to those there are.
    """

    layer: Annotated[str, tyro.conf.arg(metavar="LAYER")] = "inception_4b/pool_proj"
    """Layer of GoogLeNet, such as inception_3b/3x3_reduce, or its name in TensorFlow."""
    channels: Annotated[
        str | None, tyro.conf.arg(metavar="FIRST:LAST", help_behavior_hint="(default: all, some seconds each)")
    ] = None
    """Numbers of the first and the last channel, both included; or a list of numbers and ranges, such as 6,16,40:47."""
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint=f"(default: {ATLAS_FOLDER}/NETWORK-LAYER)")
    ] = None
    """New or empty folder, or that of an atlas of the same layer and network."""
    resources: Annotated[Any, tyro.conf.arg(constructor=_NetworkFlags)] = field(default_factory=_NetworkFlags)
    """Which network, and where is computed."""


@dataclass(kw_only=True)
class InfoArguments(Arguments):
    """Describe files or folders of frames: arrays or grids, how they are read, shape, ranges, mass, largest velocity.

    Of a file without a density, such as the velocities of a run, what is there is described.
    """

    files: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="FILE…")]
    """Files or folders."""


@dataclass(kw_only=True)
class WeightsArguments(Arguments):
    """List the GoogLeNet weights that are found, and say where others come from."""

    download: Annotated[
        tuple[str, ...] | None,
        tyro.conf.arg(
            metavar="[inception5h|bvlc|torchvision]",
            help_behavior_hint=f"(without a name: {PAPERS_FLAVOUR}, the paper's)",
        ),
    ] = None
    """Fetch a published network into the user cache, checked against its hash, for runs to find."""
    tags: bool = False
    """List the class tags of the network that ships with the package, synonyms behind commas."""


@dataclass(kw_only=True)
class DoctorArguments(Arguments):
    """Check Python, Mitsuba, Dr.Jit, LLVM, GPU, OptiX, torch, weights and memory; say how to get what is missing."""


ARGUMENTS: dict[str, type[Arguments]] = {
    "demo": DemoArguments,
    "stylize": StylizeArguments,
    "render": RenderArguments,
    "compare": CompareArguments,
    "convert": ConvertArguments,
    "atlas": AtlasArguments,
    "info": InfoArguments,
    "weights": WeightsArguments,
    "doctor": DoctorArguments,
}
