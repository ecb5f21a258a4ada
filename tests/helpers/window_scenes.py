"""Runs inside Blender without a window: switches the add-on on, and writes the scenes that window_walks.py opens.

    blender --background --python window_scenes.py -- SMOKE OUT

SMOKE is a folder with smoke_0007.vdb to smoke_0009.vdb. In the folder OUT: scene.blend, with an object of each kind of
which Smoke is active and ready to be stylized, library.blend, of which it links a volume, and other.blend.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy


def volume(name: str, smoke: Path) -> bpy.types.Object:
    """A volume that shows the smoke in the frames 7 to 9."""
    data = bpy.data.volumes.new(name)
    data.filepath = str(smoke / "smoke_0007.vdb")
    data.is_sequence, data.frame_start, data.frame_offset, data.frame_duration = True, 7, 6, 3
    item = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(item)
    return item


def main(smoke: Path, out: Path) -> None:
    """Save the preferences, and the scenes."""
    for view in (area.spaces.active for screen in bpy.data.screens for area in screen.areas if area.type == "VIEW_3D"):
        view.shading.type, view.overlay.show_overlays = "WIREFRAME", False  # soon drawn without a graphics card
    bpy.ops.preferences.addon_enable(module="tnst_mi_blender")
    bpy.ops.wm.save_userpref()
    bpy.ops.wm.save_as_mainfile(filepath=str(out / "other.blend"))
    volume("Linked", smoke)
    bpy.ops.wm.save_as_mainfile(filepath=str(out / "library.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(out / "other.blend"))
    with bpy.data.libraries.load(str(out / "library.blend"), link=True) as (_there, here):
        here.objects = ["Linked"]
    scene = bpy.context.scene
    scene.collection.objects.link(bpy.data.objects["Linked"])
    bpy.ops.object.empty_add(location=(4, 0, 0))
    bpy.ops.mesh.primitive_cube_add(location=(0, 4, 0))
    domain = bpy.context.object
    domain.name = "Domain"
    modifier = domain.modifiers.new("Fluid", "FLUID")
    modifier.fluid_type = "DOMAIN"
    modifier.domain_settings.domain_type = "GAS"
    item = volume("Smoke", smoke)
    settings = item.tnst_mi
    settings.looks.add()
    settings.use_camera = False
    bpy.ops.object.select_all(action="DESELECT")
    item.select_set(True)
    bpy.context.view_layer.objects.active = item
    scene.frame_set(7)
    bpy.ops.wm.save_as_mainfile(filepath=str(out / "scene.blend"))


main(*map(Path, sys.argv[sys.argv.index("--") + 1 :]))
