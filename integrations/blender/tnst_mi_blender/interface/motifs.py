"""The motifs that can be asked for by name, each with its thumbnail on the sheet motifs.png."""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path

#: Grey picture with the thumbnails in rows, and their names; written by scripts/build_blender_addon.py.
SHEET, NAMES = Path(__file__).with_name("motifs.png"), Path(__file__).with_name("motifs.json")


@dataclass(frozen=True)
class Motif:
    """A motif of the network `patterns`.

    Attributes:
        tag: value of the recipe's `tag`, such as "spiral".
        synonyms: other names, to search for.
        left: of its thumbnail on the sheet, in pixels from the left edge.
        top: of its thumbnail, in pixels from the upper edge.
        edge: of its thumbnail, in pixels.
    """

    tag: str
    synonyms: tuple[str, ...]
    left: int
    top: int
    edge: int


@functools.cache
def motifs() -> tuple[Motif, ...]:
    """All of them, in the order of the network's classes."""
    table = json.loads(NAMES.read_text("utf-8"))
    edge, columns = table["edge"], table["columns"]
    return tuple(
        Motif(names[0], tuple(names[1:]), number % columns * edge, number // columns * edge, edge)
        for number, names in enumerate(table["names"])
    )
