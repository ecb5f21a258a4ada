"""The looks of the beauty renders: Mitsuba scenes in `scenes/looks` that differ in how dense the smoke appears."""

from __future__ import annotations

import functools
from pathlib import Path
from xml.etree import ElementTree

from tnst_mi.errors import InputError
from tnst_mi.resources import scene_file


def look_file(look: str) -> Path:
    """The scene file of a look; raises `InputError` if the installation lacks it."""
    return scene_file(f"looks/{look}.xml")


def extinction(look: str) -> float:
    """Optical depth of smoke of density 1 along the longest edge of the grid, as the look's scene states it."""
    file = look_file(look)
    default = ElementTree.parse(file).find("default[@name='extinction']")
    if default is None:
        raise InputError(f"{file}: states no default of extinction; install the package again")
    return float(default.attrib["value"])


@functools.cache
def camera_distance() -> float:
    """How far the camera of the studio is from the centre of the grid, whose longest edge is 1, as the scene states it.

    Raises:
        InputError: the installation lacks the scene, or it does not state it.
    """
    file = scene_file("looks/studio.xml")
    place = ElementTree.parse(file).find("sensor/transform/lookat")
    if place is None:
        raise InputError(f"{file}: states no place of the camera; install the package again")
    return float(place.attrib["origin"].split(",")[2])


def gamma(look: str | float, shape: tuple[int, int, int]) -> float:
    """The same as γ, extinction per unit of density and cell, for a grid (D, H, W): 100 / 300 for "thick" and 300 rows.

    The paper's own γ, for grids of 300 rows, ranges from 0.01 to 1: the same smoke from a veil to a solid body.

    Args:
        look: one of `tnst_mi.choices.LOOKS`, or such an optical depth.
        shape: of the grid.
    """
    return (extinction(look) if isinstance(look, str) else look) / max(shape)
