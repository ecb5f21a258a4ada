"""What each command of `tnst-mi` accepts: a dataclass whose fields are its arguments and flags, explained for --help.

tyro builds the parser and the help from them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from tnst_mi.choices import LOOKS
from tnst_mi.commands.base import Arguments, Folder, recipe_flags
from tnst_mi.commands.compare_arguments import CompareArguments
from tnst_mi.commands.reconstruct_arguments import ReconstructArguments
from tnst_mi.commands.run_arguments import (
    BatchArguments,
    ClusterAddress,
    DemoArguments,
    StylizeArguments,
    TrainArguments,
)
from tnst_mi.commands.studio_flags import StudioFlags
from tnst_mi.network.shipped import PAPERS_FLAVOUR
from tnst_mi.recipe.keys import Choice
from tnst_mi.recipe.sections import Reading

#: What renders the pictures of `render`, and how dense smoke appears in the studio.
INTEGRATOR, LOOK = Choice(("emission_absorption", "prbvolpath", "volpath")), Choice(LOOKS)

#: Views of `render`, unless others or a camera are given.
RENDER_VIEWS = ("0,0",)

ATLAS_FOLDER, STUDIO_FOLDER = "tnst_mi-atlas", "tnst_mi-studio"

# Dataclasses created at run time: a type checker cannot know them, so their fields are `Any`.
_ReadingFlags = recipe_flags(("frames", *Reading.__annotations__, "fps"))
_RendererFlags = recipe_flags(("gamma", "quadrature", "variant"), keyframes=False)

_NetworkFlags = recipe_flags(("weights", "variant"))
_VariantFlag = recipe_flags(("variant",))


@dataclass(kw_only=True)
class RenderArguments(Arguments):
    """Render a density file, or each file of a folder, as PNG and EXR, or as a turntable video.

    `--look` places the smoke in a studio with a key light, a ground and a sky, and renders scattered light with
    Mitsuba's path tracers; the EXR holds linear radiance, the PNG the same after the sRGB curve. Without it, or with
    `--integrator emission_absorption`, pictures are grey and share one exposure, 1 / the largest value in the first
    view of any frame, and the PNG is linear.
    """

    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="INPUT")]
    """Density file, folder of numbered ones, or pattern such as 'smoke_####.vdb'."""
    out: Folder
    """New or empty folder for the pictures."""
    views: Annotated[tuple[str, ...], tyro.conf.arg(metavar="AZIMUTH,ELEVATION…")] = RENDER_VIEWS
    """Views in degrees, one or more; 0,0 is the front, + is to the right and upwards."""
    camera: Annotated[str | None, tyro.conf.arg(metavar="FILE[#NAME]", help_behavior_hint="(default: --views)")] = None
    """Camera of the shot (docs/cameras.md): every frame is rendered in its framing, with the rows of the grid or in
    --resolution; with --look it is lit by the studio, whose lamps turn with the camera's azimuth."""
    turntable: Annotated[str | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: no video)")] = None
    """Make a video of one turn around the smoke in N pictures, from the given view, while a sequence plays once."""
    fit: bool = False
    """Make room for all of the grid in every view: without --look, pictures have the columns and rows of the grid, and
    views from the side may cut off some of the smoke."""
    integrator: Annotated[
        str | None,
        tyro.conf.arg(
            metavar=INTEGRATOR.placeholder, help_behavior_hint="(default: emission_absorption; volpath with --look)"
        ),
    ] = None
    """Emission and absorption alone, or one of Mitsuba's path tracers."""
    look: Annotated[
        str | None,
        tyro.conf.arg(metavar=LOOK.placeholder, help_behavior_hint="(default: medium for a path tracer)"),
    ] = None
    """How dense the smoke appears in the studio; for emission_absorption, the γ of the same optical thickness."""
    density_scale: Annotated[
        str | None,
        tyro.conf.arg(metavar="NUMBER|auto", help_behavior_hint="(default: auto for path tracers and looks, else 1)"),
    ] = None
    """Factor of all densities; auto is 1 over the 99th percentile of the smoky cells of all frames, as stylize takes
    it."""
    overwrite: bool = False
    """Write into a folder that is not empty, replacing pictures of the same names."""
    studio: StudioFlags = field(default_factory=StudioFlags)
    """For --look and the path tracers."""
    renderer: Annotated[Any, tyro.conf.arg(constructor=_RendererFlags)] = field(default_factory=_RendererFlags)
    """How emission_absorption renders the smoke, and on which device."""
    reading: Annotated[Any, tyro.conf.arg(constructor=_ReadingFlags)] = field(default_factory=_ReadingFlags)
    """How to read the input."""


@dataclass(kw_only=True)
class DiffArguments(Arguments):
    """Compare two runs, finished or not, or two densities: recipes, numbers, and pictures side by side.

    Numbers are of the frames that both have. Pictures show the main view of the first with one exposure for both: A, B
    and their difference side by side, and a wipe; of a sequence also a video.
    """

    files: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="A B", help_behavior_hint="")]
    """Two folders of runs; or density files, folders, or patterns such as 'smoke_####.vdb'."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="(default: none written)")] = None
    """New or empty folder for diff.json and the pictures."""
    overwrite: bool = False
    """Write into a folder that is not empty, replacing files of the same names."""


@dataclass(kw_only=True)
class ShowArguments(Arguments):
    """Show runs as they will be seen: lit, side by side, before and after, as a picture or a film.

    Each run is shown beside its input, from its main view, in the studio of a look. The time that this will take is
    measured and said first. Of densities that are no run's, only these are shown.
    """

    files: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RUN…", help_behavior_hint="")]
    """Folders of runs, finished or not; or density files, folders, or patterns such as 'smoke_####.vdb'."""
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: tnst_mi-show.png or .mp4)")
    ] = None
    """File of the picture (.png), or of the film (.mp4) if there are several."""
    frames: Annotated[
        str | None, tyro.conf.arg(metavar="FIRST:LAST", help_behavior_hint="(default: the last that all have)")
    ] = None
    """Frame, or frames as a film, by their numbers."""
    turntable: Annotated[str | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the main view)")] = None
    """Make a film of one turn in N pictures, while the frames play once."""
    look: Annotated[str, tyro.conf.arg(metavar=LOOK.placeholder)] = "medium"
    """How dense the smoke appears."""
    blender: bool = False
    """Let Blender render the same scene, on the CPU (apt-get install blender)."""
    overwrite: bool = False
    """Replace the file if it is there."""
    studio: StudioFlags = field(default_factory=StudioFlags)
    """How each picture is rendered."""


@dataclass(kw_only=True)
class ConvertArguments(Arguments):
    """Convert a density file, or a folder of numbered ones, to npz, .vol, .uni, .vdb, or a stage of USD.

    Mitsuba has .vol, Mantaflow .uni, OpenVDB .vdb. Velocities are written at the cell centres in cells per frame; npz
    and .vol have y up, .uni and .vdb z up, as in Blender. A stage of USD (.usda, .usdc, .usd) shows the frames as a
    volume: .vdb files stay where they are, others are written as such beside it (docs/usd.md). A model that
    `tnst-mi train` has written becomes an .onnx file (docs/realtime.md).
    """

    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="INPUT")]
    """Density file, folder of numbered ones, or pattern such as 'smoke_####.vdb'; or a model."""
    output: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUTPUT")]
    """File, whose extension selects the format, stage such as out.usda, or new or empty folder; or .onnx of a model."""
    format: Annotated[str | None, tyro.conf.arg(metavar="npz|vol|uni|vdb", help_behavior_hint="(default: npz)")] = None
    """Format of the files in a folder."""
    reading: Annotated[Any, tyro.conf.arg(constructor=_ReadingFlags)] = field(default_factory=_ReadingFlags)
    """How to read the input."""


@dataclass(kw_only=True)
class StudioArguments(Arguments):
    """Open a page in the browser: look at smoke and runs from all sides, choose motifs, try them, and render.

    The URL that is printed has a token in it, without which nothing is answered. Only what is in the folder of INPUT,
    or below it, can be opened. Ctrl-C ends the studio and pauses its tries; runs that it has begun to render go on
    (docs/studio.md).
    """

    input: Annotated[
        tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="[INPUT|RUN|FOLDER]", help_behavior_hint="")
    ] = None
    """Densities, the folder of a run, or a folder of these; the current folder by default."""
    out: Folder = Path(STUDIO_FOLDER)
    """Folder for the tries and the rendered runs; those of an earlier studio are shown again."""
    port: Annotated[str, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="(default: any that is free)")] = "0"
    """Port to listen on."""
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address to listen on: by default only programs of this machine reach it. Others expose the page, and what it can
    read and do, to whoever reaches them and has the URL."""
    cluster: ClusterAddress = None
    """Have several processes render, as with stylize --cluster; the page can name another (docs/cluster.md)."""
    resources: Annotated[Any, tyro.conf.arg(constructor=_NetworkFlags)] = field(default_factory=_NetworkFlags)
    """Which network to use, for all that is tried and rendered, and on which device to render."""


@dataclass(kw_only=True)
class AtlasArguments(Arguments):
    """Show every channel of a layer: the picture that excites it, and what it makes of a ball of smoke.

    Writes a contact sheet and an HTML page, for choosing a channel for stylize --semantic LAYER:CHANNEL. Finished
    channels are kept: the same command continues where it stopped, and adds channels to an existing atlas.
    """

    layer: Annotated[str, tyro.conf.arg(metavar="LAYER")] = "inception_4b/pool_proj"
    """Layer of GoogLeNet, such as inception_3b/3x3_reduce, or its name in TensorFlow."""
    channels: Annotated[
        str | None, tyro.conf.arg(metavar="FIRST:LAST", help_behavior_hint="(default: all, a few seconds each)")
    ] = None
    """Numbers of the first and the last channel, both included; or a list of numbers and ranges, such as 6,16,40:47."""
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint=f"(default: {ATLAS_FOLDER}/NETWORK-LAYER)")
    ] = None
    """New or empty folder, or the folder of an atlas of the same layer and network."""
    pictures_only: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = False
    """Only what excites the channels, a second each, in channels/; the same command without it adds smoke and page."""
    resources: Annotated[Any, tyro.conf.arg(constructor=_NetworkFlags)] = field(default_factory=_NetworkFlags)
    """Which network to use, and on which device."""


@dataclass(kw_only=True)
class InfoArguments(Arguments):
    """Describe files or folders of frames: arrays or grids, how they are read, shape, ranges, mass, largest velocity.

    A file without a density, such as the velocities of a run, is described by what it contains; a model of
    `tnst-mi train` (.safetensors) by what it was trained for, and how well.
    """

    files: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="FILE…", help_behavior_hint="")]
    """Files, folders, or patterns such as 'smoke_####.vdb'."""
    reading: Annotated[Any, tyro.conf.arg(constructor=_ReadingFlags)] = field(default_factory=_ReadingFlags)
    """How to read the input."""


@dataclass(kw_only=True)
class WeightsArguments(Arguments):
    """List the GoogLeNet weights found, and where to get others."""

    download: Annotated[
        tuple[str, ...] | None,
        tyro.conf.arg(
            metavar="[inception5h|bvlc|torchvision]",
            help_behavior_hint=f"(without a name: {PAPERS_FLAVOUR}, the paper's)",
        ),
    ] = None
    """Download a published network into the user cache, where runs find it; its hash is verified."""
    tags: bool = False
    """List the class tags of the network that ships with the package, synonyms separated by commas."""


@dataclass(kw_only=True)
class DoctorArguments(Arguments):
    """Check Python, Mitsuba, Dr.Jit, LLVM, GPU, OptiX, torch, weights and memory; say how to get what is missing."""


#: The arguments that are given without a flag, each with its name in the help.
POSITIONAL = {"cameras": "CAMERAS", "input": "INPUT", "output": "OUTPUT", "files": "FILE…", "inputs": "INPUT…"}

ARGUMENTS: dict[str, type[Arguments]] = {
    "demo": DemoArguments,
    "stylize": StylizeArguments,
    "train": TrainArguments,
    "batch": BatchArguments,
    "reconstruct": ReconstructArguments,
    "render": RenderArguments,
    "show": ShowArguments,
    "diff": DiffArguments,
    "compare": CompareArguments,
    "convert": ConvertArguments,
    "atlas": AtlasArguments,
    "studio": StudioArguments,
    "info": InfoArguments,
    "weights": WeightsArguments,
    "doctor": DoctorArguments,
}
