"""How far smoke reaches, in its files and in the scene."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import bpy
from mathutils import Matrix, Vector

from .smoke import Smoke, domain_settings


def corners_at(item: bpy.types.Object, smoke: Smoke, number: int | None) -> list[Vector]:
    """The corners of a box around smoke in the space of its files: of a domain all of it, of a volume what is filled.

    Args:
        item: a volume or a domain.
        smoke: of it.
        number: of the file's frame; None for smoke of one file.

    Returns:
        Eight of them, or none where a file is empty.
    """
    if domain_settings(item) is not None:
        to_files = smoke.cells.inverted()
        sides = [sorted(vertex.co[axis] for vertex in item.data.vertices) for axis in range(3)]
        return [to_files @ Vector(each) for each in itertools.product(*((side[0], side[-1]) for side in sides))]
    file = smoke.source
    if number is not None:
        file = file.with_name(re.sub("#+", lambda places: f"{number:0{len(places[0])}}", file.name))
    return next(_boxes([file]), [])


def width(space: Matrix, files: Sequence[Path]) -> float:
    """The extent of what files have together along x, in the space that a matrix leads to; 0 if they are empty.

    Volumes of the scene have that of the current frame alone, where there may be no smoke.
    """
    along = [(space @ corner).x for corners in _boxes(files) for corner in corners]
    return max(along) - min(along) if along else 0.0


def _boxes(files: Sequence[Path]) -> Iterator[list[Vector]]:
    """The corners of what each file has, less those that have nothing."""
    data = bpy.data.volumes.new("tnst_mi extent")
    item = bpy.data.objects.new(data.name, data)
    try:
        for file in files:
            data.filepath = str(file)
            if data.grids.load():
                yield [Vector(corner) for corner in item.bound_box]
            data.grids.unload()
    finally:
        bpy.data.volumes.remove(data)
