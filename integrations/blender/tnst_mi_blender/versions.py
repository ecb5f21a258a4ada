"""What is not the same in all versions of Blender from 3.4 to 5.0."""

from __future__ import annotations

import bpy

#: The add-on's name in this Blender: as an extension, it is in the package of a repository.
ADDON = __package__

#: How far from the place of a voxel Blender draws its middle, in voxels along each axis. OpenVDB has the middle there.
#: Measured with 3.4 and 5.0.
DRAWN_OFF = 0.5 if bpy.app.version < (5, 0, 0) else 0.0

#: Options of properties that hold paths, which may begin with `//`: from 5.0 on, Blender warns of others that do.
PATH = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5, 0) else set[str]()


def fill(modifier: bpy.types.MeshToVolumeModifier, edge: float) -> None:
    """Let a modifier Mesh to Volume fill its mesh with 1, reached at a depth of `edge` where Blender can do it.

    Before 4.0 it is filled with 1 up to the surface.
    """
    if hasattr(modifier, "use_fill_volume"):
        modifier.use_fill_volume, modifier.exterior_band_width = True, 0.0
    else:
        modifier.interior_band_width = max(edge, 1e-6)


def animated_paths(item: bpy.types.ID) -> set[str]:
    """What keyframes change of an object, of its action and of its strips; before 4.4, actions have no slots."""
    animation = item.animation_data
    if animation is None:
        return set()
    strips = [strip for track in animation.nla_tracks for strip in track.strips]
    holders = [holder for holder in (animation, *strips) if holder.action is not None]
    return {curve.data_path for holder in holders for curve in _curves(holder)}


def _curves(holder: bpy.types.AnimData | bpy.types.NlaStrip) -> list[bpy.types.FCurve]:
    action = holder.action
    if not hasattr(action, "layers"):
        return list(action.fcurves)
    bags = [strip.channelbag(holder.action_slot) for layer in action.layers for strip in layer.strips]
    return [curve for bag in bags if bag is not None for curve in bag.fcurves]


def show_progress(layout: bpy.types.UILayout, fraction: float | None, text: str) -> None:
    """A bar and a text; before 4.0 there are no bars, and the text has two lines, which narrow panels have room for."""
    if hasattr(layout, "progress"):
        layout.progress(factor=fraction or 0.0, text=text)
        return
    parts = text.split(", ")
    half = (len(parts) + 1) // 2
    for number, line in enumerate(filter(None, (", ".join(parts[:half]), ", ".join(parts[half:])))):
        layout.label(text=line, icon="TIME" if number == 0 else "BLANK1")
