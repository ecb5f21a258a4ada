"""Keyframes: values of a recipe that change over the frames of a sequence.

In a recipe, a table from frame numbers to values, such as `gamma = {49 = 0.1, 72 = 1.0}`, can replace a single value.
Values are linear between the keys, constant before the first and after the last.
"""

from __future__ import annotations

import bisect
import re
import reprlib
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any

from tnst_mi.errors import InputError

#: The values of one key as (frame number, value) pairs in frame order; at least one.
Keyframes = tuple[tuple[int, Any], ...]

#: The keys of a recipe whose values may change over the frames, each with such a table.
KEYABLE = {
    "style": '{49 = "fire.png", 72 = "spirals"}',
    "style_weight": "{49 = 1, 72 = 0.5}",
    "semantic_weight": "{49 = 0, 72 = 1}",
    "lam": "{49 = 1, 72 = 0}",
    "gamma": "{49 = 0.1, 72 = 1.0}",
    "azimuth": "{49 = [-10, 10], 72 = [30, 50]}",
    "elevation": "{49 = [-5, 5], 72 = [10, 20]}",
    "eta": "{49 = 0.001, 72 = 0.002}",
    "strength": "{49 = 0.2, 72 = 1}",
    "blend": "{49 = 0, 72 = 1}",
}


#: The keys whose values are tables from layers to weights, and those whose values are tables with keys of their own.
LAYER_TABLES = ("style_layers", "content_layers")
REGION_TABLES = ("mask", "target")


def with_keyframes(name: str, text: str, introduction: str) -> str:
    """The documentation of a key, with an example of keyframes if it may have some.

    Example:
        >>> with_keyframes("gamma", "Extinction.", "Keyframes")
        'Extinction. Keyframes: {49 = 0.1, 72 = 1.0}.'
    """
    return f"{text} {introduction}: {KEYABLE[name]}." if name in KEYABLE else text


def is_keyframed(name: str, value: Any) -> bool:
    """Whether the value of a key is a table from frames to values; a table from layers to weights is not."""
    if not isinstance(value, Mapping) or name in REGION_TABLES:
        return False
    return name not in LAYER_TABLES or (len(value) > 0 and all(frame_number(key) is not None for key in value))


def converted(name: str, value: Any, source: str, convert: Callable[[str, Any, str], Any]) -> Any:
    """Return convert(name, value, source), or for a table {frame number: converted value} in frame order.

    Raises:
        InputError: the value is a table, but the key cannot be keyframed, or the table's keys are not frame numbers.
    """
    if not is_keyframed(name, value):
        return convert(name, value, source)
    entries = _by_frame(name, value, source)
    return {frame: convert(name, entry, f"{source}frame {frame}: ") for frame, entry in sorted(entries.items())}


def value_at(keys: Keyframes, frame: int | float) -> Any:
    """The value at a frame, for keys that hold numbers, or tuples of numbers of equal length."""
    after = bisect.bisect_right(keys, frame, key=lambda key: key[0])
    if after == 0:
        return keys[0][1]
    if after == len(keys):
        return keys[-1][1]
    (first, start), (last, end) = keys[after - 1 : after + 1]
    share = (Fraction(float(frame)) - first) / (last - first)
    if isinstance(start, tuple):
        return tuple(_between(low, high, share) for low, high in zip(start, end, strict=True))
    return _between(start, end, share)


def pictures_of(keys: Keyframes) -> tuple[str, ...]:
    """All pictures in the lists that the keys hold, each once, in order of first appearance."""
    return tuple(dict.fromkeys(picture for _, pictures in keys for picture in pictures))


def shares_at(keys: Keyframes, frame: int | float) -> tuple[float, ...]:
    """The share of each of `pictures_of(keys)` at a frame.

    At a key, the share is how often its list names the picture, usually 1 or 0; between keys, shares are linear, so
    that the pictures of one list fade into those of the next.
    """
    return tuple(
        value_at(tuple((key, float(pictures.count(picture))) for key, pictures in keys), frame)
        for picture in pictures_of(keys)
    )


def _between(start: float, end: float, share: Fraction) -> float:
    # Exact, and rounded once: values stay in the range of their neighbours, and low ≤ high is preserved.
    return float((1 - share) * Fraction(start) + share * Fraction(end))


def _by_frame(name: str, table: Mapping[Any, Any], source: str) -> dict[int, Any]:
    if name not in KEYABLE:
        shown = reprlib.repr(dict(table))
        raise InputError(f"{source}{name} = {shown}: cannot be keyframed; the keys that can are {', '.join(KEYABLE)}")
    if not table:
        raise InputError(f"{source}{name} = {{}}: expected at least one frame number with a value")
    entries = {}
    for key, entry in table.items():
        frame = frame_number(key)
        if frame is None:
            shown = reprlib.repr(key)
            raise InputError(f"{source}{name}: {shown} is no frame number, expected a whole number of up to 9 digits")
        if frame in entries:
            raise InputError(f"{source}{name}: frame {frame} is there twice, expected each frame once")
        if entry == "auto":
            raise InputError(f"{source}{name}: auto is one value for all frames, expected numbers in a table of frames")
        # In a table, a single picture needs no list.
        entries[frame] = [entry] if name == "style" and isinstance(entry, str) else entry
    return entries


def frame_number(key: Any) -> int | None:
    """The frame number that a key of a table means; None if it is none."""
    if isinstance(key, str) and re.fullmatch("-?[0-9]{1,9}", key):
        return int(key)
    if isinstance(key, int) and not isinstance(key, bool) and abs(key) < 10**9:
        return key
    return None
