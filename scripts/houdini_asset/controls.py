"""The Houdini parameters of a recipe's key, from what its documentation says it may be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tnst_mi_houdini.values import CHOICE, NUMBER, UNSET, has_choice

from houdini_asset import dialog

#: What artists read, where the key in capitals would not tell them.
LABELS = {
    "lam": "Divergence (λ)",
    "gamma": "Extinction (γ)",
    "eta": "Step Size (η)",
    "sigma": "Brightness Scales (σ)",
    "spp": "Paths per Pixel",
    "fps": "Frames per Second",
    "dt": "Duration of a Frame",
    "tag": "Motifs by Name",
    "style": "Style Pictures",
    "semantic": "Channels of the Network",
    "content": "Content Pictures",
    "match": "Maps of Features",
    "target": "Goals in Regions",
    "fit": "Images Fit the Whole Grid",
    "carry": "Grids That Move Along",
    "weights": "Network",
    "variant": "GPU or CPU",
    "up": "Up Axis",
    "fog": "Level Set as Fog",
    "scale": "Density Factor",
    "units": "Velocity Units",
    "window": "Window (Frames)",
    "views": "Viewpoints",
    "colour": "Colour",
}

# Numbers to begin with where the default is a word, or nothing.
_BEGINNINGS = {"motif_size": 0.25, "fps": 24, "dt": 0.041666667, "stages": 8, "threads": 4}

# A slider that ends at its key's bound is of use up to so many times the default; beyond, it ends at ten times that.
_WIDEST, _WIDE = 40, 10

_ENTRIES = {UNSET: "not set", NUMBER: "number"}

# What a text is, by what stands for it in the documentation.
_FILES = ("FILE", "IMAGE")


def label_of(key: str) -> str:
    """What artists read."""
    return LABELS.get(key, key.replace("_", " ").title())


def parms_of(about: Mapping[str, Any], suggestions: Mapping[str, list[str]]) -> list[str]:
    """The parameters of a key.

    Args:
        about: what `tnst_mi.recipe.parameters` says of it.
        suggestions: texts to choose from, by key.
    """
    kind = about["kind"]
    if kind in ("number", "integer", "range", "point"):
        return _numbers(about)
    name, label, text = about["key"], label_of(about["key"]), about["help"]
    offered = suggestions.get(name, [])
    if kind == "switch":
        return [dialog.parm(name, label, "toggle", [str(int(about["default"]))], help=text)]
    if kind == "choice":
        menu = {choice: _readable(choice) for choice in about["choices"]}
        if about["default"] is None:
            menu = {UNSET: _ENTRIES[UNSET], **menu}
        return [dialog.parm(name, label, "ordinal", [about["default"] or UNSET], help=text, menu=menu)]
    file = "file" if about["placeholder"].startswith(_FILES) else "string"
    if kind == "texts":
        each = dialog.parm(f"{name}#", about["placeholder"], file, [""], help=text, suggestions=offered)
        return [dialog.several(name, label, each)]
    if kind == "layers":
        default = ", ".join(
            layer if weight == 1 else f"{layer}={weight:g}" for layer, weight in about["default"].items()
        )
        return [dialog.parm(name, label, "string", [default], help=text)]
    tags = {"editor": "1", "editorlines": "3-10"} if kind == "other" else {}
    default = about["default"] if isinstance(about["default"], str) else ""
    return [dialog.parm(name, label, file, [default], help=text, suggestions=offered, tags=tags)]


def _numbers(about: Mapping[str, Any]) -> list[str]:
    """A number or several, and before them the menu of what may be there instead."""
    key, default = about["key"], about["default"]
    label, menu = label_of(key), []
    if has_choice(about):
        words = [*([UNSET] if default is None else []), *about["words"], NUMBER]
        chosen = default if default in words else UNSET if default is None else NUMBER
        entries = {word: _ENTRIES.get(word, _readable(word)) for word in words}
        menu = [dialog.parm(key + CHOICE, label, "ordinal", [chosen], help=about["help"], menu=entries, join=True)]
        label = f"{label}: Number"
    size = {"range": 2, "point": 3}.get(about["kind"], 1)
    first = default if isinstance(default, (int, float)) else _BEGINNINGS.get(key, _clipped(1.0, about))
    defaults = default if isinstance(default, list) else [0.0] * size if about["kind"] == "point" else [first]
    number = dialog.parm(
        key,
        label,
        "integer" if about["kind"] == "integer" else "float",
        [f"{value:.9g}" for value in defaults],
        help=about["help"],
        bounds=_bounds(about, max(map(abs, defaults))),
        hidden=f"{key}{CHOICE} != {NUMBER}" if menu else "",
    )
    return [*menu, number]


def _bounds(about: Mapping[str, Any], default: float) -> str:
    """The range of a slider: bounds that are near lock it, far ones are left to tnst-mi to refuse."""
    low = about["low"] if about["low"] is not None else about["above"]
    high, wide = about["high"], _WIDE * (default or 1.0)
    top = f"{high:g}!" if high is not None and high <= _WIDEST * max(default, 1.0) else f"{wide:g}"
    return f"{-wide:g} {top}" if low is None else f"{low:g}! {top}"


def _clipped(number: float, about: Mapping[str, Any]) -> float:
    low, high = about["low"], about["high"]
    number = number if low is None else max(number, low)
    return number if high is None else min(number, high)


def _readable(word: str) -> str:
    """A word of the recipe, which its documentation has too."""
    return word.replace("_", " ").replace("-", " ")
