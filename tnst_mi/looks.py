"""The looks of the beauty renders: Mitsuba scenes in `scenes/looks` that differ in how dense the smoke appears."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from tnst_mi.errors import InputError

LOOKS = ("thin", "medium", "thick")


def look_file(look: str) -> Path:
    """The scene of a look, in the installed package or in the checkout.

    Raises:
        InputError: the installation lacks it.
    """
    package = Path(__file__).resolve().parent
    for scenes in (package / "scenes", package.parent / "scenes"):
        if (scenes / "looks" / f"{look}.xml").is_file():
            return scenes / "looks" / f"{look}.xml"
    raise InputError(f"{package / 'scenes/looks' / look}.xml: the look is missing; install the package again")


def extinction(look: str) -> float:
    """Optical thickness of smoke of density 1 along the longest edge of the grid, which the look's scene states."""
    default = ElementTree.parse(look_file(look)).find("default[@name='extinction']")
    return float(default.get("value"))


def gamma(look: str, shape: tuple[int, int, int]) -> float:
    """The same as γ, extinction per unit of density and cell, for a grid (D, H, W): 100 / 300 for "thick" and 300 rows.

    The paper's own γ, for grids of 300 rows, are 0.01 to 1: the same smoke from a veil to a solid body.
    """
    return extinction(look) / max(shape)
