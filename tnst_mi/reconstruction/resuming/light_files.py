"""The files that a light is made of: its scene file, what that includes, and what its plugins read."""

from __future__ import annotations

import os
from pathlib import Path

import mitsuba as mi


def light_files(path: Path) -> list[Path]:
    """The existing files by which a Mitsuba scene is what it is.

    Args:
        path: the scene file. What is wrong with it is told by whoever loads it.
    """
    config, found = mi.parser.ParserConfig(mi.variant()), [path]
    try:
        parsed = mi.parser.parse_file(config, str(path))
    except RuntimeError:
        return found
    found += [Path(str(file)) for file in parsed.files]
    # Whatever a plugin is told that is the name of a file, as Mitsuba would find it: beside the scene file. Texts need
    # not be short enough for one, which `isfile` takes for none.
    for node in parsed.nodes:
        keys = [key for key in node.props.keys() if node.props.type(key) == mi.Properties.Type.String]
        found += [path.parent / node.props[key] for key in keys if node.props[key]]
    return [file for file in dict.fromkeys(file.absolute() for file in found) if os.path.isfile(file)]
