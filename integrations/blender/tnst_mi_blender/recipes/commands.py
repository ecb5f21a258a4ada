"""Recipes and command lines for tnst-mi, from plain values."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .toml import assignment


@dataclass(frozen=True)
class Goal:
    """What smoke is stylized towards.

    Attributes:
        key: "style", "tag", "semantic", "content" or "match".
        value: a picture's file or shipped name ("spirals"), a tag, "LAYER:CHANNEL", …
        keys: keys of this goal alone, such as {"style_layers": {…}}; in regions only.
    """

    key: str
    value: str
    keys: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Sphere:
    """A mask that is 1 in a sphere.

    Attributes:
        centre: (x, y, z) in the scene of the cache, z up (see `Shot.origin`); or a table {frame: value}.
        radius: in its unit of length; or a table.
        edge: depth below the surface at which the mask has risen from 0 to 1.
    """

    centre: Any
    radius: Any
    edge: float = 0.0


@dataclass(frozen=True)
class Box:
    """A mask that is 1 in a box along the axes.

    Attributes:
        low: its lowest corner (x, y, z), as the centre of a `Sphere`; or a table {frame: value}.
        high: its highest corner.
        edge: as of a `Sphere`.
    """

    low: Any
    high: Any
    edge: float = 0.0


@dataclass(frozen=True)
class MaskFile:
    """A mask on the density's grid: a file for all frames, or a pattern such as "mask_####.npz" for each its own."""

    file: Path


@dataclass(frozen=True)
class MaskGrid:
    """A mask that is a grid of the input, such as "flame"; with a range, its values from low to high as 0 to 1."""

    grid: str
    range: tuple[float, float] | None = None


Mask = Sphere | Box | MaskFile | MaskGrid


@dataclass(frozen=True)
class Region:
    """A goal in a part of the smoke.

    Attributes:
        goal: of this part.
        masks: whose product says where; empty for everywhere.
        weight: factor of its steps, 0 or more.
        strength: factor of the mask, 0 to 1; or a table {frame: value}.
        invert: each mask counts as 1 minus itself.
        follow: the mask of the first frame moves with the smoke.
    """

    goal: Goal
    masks: tuple[Mask, ...] = ()
    weight: float = 1.0
    strength: Any = 1.0
    invert: bool = False
    follow: bool = False


@dataclass(frozen=True)
class Shot:
    """One stylization.

    Attributes:
        goals: what the smoke is stylized towards; empty if there are regions.
        regions: goals in parts of the smoke, instead of `goals`.
        quality: "draft", "preview" or "final".
        frames: first and last, both included; None for all that the input has.
        camera: file of the shot's cameras; None for views around the front.
        origin: place in the scene of the origin of a domain's cache (docs/cameras.md); None for that of the files.
        voxel_size: edge of a cell; None for that of the files.
        weights: a network, file or folder, or "patterns"; None for the one that is found.
        keys: all other keys of the recipe that differ from their defaults, such as {"octaves": 2}.
    """

    goals: tuple[Goal, ...] = ()
    regions: tuple[Region, ...] = ()
    quality: str = "final"
    frames: tuple[int, int] | None = None
    camera: Path | None = None
    origin: tuple[float, float, float] | None = None
    voxel_size: float | None = None
    weights: str | None = None
    keys: Mapping[str, Any] = field(default_factory=dict)


def recipe_text(shot: Shot) -> str:
    """The recipe of a shot, as a TOML file; results are .vdb unless its keys say otherwise.

    Paths in it are absolute, so that it means the same wherever it is.

    Raises:
        ValueError: it has both goals and regions, or none; or a value that no recipe can have.
    """
    if bool(shot.goals) == bool(shot.regions):
        raise ValueError("choose a motif or a picture" if not shot.goals else "choose goals or regions, not both")
    recipe: dict[str, Any] = {"format": "vdb"}
    for goal in shot.goals:
        recipe.setdefault(goal.key, []).append(_value_of(goal))
    recipe["quality"] = shot.quality
    if shot.frames is not None:
        first, last = shot.frames
        recipe["frames"] = f"{first}:{last}"
    if shot.camera is not None:
        recipe["camera"] = _absolute(shot.camera)
    for key in ("origin", "voxel_size", "weights"):
        if (value := getattr(shot, key)) is not None:
            recipe[key] = value
    recipe |= shot.keys
    lines = [assignment(key, value) for key, value in recipe.items() if value is not None]
    for region in shot.regions:
        lines += ["", "[[target]]", *(assignment(key, value) for key, value in _target(region).items())]
    return "\n".join(lines) + "\n"


def write_recipe(shot: Shot, file: Path) -> None:
    """Write the recipe of a shot, whole or not at all; missing folders are created.

    Raises:
        OSError: it cannot be written.
        ValueError: see `recipe_text`.
    """
    text = recipe_text(shot)
    file.parent.mkdir(parents=True, exist_ok=True)
    beside = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        beside.write_text(text, "utf-8", newline="\n")
        os.replace(beside, file)
    finally:
        beside.unlink(missing_ok=True)


def stylize_command(program: Path, source: Path, recipe: Path, out: Path, overwrite: bool = False) -> list[str]:
    """Stylize by a recipe; results are in OUT/density.

    Args:
        program: `tnst-mi`.
        source: a file, the folder of numbered ones, or a pattern such as "smoke_####.vdb".
        recipe: what `write_recipe` has written, frames and camera included.
        out: a new or empty folder.
        overwrite: replace the run that is there.
    """
    flags = ["--overwrite"] if overwrite else []
    return [str(program), "stylize", _absolute(source), "--recipe", _absolute(recipe), "--out", _absolute(out), *flags]


def resume_command(program: Path, out: Path) -> list[str]:
    """Go on with the run in a folder, by its own recipe and on its own input, where it was stopped."""
    return [str(program), "stylize", "--resume", "--out", _absolute(out)]


def batch_command(
    program: Path, source: Path, recipes: Sequence[Path], out: Path, overwrite: bool = False
) -> list[str]:
    """Stylize one input by several recipes, one after the other; the same command goes on where it was stopped.

    Args:
        program: `tnst-mi`.
        source: as of `stylize_command`.
        recipes: files of different names, which are those of the folders: see `batch_folder`.
        out: a new or empty folder, or that of the batch to go on with.
        overwrite: replace the runs that are there.
    """
    flags = ["--overwrite"] if overwrite else []
    return [str(program), "batch", *map(_absolute, recipes), _absolute(source), "--out", _absolute(out), *flags]


def batch_folder(out: Path, recipe: Path, source: Path) -> Path:
    """Where a batch writes the run of a recipe on an input."""
    return out / _name(recipe.stem) / _name(source.name if source.is_dir() else source.stem)


def _name(stem: str) -> str:
    """A file's or a pattern's name as that of a folder, as tnst-mi makes it."""
    return re.sub(r"[^\w.-]+", "_", stem).strip("._") or "input"


def _absolute(path: Path) -> str:
    return os.path.abspath(path)


def _value_of(goal: Goal) -> str:
    """The value of a goal, with a picture's path from the root: relative ones would start at the recipe."""
    is_file = goal.key in ("style", "content") and (
        "/" in goal.value or "\\" in goal.value or Path(goal.value).is_file()
    )
    return os.path.abspath(goal.value) if is_file else goal.value


def _target(region: Region) -> dict[str, Any]:
    target: dict[str, Any] = {region.goal.key: _value_of(region.goal), **region.goal.keys}
    if region.weight != 1.0:
        target["weight"] = region.weight
    masks = [_mask(mask, region, first=number == 0) for number, mask in enumerate(region.masks)]
    if not masks and region.strength != 1.0:
        masks = [{"strength": region.strength}]
    if masks:
        target["mask"] = masks if len(masks) > 1 else masks[0]
    return target


def _mask(mask: Mask, region: Region, first: bool) -> dict[str, Any]:
    """The table of a mask; of several, whose product counts, the first has the strength."""
    if isinstance(mask, Sphere):
        table = {"shape": "sphere", "centre": mask.centre, "radius": mask.radius, "edge": mask.edge}
    elif isinstance(mask, Box):
        table = {"shape": "box", "low": mask.low, "high": mask.high, "edge": mask.edge}
    elif isinstance(mask, MaskFile):
        table = {"file": _absolute(mask.file)}
    else:
        table = {"grid": mask.grid} | ({} if mask.range is None else {"range": mask.range})
    if first and region.strength != 1.0:
        table["strength"] = region.strength
    if region.invert:
        table["invert"] = True
    if region.follow:
        table["follow"] = True
    return table
