"""The flags of `compare`: of ours against its references, and of any two renderers."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from tnst_mi.commands.base import Arguments, Folder, recipe_flags
from tnst_mi.compare.bench.renderers.sides import PLACEHOLDER
from tnst_mi.recipe.sections import Reading

#: Views, unless others or a camera are given.
COMPARE_VIEWS = ("0,0", "35,12", "-80,-25")

#: Defaults without --quick.
FULL_SPP, FULL_DIRECTIONS = 256, 64

# Created at run time: a type checker cannot know it, so its field is `Any`.
_ReadingFlags = recipe_flags(("frames", *Reading.__annotations__, "fps"))


@dataclass(kw_only=True)
class SideFlags:
    """Compare any two renderers: any of these flags does so, in place of the comparison of ours with its references."""

    left: Annotated[
        str | None, tyro.conf.arg(metavar=PLACEHOLDER, help_behavior_hint="(default: emission_absorption:exact)")
    ] = None
    """emission_absorption[:exact|paper|transmittance], volpath, volpathmis, prbvolpath; float64[:exact|paper], the
    references; a Mitsuba scene file with its own integrator; a folder of OpenEXR pictures, each an independent render;
    answer, the known one of a scene. What Mitsuba renders may have a variant of its own: volpath@spectral,
    volpath@scalar_rgb."""
    right: Annotated[str | None, tyro.conf.arg(metavar=PLACEHOLDER, help_behavior_hint="(default: prbvolpath)")] = None
    """The same."""
    gradients: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="PARAMETER…", help_behavior_hint="(default: none)")
    ] = ()
    """Compare derivatives with respect to extinction, albedo, anisotropy, sensor: by differentiation where a renderer
    has it, and by central differences with the same random numbers."""
    albedo: Annotated[str | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="(default: 0)")] = None
    """Scattered share of the light, 0 to 1; above 0 for path tracers alone."""
    anisotropy: Annotated[str | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="(default: 0)")] = None
    """Mean cosine of the phase function, for an albedo above 0."""
    light: Annotated[
        str | None, tyro.conf.arg(metavar="FILE|key|environment", help_behavior_hint="(default: environment)")
    ] = None
    """Light on the smoke, for an albedo above 0: the emitters of a Mitsuba scene file, or a light that ships."""
    tolerance: Annotated[str | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="(default: 0.001)")] = None
    """Difference that does not count, relative to the RMS of a view, and for derivatives to the larger of these and of
    the mean."""
    baseline: Annotated[
        Path | None, tyro.conf.arg(metavar="REPORT.json", help_behavior_hint="(default: left and right)")
    ] = None
    """Report of an earlier comparison of the same two: the exit code says whether either has changed since, they have
    ceased to agree, or something can no longer be tested."""


@dataclass(kw_only=True)
class CompareArguments(Arguments):
    """Compare our images and gradients of smoke with those of Mitsuba's path tracer, or any two renderers.

    Without --left and --right: the quadrature exact against prbvolpath. The quadrature paper, which drives a
    stylization by default, is another one: it is compared with its own sum in float64, and its distance from the
    continuous integral is stated for each γ. With --left or --right, or another flag of their group: any two renderers,
    on a density or on a Mitsuba scene. Writes report.html, report.json, figures and EXR images, and ends with a
    verdict: exit code 0 if all checks pass, 1 if not, or if of two renderers nothing could be tested. Of a folder of
    numbered files, the first is compared.
    """

    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="INPUT")]
    """Density file, folder of numbered ones, or pattern such as 'smoke_####.vdb'; with --left or --right also a Mitsuba
    scene (.xml)."""
    out: Folder
    """New or empty folder for the report."""
    views: Annotated[tuple[str, ...], tyro.conf.arg(metavar="AZIMUTH,ELEVATION…")] = COMPARE_VIEWS
    """Views in degrees, one or more; 0,0 is the front, + is to the right and upwards."""
    camera: Annotated[str | None, tyro.conf.arg(metavar="FILE[#NAME]", help_behavior_hint="(default: --views)")] = None
    """Camera of the shot (docs/cameras.md): the view is the one from where it stands, as a stylization has it."""
    gamma: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NUMBER…")] = ("0.05", "0.5", "2")
    """Extinction γ per cell at density 1, one or more."""
    spp: Annotated[str | None, tyro.conf.arg(metavar="INTEGER", help_behavior_hint=f"(default: {FULL_SPP})")] = None
    """Paths per pixel, 32 or more; a quarter of them for gradients. With --left or --right in multiples of 32, and by
    default more where an image has fewer than 4096 pixels."""
    directions: Annotated[
        str | None, tyro.conf.arg(metavar="INTEGER", help_behavior_hint=f"(default: {FULL_DIRECTIONS})")
    ] = None
    """Number of random smooth directions for derivatives, 3 or more; not with --left and --right."""
    quick: bool = False
    """Fewer paths and directions, and gradients only at the middle γ; with --left or --right, fewer paths."""
    seed: Annotated[str, tyro.conf.arg(metavar="INTEGER")] = "0"
    """Seed of the paths and directions."""
    density_scale: Annotated[str, tyro.conf.arg(metavar="NUMBER|auto")] = "1"
    """Factor of the density; auto is 1 over the 99th percentile of the smoky cells, as stylize takes it."""
    overwrite: bool = False
    """Write into a folder that is not empty, replacing files of the same names."""
    sides: SideFlags = field(default_factory=SideFlags)
    """For any two renderers."""
    reading: Annotated[Any, tyro.conf.arg(constructor=_ReadingFlags)] = field(default_factory=_ReadingFlags)
    """How to read the input."""
