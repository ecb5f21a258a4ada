"""Recipe files: TOML, with a remedy for what editors and habits make of it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError, naming
from tnst_mi.io.bounded_toml import toml_values

_LARGEST_FILE = 1 << 19

_TYPOGRAPHIC = "“”„‟‘’‚‛«»"
_NO_TOML = {".yaml": "YAML", ".yml": "YAML", ".json": "JSON", ".ini": "INI", ".xml": "XML"}


def read_recipe_file(path: Path) -> dict[str, Any]:
    """The keys and values of a recipe file, as TOML has them.

    Raises:
        InputError: the file is too large or deep, in another encoding, or not TOML; with the remedy where it is known.
        OSError: it cannot be read.
    """
    if path.stat().st_size > _LARGEST_FILE:
        raise InputError(f"{path}: {path.stat().st_size} bytes, expected a recipe of at most 512 KiB")
    text = _decoded(path, path.read_bytes())
    try:
        with naming(path):
            return toml_values(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML ({error}){_remedy(path, text, str(error))}") from None


def _decoded(path: Path, data: bytes) -> str:
    """The text of a file in UTF-8, with or without a byte order mark."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in data[:64]:
        raise InputError(f"{path}: is UTF-16 text or no text, expected UTF-8; save it as UTF-8")
    try:
        # TOML's lines end in \n or \r\n alone.
        return data.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line, byte = data.count(b"\n", 0, error.start) + 1, data[error.start]
        raise InputError(
            f"{path}: byte 0x{byte:02x} in line {line} is not UTF-8, perhaps Windows-1252; save the file as UTF-8"
        ) from None


def _remedy(path: Path, text: str, error: str) -> str:
    """What probably is meant, as the end of a message; empty if nothing is known."""
    lines = text.splitlines()
    place = re.search(r"at line (\d+)", error)
    line = lines[int(place[1]) - 1] if place and int(place[1]) <= len(lines) else (lines[-1] if lines else "")
    if "overwrite" in error:
        return "; a key may be there once"
    if any(character in line for character in _TYPOGRAPHIC):
        return '; use straight quotes: "'
    if re.search(r'"[^"]*\\', line):
        return r"; write paths in single quotes, 'C:\smoke\fire.png', or with /"
    if path.suffix.lower() in _NO_TOML:
        return f"; it is named as {_NO_TOML[path.suffix.lower()]}: write key = value in a .toml file"
    if re.match(r"\s*[\w-]+\s*:", line):
        return "; write key = value, not key: value"
    if re.search(r"=\s*-?\d+,\d+\s*(#|$)", line):
        return "; write decimals with a point"
    return ""
