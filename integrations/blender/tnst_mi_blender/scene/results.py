"""Results of runs as volume objects: where the original is, with its material, in the same frames."""

from __future__ import annotations

import re
from collections.abc import Iterator, Set
from pathlib import Path

import bpy
from mathutils import Matrix, Vector

from ..problems import CannotStylizeError
from ..recipes.plan import Part
from .smoke import Smoke, domain_settings, grids_in

#: What the grids of a domain's noise have behind their names.
_NOISE = "_noise"


def load_result(original: bpy.types.Object, smoke: Smoke, part: Part, place: str) -> bpy.types.Object:
    """Show a result; one of an earlier run of the same part is replaced.

    Args:
        original: the object whose smoke was stylized.
        smoke: of that object.
        part: the run.
        place: "IN_PLACE", with the original hidden, or "BESIDE".

    Returns:
        The volume object.

    Raises:
        CannotStylizeError: there are no results.
    """
    folder = Path(part.results) / "density"
    files = sorted(folder.glob("*.vdb"), key=lambda file: (_number(file) or 0, file.name))
    if not files:
        raise CannotStylizeError(f"{folder}: has no results; see the log beside it")
    shown = _shown(original, part.name)
    volume = shown.data
    volume.filepath = str(files[0])
    numbers = [number for file in files if (number := _number(file)) is not None]
    volume.is_sequence = bool(smoke.numbers) and bool(numbers)
    if volume.is_sequence:
        volume.frame_duration = numbers[-1] - numbers[0] + 1
        volume.frame_start, volume.frame_offset = numbers[0] - smoke.shift, numbers[0] - 1
    _give_materials(original, volume, set(grids_in(files[0])))
    # As a child, it goes where the original goes.
    shown.parent, shown.matrix_parent_inverse = original, Matrix()
    inverse = original.matrix_world.inverted()
    aside = Matrix.Translation((_width(original), 0.0, 0.0)) if place == "BESIDE" else Matrix()
    shown.matrix_basis = inverse @ aside @ smoke.volume_space
    for item in original, shown:
        item.hide_render = item.hide_viewport = place == "IN_PLACE" and item is original
    return shown


def results_of(original: bpy.types.Object) -> Iterator[bpy.types.Object]:
    """The results of an object that are shown."""
    return (item for item in bpy.data.objects if item.type == "VOLUME" and item.tnst_mi.original == original)


def _shown(original: bpy.types.Object, part: str) -> bpy.types.Object:
    """The object that shows a part of an original: the one that is there, or a new one."""
    for item in results_of(original):
        if item.tnst_mi.part == part:
            return item
    name = "_".join(filter(None, (original.name, "stylized", part)))
    if original.type == "VOLUME":
        volume = original.data.copy()
        volume.name = name
    else:
        volume = bpy.data.volumes.new(name)
    shown = bpy.data.objects.new(name, volume)
    shown.tnst_mi.original, shown.tnst_mi.part = original, part
    for collection in original.users_collection:
        collection.objects.link(shown)
    return shown


def _give_materials(original: bpy.types.Object, volume: bpy.types.Volume, grids: Set[str]) -> None:
    """Give a volume the materials of the original, unless it has some, which the artist may have changed."""
    if len(volume.materials):
        return
    for slot in original.material_slots:
        material = slot.material
        if material is not None and domain_settings(original) is not None:
            material = _for_grids(material, grids)
        volume.materials.append(material)


def _for_grids(material: bpy.types.Material, grids: Set[str]) -> bpy.types.Material:
    """A material that reads the grids that there are: those of a domain with noise have names of their own.

    Domains hide that: there, "density" is the finer one.
    """
    finer = {name.removesuffix(_NOISE) for name in grids if name.endswith(_NOISE)}
    if material.node_tree is None or not finer:
        return material
    name = f"{material.name}{_NOISE}"
    if name in bpy.data.materials:
        return bpy.data.materials[name]
    material = material.copy()
    material.name = name
    for node in material.node_tree.nodes:
        if node.type == "ATTRIBUTE" and node.attribute_name in finer:
            node.attribute_name += _NOISE
        for socket in node.inputs if node.type == "PRINCIPLED_VOLUME" else ():
            if socket.type == "STRING" and socket.default_value in finer:
                socket.default_value += _NOISE
    return material


def _width(item: bpy.types.Object) -> float:
    """The extent of an object in the world, along x, and a little more."""
    along = [(item.matrix_world @ Vector(corner)).x for corner in item.bound_box]
    return 1.1 * (max(along) - min(along))


def _number(file: Path) -> int | None:
    found = re.search(r"(\d+)\D*$", file.stem)
    return int(found[1]) if found else None
