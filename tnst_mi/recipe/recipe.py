"""The recipe of a stylization: one flat, documented set of keys for TOML files and the command line.

Every key is defined in `tnst_mi.recipe.sections`, for TOML and, with dashes for underscores, as a flag of `tnst-mi
stylize`. Values are taken from the defaults or the preset, then from the recipe file, then from the flags; the last one
given wins.
In a file, some may change over the frames (`tnst_mi.recipe.keyframes`); `Recipe.at` returns the recipe of one frame.
"""

from __future__ import annotations

import dataclasses
import functools
import reprlib
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
import tomlkit

from tnst_mi.errors import InputError
from tnst_mi.machine.gate import decoding
from tnst_mi.machine.notebook_display import NotebookDisplay
from tnst_mi.recipe.expectation import expectation
from tnst_mi.recipe.flag_values import value_of_flag
from tnst_mi.recipe.keyframes import (
    REGION_TABLES,
    Keyframes,
    converted,
    is_keyframed,
    pictures_of,
    shares_at,
    value_at,
    with_keyframes,
)
from tnst_mi.recipe.paths import located, shipped_name
from tnst_mi.recipe.presets import implied
from tnst_mi.recipe.recipe_file import read_recipe_file
from tnst_mi.recipe.sections import KINDS, Colouring, Goals, Method, Reading, Resources, documentation
from tnst_mi.recipe.synonyms import advice, meant
from tnst_mi.resources import expanded

#: (azimuth, elevation) in degrees, and the distance in cells of a perspective view.
_View = tuple[float, float] | tuple[float, float, float]


@dataclass(frozen=True)
class Recipe(Reading, Resources, Colouring, Method, Goals, NotebookDisplay):
    """Everything that determines a stylization, apart from the frames themselves.

    A notebook shows its pictures, and the keys that are not as by default.

    Some keys (`tnst_mi.recipe.keyframes.KEYABLE`) accept a table {frame number: value} instead of a single value. Their
    attributes then hold the value at the first frame of the table; `style` holds the pictures of all its frames.

    A `preset` sets the keys that are not given, now or by `updated`; λ above 0 or sub-steps imply the transport
    "step". `dataclasses.replace` passes every key, so that in its result all of them are given.

    Raises:
        InputError: a value has the wrong type or is out of range.

    Example:
        >>> import tnst_mi
        >>> recipe = tnst_mi.Recipe(style=("spirals",), octaves=2, gamma={10: 0.1, 20: 1.0})
        >>> recipe.lam, recipe.gamma, recipe.at(15).gamma
        (0.0, 0.1, 0.55)
        >>> recipe.style_layers
        {'conv2/3x3': 1.0, 'inception_3b/output': 1.0, 'inception_4b/output': 1.0}
        >>> "octaves = 2" in recipe.to_toml()
        True
        >>> tnst_mi.Recipe(preset="paper", style_loss="gram").sigma
        'loss'
        >>> tnst_mi.Recipe(lam=2.0)
        Traceback (most recent call last):
        tnst_mi.errors.InputError: recipe: lam = 2.0: expected a number from 0 to 1
    """

    keyframes: Mapping[str, Keyframes] = field(default_factory=dict)
    """The keys given such tables, each as (frame number, value) pairs in frame order; they override the attributes.
    Derived from the tables, never a key of a file."""
    style_shares: tuple[float, ...] = ()
    """The share of each picture of `style`, 0 or more: all 1 except in a recipe from `at`. Never read from a file or
    written to one."""
    shots: tuple[_View, ...] = ()
    """Where `camera` sees the smoke of each frame of a run from, in their order: (azimuth, elevation) in degrees, and
    of a perspective one the distance from the grid's centre in cells. Of one frame's recipe, its own. Set by a run,
    never read from a file or written to one."""
    given: frozenset[str] = field(init=False, repr=False, compare=False)
    """The keys that were given, rather than left to the defaults or the preset. Derived, never a key of a file."""

    def __new__(cls, **keys: Any) -> Self:
        """Note which keys are given, before the constructor of the dataclass sets the others to their defaults."""
        recipe = super().__new__(cls)
        object.__setattr__(recipe, "given", frozenset(keys) & frozenset(KINDS) | frozenset(keys.get("keyframes", ())))
        return recipe

    def __post_init__(self) -> None:
        """Check every value and bring it into its normal form; those that are not given are the preset's."""
        preset, steps = (_checked(name, getattr(self, name), "recipe: ") for name in ("preset", "steps"))
        lam = converted("lam", self._value_or_table("lam"), "recipe: ", _checked)
        largest = max(lam.values()) if is_keyframed("lam", lam) else lam
        of_flow = self.conservative is True or self.stages != "auto"
        for name, value in implied(self.given, preset, largest, steps, of_flow).items():
            object.__setattr__(self, name, value)
        keyframes = {}
        for name in dict.fromkeys((*KINDS, *self.keyframes)):
            value = converted(name, self._value_or_table(name), "recipe: ", _checked)
            if is_keyframed(name, value):
                keys = keyframes[name] = tuple(value.items())
                value = pictures_of(keys) if name == "style" else keys[0][1]
            object.__setattr__(self, name, value)
        object.__setattr__(self, "keyframes", keyframes)
        if all(share == 1.0 for share in self.style_shares):
            object.__setattr__(self, "style_shares", (1.0,) * len(self.style))
        elif len(self.style_shares) != len(self.style):
            raise InputError(
                f"recipe: style_shares = {self.style_shares}: expected a number for each of the {len(self.style)} "
                "pictures of style"
            )
        span = self.frame_range
        if span is not None and span[0] > span[1]:
            raise InputError(f"recipe: frames = {self.frames!r}: expected the smaller number first")

    @classmethod
    def from_toml(cls, path: str | Path) -> Recipe:
        """Read a recipe file, as `updated_by_file` does."""
        return cls().updated_by_file(path)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], source: str = "recipe: ", folder: Path | None = None) -> Recipe:
        """Make a recipe from TOML values; errors start with `source`, relative paths from `folder`."""
        return cls().updated(values, source, folder or Path.cwd())

    def updated(self, values: Mapping[str, Any], source: str, folder: Path) -> Recipe:
        """Return a copy with some keys replaced, keyframes included (see `from_dict`)."""
        replaced: dict[str, Any] = {}
        for name, value in values.items():
            if name not in KINDS:
                raise InputError(f"{source}unknown key {name!r}{_meant(str(name), value)}")
            checked = converted(name, value, source, _checked)
            replaced[name] = converted(name, checked, source, functools.partial(located, folder=folder))
        kept = {name: self._value_or_table(name) for name in self.given}
        shares = () if "style" in values else self.style_shares
        return Recipe(**kept | replaced, style_shares=shares)

    def updated_by_file(self, path: str | Path) -> Recipe:
        """Return a copy with the keys of a recipe file replaced; relative paths in it start from its folder.

        Raises:
            InputError: the file is missing or not TOML, a key is unknown, a value has the wrong type or is out
                of range, or a picture or another file that it names does not exist.
        """
        path = expanded(Path(path))
        with decoding(path, "a recipe file"):
            return self.updated(read_recipe_file(path), f"{path}: ", path.parent)

    def located(self, folder: Path) -> Recipe:
        """Return a copy with absolute paths, resolved from `folder`; keyframes and shares are kept.

        Raises:
            InputError: a picture, a map or a light does not exist.
        """
        locate = functools.partial(located, folder=folder)
        values = {name: converted(name, self._value_or_table(name), "recipe: ", locate) for name in KINDS}
        return dataclasses.replace(self, **values, keyframes={})

    def at(self, number: int | float | None) -> Recipe:
        """Return the recipe of one frame, without keyframes, or the recipe itself if it has none.

        Values are linear between keys, and constant before the first and after the last. `style` keeps the pictures
        of all keys, and `style_shares` fades from those of one key to those of the next.

        Raises:
            InputError: there are keyframes, and the frame has no number (None).
        """
        if not self.keyframes:
            return self
        if number is None:
            raise InputError(
                f"recipe: {', '.join(self.keyframes)}: frames without numbers cannot be keyframed; number the frames, "
                "or give one value"
            )
        values = {name: value_at(keys, number) for name, keys in self.keyframes.items() if name != "style"}
        if "style" in self.keyframes:
            values["style_shares"] = shares_at(self.keyframes["style"], number)
        return dataclasses.replace(self, **values, keyframes={})

    def updated_by_flags(self, texts: Mapping[str, str | tuple[str, ...]]) -> Recipe:
        """Return a copy with keys replaced by texts of flags; relative paths start from the current folder."""
        recipe = self
        for name, text in texts.items():
            flag = "--" + name.replace("_", "-")
            recipe = recipe.updated({name: value_of_flag(name, text)}, f"{flag}: ", Path.cwd())
        return recipe

    def to_toml(self) -> str:
        """Write the recipe as TOML, every key under its documentation; keys that are not set become comments."""
        document = tomlkit.document()
        for name, text in documentation().items():
            for line in textwrap.wrap(with_keyframes(name, text, "Keyframes"), 100):
                document.add(tomlkit.comment(line))
            value = self._value_or_table(name)
            if value is None:
                document.add(tomlkit.comment(f"{name} is not set"))
            else:
                document.add(name, _toml_value(name, value))
            document.add(tomlkit.nl())
        return tomlkit.dumps(document)

    def _value_or_table(self, name: str) -> Any:
        """The value of a key, or its table of keyframes."""
        return dict(self.keyframes[name]) if name in self.keyframes else getattr(self, name)

    def view(self, azimuth: float, elevation: float) -> _View:
        """The view at angles within the recipe's ranges, in degrees, which are offsets from its shot if it has one.

        Returns:
            (azimuth, elevation), or (azimuth, elevation, distance) of a perspective view.

        Example:
            >>> import tnst_mi
            >>> tnst_mi.Recipe(shots=((30.0, 5.0, 200.0),)).view(-10.0, 1.0)
            (20.0, 6.0, 200.0)
        """
        if not self.shots:
            return azimuth, elevation
        shot = self.shots[0]
        around = shot[0] + azimuth, shot[1] + elevation
        return around if len(shot) == 2 else (*around, shot[2])

    @property
    def extinction(self) -> float:
        """γ as a number; in the recipe of a frame of a run it is per full-resolution cell (`rendering.levels`).

        Raises:
            ValueError: it is "auto", and follows from the grid.
        """
        return float(self.gamma)

    @property
    def main_view(self) -> _View:
        """The view at the centre of the camera ranges, see `view`."""
        return self.view(sum(self.azimuth) / 2.0, sum(self.elevation) / 2.0)

    @property
    def view_ranges(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The ranges of azimuth and elevation of all frames together, those of all shots."""
        azimuth, elevation = (
            np.array([value for _, value in self.keyframes.get(name, ((0, getattr(self, name)),))])
            for name in ("azimuth", "elevation")
        )
        shots = np.array([shot[:2] for shot in self.shots] or [(0.0, 0.0)])
        (low, high), (lowest, highest) = (
            (keys[:, 0].min() + shots[:, axis].min(), keys[:, 1].max() + shots[:, axis].max())
            for axis, keys in enumerate((azimuth, elevation))
        )
        return (float(low), float(high)), (float(lowest), float(highest))

    @property
    def components(self) -> int:
        """Number of optimised values per cell: 1 for Φ if λ > 0, 3 for Ψ if λ < 1, in any frame, and 3 for a colour."""
        lams = [value for _, value in self.keyframes.get("lam", ((0, self.lam),))]
        of_density = 1 if self.parameterisation == "density" else (max(lams) > 0) + 3 * (min(lams) < 1)
        return of_density + 3 * (self.colour == "style")

    @property
    def frame_range(self) -> tuple[int | float, int | float] | None:
        """First and last frame number, both included, or None for all frames; floats if sub-frames count too."""
        if self.frames is None:
            return None
        first, _, last = self.frames.partition(":")
        convert = float if "." in self.frames else int
        return convert(first), convert(last or first)

    @property
    def maps(self) -> list[tuple[str, Path]]:
        """The maps of features to match as (layer, file)."""
        return [(layer, Path(file)) for layer, _, file in (target.partition(":") for target in self.match)]

    @property
    def semantic_channels(self) -> list[tuple[str, tuple[int, ...]]]:
        """The semantic targets as (layer, channels)."""
        parts = [target.partition(":") for target in self.semantic]
        return [(layer, tuple(int(channel) for channel in channels.split(","))) for layer, _, channels in parts]


def _checked(name: str, value: Any, source: str) -> Any:
    try:
        return KINDS[name].check(value)
    except InputError as error:  # inside a table
        raise InputError(f"{source}{name}: {error}") from None
    except (ValueError, OverflowError):
        raise InputError(f"{source}{name} = {reprlib.repr(value)}: {expectation(KINDS[name], value, name)}") from None


def _meant(name: str, value: Any) -> str:
    """What an unknown key probably means, as the end of a message."""
    if isinstance(value, dict) and any(key in KINDS for key in value):
        return "; a recipe has no sections: write its keys without [section]"
    if known := meant(name, KINDS):
        return f"; did you mean {known!r}?"
    return f"; {advice(name, KINDS) or 'tnst-mi stylize --help lists the keys'}"


def _toml_value(name: str, value: Any) -> Any:
    if isinstance(value, dict):
        table = tomlkit.inline_table()
        for key, entry in value.items():
            table[str(key)] = _toml_value(key if name in REGION_TABLES else name, entry)
        return table
    if name in ("style", "content"):
        return [shipped_name(path) for path in value]
    if name in REGION_TABLES and isinstance(value, tuple):
        # Inline, since what follows [[target]] in a file would belong to it.
        array = tomlkit.array()
        array.extend(_toml_value(name, entry) for entry in value)
        return array.multiline(name == "target" and bool(value))
    return list(value) if isinstance(value, tuple) else value
