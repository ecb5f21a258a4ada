"""What tnst-mi says of a recipe, in the words of the panel: artists have seen no recipe."""

from __future__ import annotations

import re

from ..recipes.parameters import parameters

#: Keys of a recipe that the panel or the preferences have, by their labels there.
LABELS = {
    "style": "Picture",
    "tag": "Motif",
    "semantic": "Channel",
    "mask": "Region",
    "target": "Region",
    "quality": "Quality",
    "frames": "Frame Range",
    "camera": "Camera",
    "strength": "Strength",
    "weights": "Network",
}

#: Remedies on the command line, and in the panel; flags by themselves are those that take no value.
REMEDIES = {
    "give its INPUT too to begin it": "press Stylize",
    "leave out --resume to begin one": "press Stylize",
    "--resume": "Resume",
    "--overwrite": "Stylize",
}

#: How tnst-mi begins what it says. Other programs, such as pip, have flags of the same names.
_SAID = "tnst-mi: "

#: The file of a recipe at the beginning of an error.
_FILE = re.compile(rf"^({_SAID}).*?([^/\\]+)\.toml: ")

#: A key with its value.
_ASSIGNED = re.compile(r"(?<![\w.-])([a-z_]+)(?= = )")

#: A flag that stands alone, or with the placeholder of its value. With a value, as in "--weights patterns", it is
#: something to be typed.
_FLAG = re.compile(r"(?<![\w-])--([a-z][a-z-]*)\b(?: [A-Z]{2,}\b)?(?=$|[,.;:)]| or | and )")


def in_panel_words(text: str) -> str:
    """An error of tnst-mi, with settings in place of the keys and flags that they stand for.

    Other keys can be set in *Advanced*, and are named with that. The file of a recipe, which the add-on wrote, is left
    out; those of markers, named by them, keep their names. Lines of other programs stay as they are.
    """
    return "\n".join(_of_line(line) if line.startswith(_SAID) else line for line in text.splitlines())


def _of_line(text: str) -> str:
    for remedy, here in REMEDIES.items():
        text = text.replace(remedy, here)
    text = _FILE.sub(lambda found: found[1] + ("" if found[2] == "recipe" else f"{found[2]}: "), text)
    text = _ASSIGNED.sub(lambda found: _label(found[1]) or found[0], text)
    return _FLAG.sub(lambda found: _label(found[1].replace("-", "_")) or found[0], text)


def _label(key: str) -> str | None:
    """What a key is named in the panel; None of what is no key."""
    return LABELS.get(key) or (f"Advanced, {key}" if key in parameters() else None)
