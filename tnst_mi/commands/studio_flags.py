"""The flags of the studio, which `render` and `show` share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro


@dataclass(kw_only=True)
class StudioFlags:
    """Options of the path tracers."""

    spp: Annotated[str | None, tyro.conf.arg(metavar="INTEGER", help_behavior_hint="(default: 64)")] = None
    """Paths per pixel; four times as many halve the noise and take four times as long."""
    seed: Annotated[str | None, tyro.conf.arg(metavar="INTEGER", help_behavior_hint="(default: 0)")] = None
    """Seed of the noise; the same seed gives the same pictures."""
    resolution: Annotated[
        str | None,
        tyro.conf.arg(metavar="WIDTHxHEIGHT", help_behavior_hint="(default: 288x384; grey: see below)"),
    ] = None
    """Size of the pictures in pixels. Grey ones have a pixel per cell or more: by default one, and in turntables of
    small grids as many as make 384 rows. Those of a shot's camera have its proportions, and by default the rows of the
    grid."""
    fire: Annotated[
        str | None,
        tyro.conf.arg(metavar="GRID|none", help_behavior_hint="(default: the flame, or a temperature in kelvin)"),
    ] = None
    """Grid that shines as fire, and lights smoke and ground: a flame, a temperature as a black body, or colours such as
    Cd; see docs/looks.md."""
    colour: Annotated[
        str | None, tyro.conf.arg(metavar="GRID|none", help_behavior_hint="(default: Cd, color or the like)")
    ] = None
    """Grid of the smoke's colours, which multiply its albedo; see docs/colour.md."""
    denoise: bool = False
    """Remove the noise with OptiX, on an NVIDIA GPU that has it; elsewhere pictures keep their noise."""
