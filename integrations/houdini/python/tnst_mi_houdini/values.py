"""The recipe that a node's parameters say. Nodes are `hou.Node`s, of which only the methods used here are needed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .recipe_text import Literal

#: What is said of each key, made from the recipe's documentation with the asset: see scripts/build_houdini_asset.py.
TABLE = Path(__file__).with_name("parameters.json")

#: Beside a number that may be a word instead, or not set, is a menu, KEY_choice; and two of its entries.
CHOICE, NUMBER, UNSET = "_choice", "number", "unset"

#: Numbers in files and in Houdini agree to this share.
_TOLERANCE = 1e-9


class BadValue(ValueError):
    """A parameter holds what no recipe can; the message is one line with the remedy."""


def keys() -> list[dict[str, Any]]:
    """The keys that the asset has parameters for, each with `key`, `kind`, `default`, `words` and `keyable`."""
    return json.loads(TABLE.read_text(encoding="utf-8"))


def recipe_values(node: Any, frames: Sequence[int]) -> tuple[dict[str, Any], list[str]]:
    """The keys of the recipe that differ from their defaults, and what has to be said of them.

    What is animated, and may change over the frames in a recipe, becomes a table of its values at these frames.

    Args:
        node: the node.
        frames: the numbers of the frames that are stylized.

    Raises:
        BadValue: a text is not as its key needs it.
    """
    values, notes = {}, []
    for about in keys():
        key, value = about["key"], _value(node, about, frames[0])
        if any(parm.isTimeDependent() for parm in _parms(node, about, value)):
            if about["keyable"] and about["kind"] in ("number", "range") and not _has_moving_menu(node, about):
                value = {str(frame): _value(node, about, frame) for frame in frames}
            else:
                notes.append(f"{key} is animated, and cannot change over the frames: taken as at frame {frames[0]}")
        if value is not None and not _is_default(value, about["default"]):
            values[key] = value
    return values, notes


def _has_moving_menu(node: Any, about: dict[str, Any]) -> bool:
    return has_choice(about) and node.parm(about["key"] + CHOICE).isTimeDependent()


def _parms(node: Any, about: dict[str, Any], value: Any) -> list[Any]:
    """The parameters that a value is from."""
    key = about["key"]
    menu = [node.parm(key + CHOICE)] if has_choice(about) else []
    if menu and not isinstance(value, (int, float, list)):
        return menu
    if about["kind"] in ("number", "integer", "range", "point"):
        return [*menu, *node.parmTuple(key)]
    if about["kind"] == "texts":
        return [node.parm(f"{key}{number}") for number in range(1, int(node.parm(key).eval()) + 1)]
    return [node.parm(key)]


def _value(node: Any, about: dict[str, Any], frame: int) -> Any:
    """What a recipe says at a frame; None for what is not set."""
    key, kind = about["key"], about["kind"]
    if has_choice(about):
        chosen = node.parm(key + CHOICE).evalAsStringAtFrame(frame)
        if chosen != NUMBER:
            return None if chosen == UNSET else chosen
    if kind in ("number", "range", "point"):
        numbers = [float(number) for number in node.parmTuple(key).evalAtFrame(frame)]
        return numbers[0] if kind == "number" else numbers
    if kind == "integer":
        return int(node.parmTuple(key).evalAtFrame(frame)[0])
    if kind == "switch":
        return bool(node.parm(key).evalAsIntAtFrame(frame))
    if kind == "choice":
        chosen = node.parm(key).evalAsStringAtFrame(frame)
        return None if chosen == UNSET else chosen
    if kind == "texts":
        texts = (
            node.parm(f"{key}{number}").evalAsStringAtFrame(frame)
            for number in range(1, int(node.parm(key).eval()) + 1)
        )
        return [text for text in texts if text]
    text = node.parm(key).evalAsStringAtFrame(frame).strip()
    if kind == "layers":
        return _layers(key, text)
    if kind == "length":
        return _length(text)
    if kind == "other" and text[:1] in ("{", "["):
        return Literal(text)
    return text or None


def has_choice(about: dict[str, Any]) -> bool:
    """Whether a key has a menu beside its number, for what may be there instead."""
    numbers = about["kind"] in ("number", "integer", "point", "range")
    return numbers and (bool(about["words"]) or about["default"] is None)


def _layers(key: str, text: str) -> dict[str, float]:
    """Layers with weights, from LAYER[=WEIGHT], …"""
    weights = {}
    for entry in filter(None, (part.strip() for part in text.split(","))):
        layer, _, weight = entry.partition("=")
        try:
            weights[layer.strip()] = float(weight) if weight else 1.0
        except ValueError:
            raise BadValue(
                f"{key}: {entry!r}, expected LAYER or LAYER=WEIGHT, separated by commas, such as conv2/3x3=0.5"
            ) from None
    return weights


def _length(text: str) -> Any:
    """A number of cells, or a text such as "5%" or "off"."""
    try:
        return float(text)
    except ValueError:
        return text


def _is_default(value: Any, default: Any) -> bool:
    if isinstance(value, list) and isinstance(default, list):
        pairs = zip(value, default)  # noqa: B905 (the argument is new in Python 3.10)
        return len(value) == len(default) and all(_is_default(*pair) for pair in pairs)
    if isinstance(value, (int, float)) and isinstance(default, (int, float)):
        return abs(value - default) <= _TOLERANCE * max(abs(value), abs(default))
    return value == default
