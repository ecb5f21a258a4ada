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
    for file in files:
        # Blender keeps the bounds of an object, also where its volume has another file.
        data = bpy.data.volumes.new("tnst_mi extent")
        item = bpy.data.objects.new(data.name, data)
        try:
            data.filepath = str(file)
            if data.grids.load() and not _is_empty(item):
                yield [Vector(corner) for corner in item.bound_box]
        finally:
            bpy.data.volumes.remove(data)


def _is_empty(volume: bpy.types.Object) -> bool:
    """Whether a volume has nothing: Blender gives it the bounds of a cube around the origin, which others may have."""
    sizes = {abs(place) for corner in volume.bound_box for place in corner}
    if sizes not in ({0.0}, {1.0}):
        return False
    mesh = bpy.data.meshes.new("tnst_mi extent")
    surface = bpy.data.objects.new(mesh.name, mesh)
    try:
        for item in (volume, surface):
            bpy.context.scene.collection.objects.link(item)
        modifier = surface.modifiers.new("Volume to Mesh", "VOLUME_TO_MESH")
        modifier.object, modifier.threshold = volume, 1e-6
        return not surface.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.vertices
    finally:
        bpy.data.meshes.remove(mesh)
