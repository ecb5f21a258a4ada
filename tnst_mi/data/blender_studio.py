"""The studio of `scenes/looks` in Blender: renders one VDB file with Cycles. Blender runs this file, and nothing else.

    blender --background --factory-startup --python blender_studio.py -- SETTINGS.json

The settings, made by `tnst_mi.rendering.blender`, are in world units with z up: the longest edge of the grid is 1 and
its centre is the origin. The smoke is turned on the spot instead of camera and lights, which shows the same. The
picture is an EXR of linear radiance, rendered once with each of the given numbers of samples; its seconds are printed.
"""

from __future__ import annotations

import json
import math
import sys
import time
from typing import Any

import bpy  # pyright: ignore[reportMissingImports]
from mathutils import Vector  # pyright: ignore[reportMissingImports]


def linked(name: str, data: bpy.types.ID) -> bpy.types.Object:
    """A new object in the scene."""
    made = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(made)
    return made


def nodes_of(material: bpy.types.Material) -> tuple[bpy.types.NodeTree, bpy.types.Node]:
    """The node tree of a new material, emptied but for its output, and that."""
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    return tree, tree.nodes.new("ShaderNodeOutputMaterial")


def smoke_material(extinction: float, albedo: float) -> bpy.types.Material:
    """Scatters and absorbs by the grid density, and shines with the grid emission_color, where there is one.

    A grid Cd, where there is one, multiplies the albedo.
    """
    material = bpy.data.materials.new("smoke")
    tree, output = nodes_of(material)
    density, colour = (tree.nodes.new("ShaderNodeAttribute") for _ in range(2))
    density.attribute_name, colour.attribute_name = "density", "emission_color"
    scaled = tree.nodes.new("ShaderNodeMath")
    scaled.operation = "MULTIPLY"
    scaled.inputs[1].default_value = extinction
    shader = tree.nodes.new("ShaderNodeVolumePrincipled")
    shader.inputs["Density Attribute"].default_value = ""
    shader.inputs["Color"].default_value = (albedo, albedo, albedo, 1.0)
    shader.inputs["Color Attribute"].default_value = "Cd"
    shader.inputs["Emission Strength"].default_value = 1.0
    tree.links.new(density.outputs["Fac"], scaled.inputs[0])
    tree.links.new(scaled.outputs[0], shader.inputs["Density"])
    tree.links.new(colour.outputs["Color"], shader.inputs["Emission Color"])
    tree.links.new(shader.outputs["Volume"], output.inputs["Volume"])
    return material


def plane(name: str, half_width: float, half_height: float) -> bpy.types.Object:
    """A rectangle around the origin, facing +z."""
    mesh = bpy.data.meshes.new(name)
    corners = [(x * half_width, y * half_height, 0.0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    return linked(name, mesh)


def add_lamp(lamp: dict[str, Any]) -> None:
    """A rectangle that shines from its front, towards the origin."""
    shown = plane("lamp", *lamp["scale"])
    shown.location = lamp["origin"]
    shown.rotation_euler = (-Vector(lamp["origin"])).to_track_quat("Z", "Y").to_euler()
    material = bpy.data.materials.new("lamp")
    tree, output = nodes_of(material)
    geometry, front = tree.nodes.new("ShaderNodeNewGeometry"), tree.nodes.new("ShaderNodeMath")
    front.operation = "SUBTRACT"
    front.inputs[0].default_value = 1.0
    light = tree.nodes.new("ShaderNodeEmission")
    light.inputs["Color"].default_value = (*lamp["radiance"], 1.0)
    tree.links.new(geometry.outputs["Backfacing"], front.inputs[1])
    tree.links.new(front.outputs[0], light.inputs["Strength"])
    tree.links.new(light.outputs[0], output.inputs["Surface"])
    shown.data.materials.append(material)


def add_ground(height: float, reflectance: list[float]) -> None:
    """A floor that scatters light evenly."""
    floor = plane("ground", 200.0, 200.0)
    floor.location.z = height
    material = bpy.data.materials.new("ground")
    tree, output = nodes_of(material)
    shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (*reflectance, 1.0)
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    floor.data.materials.append(material)


def add_sky(file: str) -> None:
    """An environment picture around all."""
    world = bpy.context.scene.world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    picture = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    picture.image = bpy.data.images.load(file)
    world.node_tree.links.new(picture.outputs["Color"], world.node_tree.nodes["Background"].inputs["Color"])


def add_smoke(settings: dict[str, Any]) -> None:
    """The volume, turned about the vertical."""
    volume = bpy.data.volumes.new("smoke")
    volume.filepath = settings["volume"]
    if not volume.grids.load():
        raise RuntimeError(volume.grids.error_message or "no volume")
    shown = linked("smoke", volume)
    shown.rotation_euler.z = -math.radians(settings["azimuth"])
    volume.materials.append(smoke_material(settings["extinction"], settings["albedo"]))


def add_camera(settings: dict[str, Any]) -> None:
    """A perspective camera that looks at the origin from above or below."""
    camera = linked("camera", bpy.data.cameras.new("camera"))
    elevation, distance = math.radians(settings["elevation"]), settings["distance"]
    camera.location = (0.0, -distance * math.cos(elevation), distance * math.sin(elevation))
    camera.rotation_euler = (math.pi / 2 - elevation, 0.0, 0.0)
    camera.data.sensor_fit = "HORIZONTAL"
    camera.data.angle = math.radians(settings["field_of_view"])
    bpy.context.scene.camera = camera


def render(settings: dict[str, Any], samples: int) -> float:
    """Render the picture; returns the seconds that it takes."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = samples
    scene.cycles.seed = settings["seed"]
    # Debian builds Blender without the denoiser; the other two change the mean of what is sampled.
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.cycles.sample_clamp_indirect = 0.0
    scene.cycles.max_bounces = scene.cycles.volume_bounces = settings["bounces"]
    scene.cycles.filter_width = 1.0
    scene.cycles.pixel_filter_type = "BOX"
    scene.render.resolution_x, scene.render.resolution_y = settings["size"]
    scene.render.resolution_percentage = 100
    scene.render.filepath = settings["out"]
    image = scene.render.image_settings
    image.file_format, image.color_mode, image.color_depth, image.exr_codec = "OPEN_EXR", "RGB", "32", "ZIP"
    start = time.perf_counter()
    bpy.ops.render.render(write_still=True)
    return time.perf_counter() - start


def main() -> None:
    """Build the scene that the settings describe, and render it."""
    with open(sys.argv[sys.argv.index("--") + 1], encoding="utf-8") as file:
        settings = json.load(file)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    add_smoke(settings)
    for lamp in settings["lamps"]:
        add_lamp(lamp)
    add_ground(settings["floor"], settings["reflectance"])
    add_sky(settings["sky"])
    add_camera(settings)
    for samples in settings["samples"]:
        print(f"seconds {render(settings, samples):.6f}")


if __name__ == "__main__":
    try:
        main()
    except Exception as error:
        print(f"{type(error).__name__}: {error}")
        sys.exit(1)
    # Blender goes on after a script, unless that ends it.
    sys.exit(0)
