"""Paths in a recipe: where the files are that it names, and the names of what ships with the package."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError, MissingFileError
from tnst_mi.io.formats import READABLE
from tnst_mi.network.shipped import PATTERNS
from tnst_mi.recipe.keyframes import converted
from tnst_mi.resources import DATA, expanded

#: Style pictures that ship with the package; a recipe names them without folder and extension.
STYLES = DATA / "styles"

#: Extensions by which a picture is known as one where a grid is expected.
_PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".gif", ".webp", ".exr", ".hdr")

#: Mitsuba scenes whose emitters light the smoke, named likewise.
LIGHTS = DATA / "lights"

#: Models that ship with the package.
MODELS = DATA / "models"


def shipped_styles() -> list[str]:
    """Names of the style pictures that ship with the package."""
    return sorted(path.stem for path in STYLES.glob("*.png"))


def shipped_lights() -> list[str]:
    """Names of the lights that ship with the package."""
    return sorted(path.stem for path in LIGHTS.glob("*.xml"))


def shipped_name(path: str) -> str:
    """The name of a style picture that ships with the package; other paths as they are."""
    return Path(path).stem if Path(path).parent == STYLES else path


def located(name: str, value: Any, source: str, folder: Path) -> Any:
    """Make the paths in the checked value of a key absolute.

    Args:
        name: the key.
        value: its value.
        source: begins messages.
        folder: where relative paths start.

    Raises:
        InputError: a file does not exist, or its path is none or cannot be written to a recipe file.
    """
    try:
        return _located(name, value, source, folder)
    except OSError as error:  # such as a path that is too long
        raise InputError(f"{source}{name} = {value!r}: {error.strerror}") from None


def _located(name: str, value: Any, source: str, folder: Path) -> Any:
    if name in ("style", "content"):
        return tuple(_picture(name, entry, source, folder) for entry in value)
    if name == "match":
        return tuple(_map(entry, source, folder) for entry in value)
    if name == "light" and value not in shipped_lights():
        path = _path(name, value, source, folder)
        if not path.is_file():
            raise MissingFileError(f"{source}light = {value!r}: no such file, nor one of {', '.join(shipped_lights())}")
        return str(path.resolve())
    if name == "weights" and value not in (None, PATTERNS) and (path := _path(name, value, source, folder)).exists():
        return str(path.resolve())
    if name == "camera" and value is not None:
        return _camera(value, source, folder)
    if name == "mask":
        return _mask(value, source, folder)
    if name == "target" and value is not None:
        return tuple(_target(number, table, source, folder) for number, table in enumerate(value, start=1))
    return value


def _path(name: str, text: str, source: str, folder: Path) -> Path:
    """The path that a text means, which need not exist; \\ separates folders where that finds a file."""
    control = next((character for character in text if ord(character) < 32), None)
    if control is not None:
        raise InputError(
            f"{source}{name} = {text!r}: has the control character {control!r} in it, which \\ followed by a letter "
            r"makes in double quotes; write paths in single quotes, 'C:\smoke\fire.png', or with /"
        )
    path, forwards = folder / expanded(Path(text)), folder / expanded(Path(text.replace("\\", "/")))
    path = forwards if forwards.exists() and not path.exists() else path
    try:
        str(path.resolve()).encode("utf-8")
    except UnicodeEncodeError:
        raise InputError(
            f"{source}{name} = {text!r}: the path is not UTF-8, as a recipe file has to be; rename the file"
        ) from None
    return path


def _picture(name: str, entry: str, source: str, folder: Path) -> str:
    path, ships = _path(name, entry, source, folder), re.fullmatch(r"[\w-]+", entry) and STYLES / f"{entry}.png"
    # A folder of that name, such as that of a run, is no picture.
    if ships and ships.exists() and not path.is_file():
        return str(ships)
    if path.exists():
        return str(path.resolve())
    shipped = ", ".join(shipped_styles())
    raise MissingFileError(f"{source}{name} = {entry!r}: no such picture ({path}); those shipped are {shipped}")


def _camera(text: str, source: str, folder: Path) -> str:
    path, camera = _path("camera", text, source, folder), ""
    if not path.exists():
        # What exists is a file, also if it has # in its name.
        file, mark, camera = text.rpartition("#")
        path, camera = _path("camera", file if mark else text, source, folder), mark + camera if mark else ""
    if not path.is_file():
        raise MissingFileError(f"{source}camera = {text!r}: no such file ({path})")
    return f"{path.resolve()}{camera}"


def _map(entry: str, source: str, folder: Path) -> str:
    layer, _, file = entry.partition(":")
    path = _path("match", file, source, folder)
    if not path.is_file():
        raise MissingFileError(f"{source}match = {entry!r}: no such file ({path})")
    return f"{layer}:{path.resolve()}"


def _target(number: int, table: Any, source: str, folder: Path) -> dict[str, Any]:
    """The table of a target; its keys are those of a recipe, but for the weight."""
    locate, where = functools.partial(located, folder=folder), f"{source}target: number {number}: "
    return {key: value if key == "weight" else converted(key, value, where, locate) for key, value in table.items()}


def _mask(value: Any, source: str, folder: Path) -> Any:
    if isinstance(value, tuple):
        return tuple(_mask(part, source, folder) for part in value)
    if isinstance(value, str):
        return _grid_or_file(value, source, folder)
    if isinstance(value, Mapping):
        return {
            key: _mask_file(key, entry, source, folder) if key in ("file", "image") else entry
            for key, entry in value.items()
        }
    return value


def _grid_or_file(text: str, source: str, folder: Path) -> str:
    """What exists is a file, and what looks like one has to exist; all else is the name of a grid."""
    if _path("mask", text, source, folder).exists():
        return _mask_file("mask", text, source, folder)
    if Path(text).suffix.lower() in (*READABLE, *_PICTURES) or "/" in text or "\\" in text:
        return _mask_file("mask", text, source, folder)
    return text


def _mask_file(key: str, text: str, source: str, folder: Path) -> str:
    path, given = _path(key, text, source, folder), f"{source}{'mask' if key == 'mask' else f'mask: {key}'} = {text!r}"
    # The number of a pattern has no digits yet.
    exists = path.parent.is_dir() if "#" in path.name and key != "image" else path.exists()
    if not exists:
        raise MissingFileError(f"{given}: no such file ({path})")
    if key != "image" and path.suffix.lower() in _PICTURES and not path.is_dir():
        raise InputError(
            f'{given}: is a picture, expected a grid; a picture painted over a view is {{ image = "{text}", view = '
            "[0, 0] }, with azimuth and elevation of that view"
        )
    return str(path.resolve())
