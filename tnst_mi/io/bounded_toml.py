"""TOML whose keys and values are only as deep as those of a recipe or a file of cameras.

Python's parser takes time and memory with the square of the parts of a key: minutes for the 200 kB of one.
"""

from __future__ import annotations

import re
import tomllib
from typing import Any

from tnst_mi.errors import InputError

#: Parts of a key, as in `gamma.49`, and brackets inside of one another. A recipe needs half of them.
_PARTS, _NESTED = 4, 8

# In strings and comments anything may stand. One that is not closed, which is no TOML, ends with its line or the text.
_OPAQUE = re.compile(
    r"""
    \"{3} (?: [^"\\]++ | \\. | "(?!"") )*+ (?: "{3,5} | \\?\Z ) | '{3} (?: [^']++ | '(?!'') )*+ (?: '{3,5} | \Z )
    | " (?: [^"\\\n]++ | \\. )*+ "? | ' [^'\n]*+ '? | \#[^\n]*+
    """,
    re.DOTALL | re.VERBOSE,
)
_DEEP_KEY = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{_PARTS}}}")
_BRACKET = re.compile(r"[\[\]{}]")


def toml_values(text: str) -> dict[str, Any]:
    """The keys and values of a text in TOML.

    Raises:
        InputError: its keys or values are too deep.
        ValueError: it is no TOML.
    """
    bare = _OPAQUE.sub(lambda found: "" if found[0].startswith("#") else "s", text)
    if _DEEP_KEY.search(bare):
        raise InputError(f"a key of more than {_PARTS} parts; write keys such as eta, or gamma.49 for one frame")
    depth = 0
    for bracket in _BRACKET.findall(bare):
        depth += 1 if bracket in "[{" else -1
        if depth > _NESTED:
            raise InputError(f"more than {_NESTED} brackets inside of one another; write lists and tables of values")
    return tomllib.loads(text)
