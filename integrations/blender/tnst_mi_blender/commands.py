"""Recipes and command lines for tnst-mi, from plain values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Goal:
    """What smoke is stylized towards.

    Attributes:
        key: "style", "tag", "semantic", "content" or "match".
        value: a picture's file or shipped name ("spirals"), a tag, "LAYER:CHANNEL", …
        keys: keys of this goal alone, such as {"style_layers": {…}}; with regions only.
    """

    key: str
    value: str
    keys: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Sphere:
    """A mask that is 1 in a sphere: numbers in the scene of the cache (see `Shot.origin`), z up, or tables {frame: value}."""

    centre: Any
    radius: Any
    edge: float = 0.0


@dataclass(frozen=True)
class Box:
    """A mask that is 1 in a box along the axes: numbers as in `Sphere`."""

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
        strength: factor of the mask, 0 to 1, or a table {frame: value}.
        invert: 1 minus the (only) mask.
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
        origin: scene place of the domain's first corner, for a domain's cache (docs/cameras.md); None for as in the files.
        voxel_size: edge of a cell; None for as in the files.
        weights: network, file or folder or "patterns"; None for the one that is found.
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

    Raises:
        ValueError: it has both goals and regions, or none.
    """
    raise NotImplementedError


def write_recipe(shot: Shot, file: Path) -> None:
    """Write the recipe of a shot, whole or not at all; missing folders are created.

    Raises:
        OSError: it cannot be written.
        ValueError: see `recipe_text`.
    """
    raise NotImplementedError


def stylize_command(program: Path, source: Path, recipe: Path, out: Path, overwrite: bool = False) -> list[str]:
    """Stylize a cache folder, a file or a pattern by a recipe; results are in OUT/density.

    Args:
        program: `tnst-mi`.
        source: a file, the folder of numbered ones, or a pattern such as "smoke_####.vdb".
        recipe: what `write_recipe` has written, frames and camera included.
        out: a new or empty folder.
        overwrite: replace the run that is there.
    """
    raise NotImplementedError


def resume_command(program: Path, out: Path) -> list[str]:
    """Go on with the run in a folder, by its own recipe, where it was stopped."""
    raise NotImplementedError


def batch_command(program: Path, source: Path, recipes: Sequence[Path], out: Path, overwrite: bool = False) -> list[str]:
    """Stylize one input by several recipes, one after the other; the same command goes on where it was stopped.

    The results of a recipe are in `batch_folder(out, recipe, source)`.
    """
    raise NotImplementedError


def batch_folder(out: Path, recipe: Path, source: Path) -> Path:
    """Where a batch writes the run of a recipe on an input."""
    raise NotImplementedError
