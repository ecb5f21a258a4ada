"""What the arguments of the commands share: --debug, flags derived from the keys of the recipe, views."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, make_dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from tnst_mi.errors import InputError
from tnst_mi.fields.density_unit import is_unusual
from tnst_mi.frame import Frame
from tnst_mi.io.cameras.reading import Cameras, read_cameras
from tnst_mi.machine.terminal import printable
from tnst_mi.recipe.combinations import require_unmirrored
from tnst_mi.recipe.expectation import expectation
from tnst_mi.recipe.keyframes import with_keyframes
from tnst_mi.recipe.keys import Kind, Number, Switch, Texts
from tnst_mi.recipe.recipe import KINDS, Recipe, documentation
from tnst_mi.resources import expanded
from tnst_mi.run.inputs import reference_density

#: Other names of flags: earlier ones, which still work, and one whose own name is a word of Python.
OTHER_FLAGS = {"units": ("--velocity-units",), "origin": ("--move",), "start_from": ("--from",)}

Folder = Annotated[Path, tyro.conf.arg(metavar="FOLDER")]


@dataclass(kw_only=True)
class Arguments:
    """Arguments common to all commands of `tnst-mi`."""

    debug: bool = False
    """Show Python's traceback when something fails."""


def recipe_flag(name: str, keyframes: bool = True) -> Any:
    """The type of the flag for a recipe key: its text or texts; None or () if the flag is not given.

    Args:
        name: the key.
        keyframes: whether the help says how to give values that change over the frames, where the key may have some.
    """
    kind, text = KINDS[name], documentation()[name]
    if isinstance(kind, Switch) and kind.bare:
        return Annotated[bool, tyro.conf.arg(help=text)]
    options = tyro.conf.arg(
        metavar=kind.placeholder,
        help=with_keyframes(name, text, "Keyframes, in quotes") if keyframes else text,
        help_behavior_hint=f"(default: {kind.show(getattr(Recipe(), name))})",
        aliases=OTHER_FLAGS.get(name),
    )
    if isinstance(kind, Texts):
        return Annotated[tuple[str, ...], tyro.conf.UseAppendAction, options]
    return Annotated[str | None, options]


def recipe_flags(keys: Iterable[str], keyframes: bool = True) -> type:
    """A dataclass of the flags for some keys of the recipe, see `recipe_flag`."""
    fields = [(key, recipe_flag(key, keyframes), field(default=_not_given(KINDS[key]))) for key in keys]
    return make_dataclass("RecipeFlags", fields)


def given(flags: Any) -> dict[str, Any]:
    """The texts of the recipe flags that were given, by key."""
    texts = {key: "true" if text is True else text for key, text in dataclasses.asdict(flags).items()}
    return {key: text for key, text in texts.items() if text not in (None, (), False)}


def _not_given(kind: Kind) -> Any:
    """The value of a flag that is not given."""
    if isinstance(kind, Switch) and kind.bare:
        return False
    return () if isinstance(kind, Texts) else None


@dataclass(frozen=True)
class Unit:
    """The unit of density of a command's frames.

    Attributes:
        reference: their reference density as they are stored.
        factor: of all densities.
    """

    reference: float
    factor: float

    def note(self) -> None:
        """Say on stderr by what the densities are multiplied, or that their unit is unusual."""
        thick = self.reference * self.factor
        if self.factor != 1:
            print(f"note: densities are taken times {self.factor:.4g} (--density-scale)", file=sys.stderr)
        elif is_unusual(thick):
            print(
                f"note: the density of thick smoke is {thick:.4g} here, where gamma and looks mean that of 1: "
                "--density-scale auto makes it 1",
                file=sys.stderr,
            )


def unit_of(frames: Iterable[Frame], density_scale: str) -> Unit:
    """The unit of frames that are read for it, by the text of --density-scale.

    Raises:
        InputError: it is not a number above 0 nor "auto", or a frame cannot be read.
    """
    given = checked("density-scale", density_scale, KINDS["density_scale"])
    reference = reference_density(frames)
    return Unit(reference.value, reference.scale(given))


def checked(flag: str, text: str, kind: Kind) -> Any:
    """The value of a flag that is no key of the recipe, from its text.

    Raises:
        InputError: it is none of its kind.
    """
    try:
        return kind.check(kind.read(text))
    except (ValueError, OverflowError):
        raise InputError(f"--{flag} {text}: {expectation(kind, text)}") from None


def say(lines: Iterable[str]) -> None:
    """Print lines on stderr."""
    for line in lines:
        print(printable(line), file=sys.stderr)


def cameras_of(text: str, views: Sequence[str], default: Sequence[str], flip: str | None) -> Cameras:
    """The cameras of --camera, which stands in place of --views.

    Args:
        text: of the flag.
        views: the texts of --views.
        default: what these are if they are not given.
        flip: the axes that are mirrored on reading.

    Raises:
        InputError: views are given too, the smoke is mirrored, or the file cannot be read.
    """
    require_unmirrored(flip)
    if tuple(views) != tuple(default):
        raise InputError(f"--camera {text} and --views {' '.join(views)}: both say from where; give one")
    return read_cameras(str(expanded(Path(text))))


def view_of(text: str) -> tuple[float, float]:
    """Parse one view of `--views`: (azimuth, elevation) in degrees.

    Raises:
        InputError: it is not such a pair.
    """
    try:
        azimuth, elevation = (Number(-360.0, 360.0).check(float(part)) for part in text.split(","))
    except ValueError:
        raise InputError(f"--views {text}: expected AZIMUTH,ELEVATION in degrees, such as -10,5") from None
    return azimuth, elevation
