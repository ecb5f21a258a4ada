"""The kinds of values of `mask` and `target`: tables of a recipe that say where a goal applies.

A mask is the name of a grid of the input, a file, a table, or a list of these, whose product it is. Every number in a
table may be a table of keyframes itself, `radius = {70 = 0.2, 90 = 0.5}`.
"""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.io.files.frame_numbers import DIGITS
from tnst_mi.recipe.keyframes import KEYABLE, frame_number
from tnst_mi.recipe.keys import Choice, Integer, Kind, Number, Switch, Text
from tnst_mi.recipe.optional_keys import Point

#: The goals of which a target has one.
GOALS = ("style", "semantic", "tag", "content", "match")

#: What else a target may have, by its goal: a key of the recipe with another value for this target.
_OF_A_GOAL = {
    "style": ("style_layers", "style_loss", "style_statistics", "all_octaves"),
    "semantic": ("damping",),
    "tag": (),
    "content": ("content_layers",),
    "match": (),
}


@dataclass(frozen=True)
class Pair:
    """Two finite numbers; if `ramp`, different ones, in any order."""

    expected: str
    ramp: bool = False

    def check(self, value: Any) -> tuple[float, float]:
        """Accept two numbers."""
        if not isinstance(value, list | tuple) or len(value) != 2:
            raise ValueError
        first, second = (Number().check(number) for number in value)
        if self.ramp and first == second:
            raise ValueError
        return first, second


#: The keys of a mask's table that hold numbers, which may be keyframed.
_NUMBERS: dict[str, Any] = {
    "centre": Point(expected="three numbers, such as [0.0, 1.5, 0.0]"),
    "radius": Number(above=0.0),
    "low": Point(expected="three numbers, such as [-1.0, 0.0, -1.0]"),
    "high": Point(expected="three numbers, such as [1.0, 2.0, 1.0]"),
    "edge": Number(low=0.0),
    "height": Pair("two different numbers, such as [0.5, 2.0]", ramp=True),
    "range": Pair("two different numbers, such as [300, 900]", ramp=True),
    "view": Pair("azimuth and elevation in degrees, such as [0, 0]"),
    "strength": Number(0.0, 1.0),
}

_OTHERS: dict[str, Any] = {
    "shape": Choice(("sphere", "box")),
    "grid": Text("NAME", "the name of a grid"),
    "file": Text("FILE", "the path of a file, a folder or a pattern such as 'mask_####.vdb'"),
    "image": Text("FILE", "the path of a picture"),
    "invert": Switch(),
}

#: What a mask is made of: the keys that are needed together, and those that may be added.
_FORMS: dict[str, tuple[frozenset[str], frozenset[str]]] = {
    "sphere": (frozenset({"shape", "centre", "radius"}), frozenset({"edge"})),
    "box": (frozenset({"shape", "low", "high"}), frozenset({"edge"})),
    "file": (frozenset({"file"}), frozenset({"grid", "range"})),
    "grid": (frozenset({"grid"}), frozenset({"range"})),
    "height": (frozenset({"height"}), frozenset()),
    "image": (frozenset({"image", "view"}), frozenset()),
    "everywhere": (frozenset({"strength"}), frozenset()),
}
_ALWAYS = frozenset({"strength", "invert", "follow"})


def form_of(part: Mapping[str, Any]) -> str:
    """What the table of a mask is made of: "sphere", "box", "file", "grid", "height", "image", or "everywhere"."""
    if "shape" in part:
        return part["shape"]
    return next((form for form in ("file", "grid", "height", "image") if form in part), "everywhere")


@dataclass(frozen=True)
class MaskKind:
    """A mask: text, a table, or a list of these; None for "not set"."""

    placeholder: str = "NAME|FILE|TABLE"
    expected: str = (
        'the name of a grid or a file, a table such as {shape = "sphere", centre = [0, 1, 0], radius = 0.5}, '
        "or a list of these"
    )

    def check(self, value: Any) -> Any:
        """Return texts and tables in their normal form; `InputError` says what is wrong inside a table."""
        if value is None:
            return None
        if isinstance(value, list | tuple):
            if not value:
                raise ValueError
            return tuple(self._part(part) for part in value)
        return self._part(value)

    def read(self, text: str) -> str:
        """The text is the value."""
        return text

    def show(self, value: Any) -> str:
        """The value is the text."""
        return "not set" if value is None else str(value)

    def _part(self, part: Any) -> Any:
        if isinstance(part, str) and part:
            return part
        if not isinstance(part, Mapping) or not part:
            raise ValueError
        checked = {str(key): _entry(str(key), value) for key, value in part.items()}
        form = form_of(checked)
        needed, allowed = _FORMS[form]
        named = f'shape = "{form}"' if form in ("sphere", "box") else form
        if missing := sorted(needed - set(checked)):
            what = (
                f"{named} needs" if form != "everywhere" else "a table without shape, grid, file, height or image needs"
            )
            raise InputError(f"{what} {' and '.join(missing)}")
        if foreign := [key for key in checked if key not in needed | allowed | _ALWAYS]:
            raise InputError(f"{foreign[0]} does not belong to {named}")
        return checked


@dataclass(frozen=True)
class TargetsKind:
    """Tables of one goal each, with mask and weight.

    Args:
        kinds: gives the kinds of the recipe's keys, of which the goals are some.
    """

    kinds: Callable[[], Mapping[str, Kind]]
    placeholder: str = "TABLES"
    expected: str = "tables [[target]] with a goal each"

    def check(self, value: Any) -> tuple[dict[str, Any], ...]:
        """Return the tables in their normal form; `InputError` says what is wrong inside one."""
        if not isinstance(value, list | tuple) or not all(isinstance(table, Mapping) for table in value):
            raise ValueError
        return tuple(self._table(number, table) for number, table in enumerate(value, start=1))

    def read(self, text: str) -> str:
        """There is no flag: a text is refused by `check`."""
        return text

    def show(self, value: tuple[dict[str, Any], ...]) -> str:
        """How many there are."""
        return f"{len(value)} targets" if value else "none"

    def _table(self, number: int, table: Mapping[Any, Any]) -> dict[str, Any]:
        where = f"number {number}: "
        goals = [goal for goal in GOALS if goal in table]
        if len(goals) != 1:
            found = " and ".join(goals) or "none"
            raise InputError(f"{where}has {found}, expected one of {', '.join(GOALS)}; a target has one goal")
        known = (goals[0], "mask", "weight", *_OF_A_GOAL[goals[0]])
        if foreign := [key for key in table if key not in known]:
            above = "; keys of the recipe go above the first [[target]]" if foreign[0] in self.kinds() else ""
            raise InputError(
                f"{where}{foreign[0]!r} is no key of a target with {goals[0]}; they are {', '.join(known)}{above}"
            )
        checked = {}
        for key, entry in table.items():
            try:
                checked[key] = self._entry(key, entry)
            except InputError as error:
                raise InputError(f"{where}{key}: {error}") from None
            except (ValueError, OverflowError):
                expected = "a number of 0 or more" if key == "weight" else self.kinds()[key].expected
                raise InputError(f"{where}{key} = {reprlib.repr(entry)}: expected {expected}") from None
        return checked

    def _entry(self, key: str, value: Any) -> Any:
        if key == "weight":
            return _keyed(value, Number(low=0.0))
        kind = self.kinds()[key]
        if key in KEYABLE and isinstance(value, Mapping):
            return _keyed({frame: _listed(key, entry) for frame, entry in value.items()}, kind)
        return kind.check(_listed(key, value))


def _listed(key: str, value: Any) -> Any:
    """A target has one goal, so that its text needs no list."""
    return [value] if key in GOALS and isinstance(value, str) else value


def _entry(key: str, value: Any) -> Any:
    if key == "follow":
        # True is an integer for Python.
        kind = Switch() if isinstance(value, bool) else Integer(-(10**DIGITS) + 1, 10**DIGITS - 1)
        expected = "true, or the number of the frame whose mask moves"
    elif key in _NUMBERS or key in _OTHERS:
        kind = _NUMBERS.get(key) or _OTHERS[key]
        expected = kind.expected
    else:
        raise InputError(f"unknown key {key!r}; the keys of a mask are {', '.join((*_OTHERS, *_NUMBERS, 'follow'))}")
    try:
        checked = _keyed(value, kind) if key in _NUMBERS else kind.check(value)
        if checked is None:
            raise ValueError
        return checked
    except (ValueError, OverflowError):
        raise InputError(f"{key} = {reprlib.repr(value)}: expected {expected}") from None


def _keyed(value: Any, kind: Any) -> Any:
    """A checked value, or a table {frame number: checked value} in frame order."""
    if not isinstance(value, Mapping):
        return kind.check(value)
    frames = [frame_number(key) for key in value]
    if not frames or None in frames or len(set(frames)) < len(frames):
        raise ValueError
    return dict(sorted((frame, kind.check(entry)) for frame, entry in zip(frames, value.values(), strict=True)))
