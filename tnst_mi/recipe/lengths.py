"""Lengths in a recipe: cells, or shares of the grid's height, which mean the same on any grid."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

#: The word for a length that is not wanted.
OFF = "off"


@dataclass(frozen=True)
class Length:
    """A number of cells above 0, a share of the height such as "5%", or "off"."""

    placeholder: str = "PERCENT%|CELLS|off"
    expected: str = "a share of the height such as 5% (up to 100%), a number of cells above 0, or off"

    def check(self, value: Any) -> str | float:
        """Accept numbers above 0, shares above 0% up to 100%, and the word."""
        if isinstance(value, str):
            if value == OFF or (re.fullmatch(r"\d{1,9}(\.\d{1,9})?%", value) and 0 < float(value[:-1]) <= 100):
                return value
            raise ValueError
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
            raise ValueError
        return float(value)

    def read(self, text: str) -> str | float:
        """Read a decimal number; leave shares and the word as they are."""
        return text if text == OFF or text.endswith("%") else float(text)

    def show(self, value: str | float) -> str:
        """Write the number, the share or the word."""
        return value if isinstance(value, str) else f"{value:g}"


def in_cells(length: str | float, rows: int) -> float | None:
    """A checked length in cells of a grid with so many rows; None for "off".

    Example:
        >>> in_cells("5%", 200), in_cells(8.0, 200), in_cells("off", 200)
        (10.0, 8.0, None)
    """
    if not isinstance(length, str):
        return float(length)
    return None if length == OFF else float(length[:-1]) / 100 * rows
