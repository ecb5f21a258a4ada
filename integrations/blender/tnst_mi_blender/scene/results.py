"""Results of runs as volume objects: where the original is, with its material, in the same frames."""

from __future__ import annotations

import re
from collections.abc import Set
from contextlib import suppress
from pathlib import Path

import bpy
from mathutils import Matrix

from ..problems import CannotStylizeError
from ..recipes.plan import Part
from .extent import width
from .smoke import Smoke, domain_settings, grids_in
from .visibility import results_of, show_always

#: What the grids of a domain's noise have behind their names.
_NOISE = "_noise"


def load_result(original: bpy.types.Object, smoke: Smoke, part: Part, place: str) -> bpy.types.Object:
    """Show a result; one of an earlier run of the same part is replaced. The original stays as visible as it is.

    Args:
        original: the object whose smoke was stylized.
        smoke: of that object.
        part: the run.
        place: "IN_PLACE" or "BESIDE" the original.

    Returns:
        The volume object.

    Raises:
        CannotStylizeError: there are no results.
    """
    folder = Path(part.results) / "density"
    files = sorted(folder.glob("*.vdb"), key=lambda file: (_number(file) or 0, file.name))
    if not files:
        raise CannotStylizeError(f"{folder}: has no results; see the log beside it")
    shown = _shown(original, part.name, bpy.context.scene)
    shown.tnst_mi.shown_as = shown.name
    volume = shown.data
    volume.filepath = _as_blender_writes(files[0])
    numbers = [number for file in files if (number := _number(file)) is not None]
    volume.is_sequence = bool(smoke.numbers) and bool(numbers)
    if volume.is_sequence and smoke.playback is not None and smoke.playback.mode != "CLIP":
        playback = smoke.playback
        volume.sequence_mode, volume.frame_duration = playback.mode, playback.duration
        volume.frame_start, volume.frame_offset = playback.start, playback.offset
    elif volume.is_sequence:
        volume.sequence_mode = "CLIP"
        volume.frame_duration = numbers[-1] - numbers[0] + 1
        volume.frame_start, volume.frame_offset = numbers[0] - smoke.shift, numbers[0] - 1
    _give_materials(original, volume, set(grids_in(files[0])))
    # As a child, it goes where the original goes.
    shown.parent, shown.matrix_parent_inverse = original, Matrix()
    shown.matrix_basis = smoke.on_object
    if place == "BESIDE":
        there = original.matrix_world
        aside = Matrix.Translation((1.1 * width(there @ smoke.on_object, files), 0.0, 0.0))
        shown.matrix_basis = there.inverted() @ aside @ there @ smoke.on_object
    shown.hide_render = shown.hide_viewport = False
    return shown


def show_original_of_lost(original: bpy.types.Object) -> bool:
    """Show an original again whose result is gone: a run that replaces it has been stopped before it had another.

    Returns:
        Whether that is so. A result that is hidden, as those of other shots are, is missed by nobody.
    """
    shown = [result for result in results_of(original) if not (result.hide_render and result.hide_viewport)]
    lost = not all(Path(bpy.path.abspath(result.data.filepath)).exists() for result in shown)
    if lost:
        show_always(original)
    return lost


def _shown(original: bpy.types.Object, part: str, scene: bpy.types.Scene) -> bpy.types.Object:
    """The object that shows a part of an original: the one that is there, or a new one."""
    there = [item for item in results_of(original) if item.tnst_mi.part == part]
    if there:
        # Duplicates, which an artist has kept of an earlier one, have another name than it had.
        item = next((item for item in there if item.name == item.tnst_mi.shown_as), there[0])
        # It may be in another scene alone, or in none: its artist has taken it out.
        if scene not in item.users_scene:
            _link(item, original, scene)
        return item
    name = "_".join(filter(None, (original.name, "stylized", part)))
    if original.type == "VOLUME":
        volume = original.data.copy()
        volume.name = name
        # Slots may be linked to the object, whose materials are others.
        volume.materials.clear()
    else:
        volume = bpy.data.volumes.new(name)
    shown = bpy.data.objects.new(name, volume)
    shown.tnst_mi.original, shown.tnst_mi.part = original, part
    if original.type == "VOLUME":
        for modifier in original.modifiers:
            _copy_modifier(modifier, shown)
    _link(shown, original, scene)
    return shown


def _link(item: bpy.types.Object, original: bpy.types.Object, scene: bpy.types.Scene) -> None:
    """Put an object into the collections of its original that are in a scene, or else into the scene itself."""
    there = {scene.collection, *scene.collection.children_recursive}
    # Nothing can be added to what belongs to another file.
    own = [each for each in original.users_collection if each in there and each.library is None]
    for collection in own or [scene.collection]:
        if collection not in item.users_collection:
            collection.objects.link(item)


def _copy_modifier(modifier: bpy.types.Modifier, item: bpy.types.Object) -> None:
    """Give an object a modifier of another one."""
    copied = item.modifiers.new(modifier.name, modifier.type)
    for rna in modifier.bl_rna.properties:
        if not rna.is_readonly:
            setattr(copied, rna.identifier, getattr(modifier, rna.identifier))
    if modifier.type == "NODES":
        for key in modifier.keys():
            copied[key] = modifier[key]


def _give_materials(original: bpy.types.Object, volume: bpy.types.Volume, grids: Set[str]) -> None:
    """Give a volume the materials of the original, but for those that the artist has changed."""
    for index, slot in enumerate(original.material_slots):
        material = slot.material
        if material is not None and domain_settings(original) is not None:
            material = _for_grids(material, grids)
        if index == len(volume.materials):
            volume.materials.append(material)
        elif _is_of(volume.materials[index], slot.material):
            volume.materials[index] = material


def _is_of(given: bpy.types.Material | None, material: bpy.types.Material | None) -> bool:
    """Whether a material is another one, or its copy for the grids of noise."""
    return None not in (given, material) and given.name in (material.name, f"{material.name}{_NOISE}")


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


def _as_blender_writes(file: Path) -> str:
    """A path as Blender's own buttons write it: relative to the scene's file, if that is preferred."""
    if bpy.data.filepath and bpy.context.preferences.filepaths.use_relative_paths:
        # Not from one drive of Windows to another.
        with suppress(ValueError):
            return bpy.path.relpath(str(file))
    return str(file)


def _number(file: Path) -> int | None:
    found = re.search(r"(\d+)\D*$", file.stem)
    return int(found[1]) if found else None
