"""What `tnst-mi reconstruct` accepts: the settings of a reconstruction as flags, and where results go."""

from __future__ import annotations

from dataclasses import dataclass, field, make_dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from tnst_mi.commands.base import Arguments, Folder, recipe_flags
from tnst_mi.recipe.paragraphs import paragraphs_below_fields
from tnst_mi.reconstruction.settings import SETTING_KINDS, ReconstructionSettings


def _setting_flags() -> type:
    """A dataclass of the flags for all settings: their texts, None for those that are not given."""
    texts, usual = paragraphs_below_fields(ReconstructionSettings), ReconstructionSettings()
    fields = []
    for name, kind in SETTING_KINDS.items():
        hint = f"(default: {kind.show(getattr(usual, name))})"
        options = tyro.conf.arg(metavar=kind.placeholder, help=texts[name], help_behavior_hint=hint)
        fields.append((name, Annotated[str | None, options], field(default=None)))
    return make_dataclass("SettingFlags", fields)


# Dataclasses created at run time: a type checker cannot know them, so their fields are `Any`.
_SettingFlags, _VariantFlag = _setting_flags(), recipe_flags(("variant",))


@dataclass(kw_only=True)
class ReconstructArguments(Arguments):
    """Find the density of smoke from pictures that cameras with known places took.

    CAMERAS is a TOML file of ours, the transforms.json of a NeRF, or a Mitsuba scene with sensors
    (docs/reconstruction.md). Views that are held out judge the result: report.html shows how well.
    Settings come from the defaults, then from the table [reconstruction] of CAMERAS, then from the flags.
    """

    cameras: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="CAMERAS")]
    """File of cameras and their pictures."""
    out: Folder
    """New or empty folder for the results."""
    frames: Annotated[str | None, tyro.conf.arg(metavar="FIRST:LAST", help_behavior_hint="(default: one frame)")] = None
    """Numbers of the frames of a sequence, in whose place the names of pictures have ####; each starts from the one
    before."""
    velocities: Annotated[str, tyro.conf.arg(metavar="estimate|none|FOLDER")] = "estimate"
    """By what the frame before is moved to start from, written beside its density: estimated from the pictures of both,
    the velocity of frames of a simulation in FOLDER on the same grid, or nothing."""
    format: Annotated[str, tyro.conf.arg(metavar="npz|vol|uni|vdb")] = "npz"
    """Format of the densities; vdb keeps their place in the scene."""
    resume: bool = False
    """Continue the reconstruction in --out where it stopped, to the same bits (with prbvolpath nearly)."""
    overwrite: bool = False
    """Write into a folder that is not empty, replacing files of the same names; the frames of an earlier reconstruction
    there are removed."""
    settings: Annotated[Any, tyro.conf.arg(constructor=_SettingFlags)] = field(default_factory=_SettingFlags)
    """What pictures show, how fine the grid is, and how it is found."""
    device: Annotated[Any, tyro.conf.arg(constructor=_VariantFlag)] = field(default_factory=_VariantFlag)
    """On which device to compute."""
