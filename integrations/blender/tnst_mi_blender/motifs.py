"""The motifs that can be asked for by name, each with its thumbnail on the sheet motifs.png."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

#: Greyscale PNG, thumbnails in rows from the top.
SHEET = Path(__file__).with_name("motifs.png")


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


def motifs() -> list[Motif]:
    """All 64, in the order of the network's classes."""
    raise NotImplementedError
