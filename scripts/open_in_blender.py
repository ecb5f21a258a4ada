"""Open VDB files in Blender and say what it finds in them.

    python scripts/open_in_blender.py PATH… [--render OUT.png]

A PATH is a VDB file or a folder of them. For every file: the box in the world, Z up, that its grids fill; the box
around the surface that Blender makes of the smoke; its grids, their types and the transforms from cells to the world.
Ends with exit code 1 if Blender cannot read one of them. With --render, the first file of every path is drawn, seen
from the front (along +Y), side by side and at the same scale, each in the box that all of them fill together: smoke
that has moved, turned or grown between two folders shows at once. A grid Cd (or color, colour) of three components
colours it.

Lit smoke and fire as they will be seen are what `tnst-mi show --blender` draws; this draws where it is.

Runs in Blender, which it starts (`apt-get install blender`, or --blender PROGRAM), or with the Python package bpy.
"""

from __future__ import annotations

import argparse
import functools
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

try:
    import bpy
except ImportError:
    # Outside of Blender, whose Python does not have this package.
    from tnst_mi.machine.blender import run_in_blender

    bpy = None

#: Height of the picture in pixels.
HEIGHT = 384
#: Smoke is what is denser than this, for its surface.
SURFACE = 0.05
#: Density of the picture's smoke, per metre, where the grid says 1.
EXTINCTION = 12.0
SAMPLES = 16
#: The grid of the smoke, the first of these that there is: the second is what the noise of a cache calls it.
DENSITIES = ("density", "density_noise")
#: The grid of the fire, likewise; it shines where there is one.
FLAMES = ("flame", "flame_noise")
#: The grid of the smoke's colours, likewise.
COLOURS = ("Cd", "color", "colour")
#: What the fire sends out, where it says 1.
BRIGHTNESS = 2.0

Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def refuse(message: str) -> NoReturn:
    """End with a line that says what cannot be used, and exit code 2."""
    print(f"open_in_blender.py: {message}", file=sys.stderr)
    raise SystemExit(2)


def vdb_files(path: Path) -> list[Path]:
    """The VDB files that a path stands for; it is an error that there are none."""
    files = sorted(path.glob("*.vdb")) if path.is_dir() else [path]
    if not files or not all(file.is_file() for file in files):
        refuse(f"{path}: no VDB file here, expected one or a folder of them")
    return files


def united(boxes: Sequence[Box]) -> Box:
    """The smallest box around boxes."""
    lows, highs = zip(*boxes, strict=True)
    return tuple(map(min, zip(*lows, strict=True))), tuple(map(max, zip(*highs, strict=True)))


def opened(file: Path) -> bpy.types.Object:
    """Load every grid of a file as a volume in the scene.

    Raises:
        RuntimeError: Blender cannot read it, or it has no grids.
    """
    volume = bpy.data.volumes.new(file.stem)
    volume.filepath = str(file.resolve())
    if not volume.grids.load():
        raise RuntimeError(volume.grids.error_message or "no volume")
    if not len(volume.grids):
        raise RuntimeError("no grids")
    for grid in volume.grids:
        if not grid.load():
            raise RuntimeError(f"grid {grid.name}: {volume.grids.error_message or 'cannot be loaded'}")
    shown = bpy.data.objects.new(file.stem, volume)
    bpy.context.scene.collection.objects.link(shown)
    bpy.context.view_layer.update()
    return shown


def grid_of(volume: bpy.types.Object, names: Sequence[str]) -> str | None:
    """The first of some names that a grid of a volume has; None if there is none."""
    return next((name for name in names if name in volume.data.grids), None)


def box_of(volume: bpy.types.Object) -> Box:
    """The box that the active cells of a volume fill, in the world."""
    corners = [tuple(volume.matrix_world @ type(volume.location)(corner)) for corner in volume.bound_box]
    return united([(corner, corner) for corner in corners])


def smoke_box(volume: bpy.types.Object) -> Box | None:
    """The box around the smoke of a volume, in the world; None if there is none."""
    density = grid_of(volume, DENSITIES)
    if density is None:
        return None
    surface = bpy.data.objects.new("surface", bpy.data.meshes.new("surface"))
    modifier = surface.modifiers.new("surface", "VOLUME_TO_MESH")
    modifier.object, modifier.grid_name, modifier.threshold = volume, density, SURFACE
    bpy.context.scene.collection.objects.link(surface)
    evaluated = surface.evaluated_get(bpy.context.evaluated_depsgraph_get())
    points = [tuple(vertex.co) for vertex in evaluated.to_mesh().vertices]
    bpy.data.objects.remove(surface)
    return united([(point, point) for point in points]) if points else None


def describe(file: Path, volume: bpy.types.Object) -> None:
    """Print what is in a file."""
    low, high = box_of(volume)
    print(f"{file}: fills {spelled(low)} to {spelled(high)}")
    smoke = smoke_box(volume)
    print(f"  smoke {'nowhere' if smoke is None else f'from {spelled(smoke[0])} to {spelled(smoke[1])}'}")
    for grid in volume.data.grids:
        matrix = grid.matrix_object
        cell = spelled(matrix.to_scale())
        print(f"  {grid.name}: {grid.data_type.lower()}, cell {cell}, cell 0 at {spelled(matrix.to_translation())}")


def spelled(numbers: Sequence[float]) -> str:
    """Coordinates for reading."""
    return "(" + ", ".join(f"{number:.4g}" for number in numbers) + ")"


def smoke_material(density: str, flame: str | None, colour: str | None) -> bpy.types.Material:
    """A scattering volume; the names are those of the grids of its density, its own light and its colour."""
    material = bpy.data.materials.new("smoke")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    output = nodes.new("ShaderNodeOutputMaterial")
    shader = nodes.new("ShaderNodeVolumePrincipled")
    grid = nodes.new("ShaderNodeAttribute")
    grid.attribute_name = density
    scaled = nodes.new("ShaderNodeMath")
    scaled.operation = "MULTIPLY"
    scaled.inputs[1].default_value = EXTINCTION
    links.new(grid.outputs["Fac"], scaled.inputs[0])
    links.new(scaled.outputs[0], shader.inputs["Density"])
    shader.inputs["Density Attribute"].default_value = ""
    shader.inputs["Color"].default_value = (0.9, 0.9, 0.9, 1.0)
    shader.inputs["Color Attribute"].default_value = colour or ""
    if flame is not None:
        fire = nodes.new("ShaderNodeAttribute")
        fire.attribute_name = flame
        bright = nodes.new("ShaderNodeMath")
        bright.operation = "MULTIPLY"
        bright.inputs[1].default_value = BRIGHTNESS
        links.new(fire.outputs["Fac"], bright.inputs[0])
        links.new(bright.outputs[0], shader.inputs["Emission Strength"])
        shader.inputs["Emission Color"].default_value = (1.0, 0.35, 0.05, 1.0)
    links.new(shader.outputs["Volume"], output.inputs["Volume"])
    return material


def add_frame(low: Sequence[float], high: Sequence[float]) -> None:
    """Draw the edges of a box."""
    centre = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
    bpy.ops.mesh.primitive_cube_add(size=1, location=centre)
    cube = bpy.context.object
    cube.scale = [b - a for a, b in zip(low, high, strict=True)]
    bpy.ops.object.transform_apply(location=False, rotation=False, scale=True)
    wires = cube.modifiers.new("edges", "WIREFRAME")
    wires.thickness = 0.004 * max(cube.dimensions)
    material = bpy.data.materials.new("edges")
    material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (1.0, 0.35, 0.05, 1.0)
    cube.data.materials.append(material)
    cube.visible_shadow = False


def render(volumes: Sequence[bpy.types.Object], out: Path) -> None:
    """Draw volumes side by side, each in the box around all of them."""
    low, high = united([box_of(volume) for volume in volumes])
    width, height = 1.15 * (high[0] - low[0]), 1.1 * (high[2] - low[2])
    for index, volume in enumerate(volumes):
        smoke = grid_of(volume, DENSITIES) or DENSITIES[0]
        flame, colour = (grid_of(volume, names) for names in (FLAMES, COLOURS))
        volume.data.materials.append(smoke_material(smoke, flame, colour))
        volume.location.x += index * width
        add_frame((low[0] + index * width, *low[1:]), (high[0] + index * width, *high[1:]))
    scene = bpy.context.scene
    row = len(volumes) * width
    middle = [(low[0] + high[0]) / 2 + (row - width) / 2, low[1] - 2.0 * height, (low[2] + high[2]) / 2]
    camera = bpy.data.cameras.new("front")
    camera.type = "ORTHO"
    camera.ortho_scale = max(row, height)
    camera.clip_end = 10.0 * height
    scene.camera = bpy.data.objects.new("front", camera)
    scene.camera.location = middle
    scene.camera.rotation_euler = (1.5707963, 0.0, 0.0)
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy = 4.0
    sun.rotation_euler = (0.6, 0.3, 0.0)
    for thing in (scene.camera, sun):
        scene.collection.objects.link(thing)
    scene.world = bpy.data.worlds.new("sky")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.05, 0.06, 0.08, 1.0)
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = SAMPLES
    # Debian builds Blender without the denoiser.
    scene.cycles.use_denoising = False
    scene.cycles.volume_bounces = 1
    scene.render.resolution_x, scene.render.resolution_y = round(HEIGHT * row / height), HEIGHT
    scene.render.resolution_percentage = 100
    scene.render.filepath = str(out.resolve())
    scene.render.image_settings.file_format = "PNG"
    bpy.ops.render.render(write_still=True)


def inside_blender(paths: Sequence[Path], picture: Path | None) -> int:
    """Open all files, and return the exit code."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    failed = False
    first = []
    for path in paths:
        for index, file in enumerate(vdb_files(path)):
            try:
                volume = opened(file)
            except RuntimeError as error:
                print(f"{file}: cannot be opened: {error}")
                failed = True
                continue
            describe(file, volume)
            if index == 0:
                first.append(volume)
            else:
                bpy.data.volumes.remove(volume.data)
    if picture and first and not failed:
        render(first, picture)
    return int(failed)


def main() -> int:
    """Read the arguments, those after `--` in Blender, and open the files here or in Blender."""
    parser = argparse.ArgumentParser(
        prog="open_in_blender.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH", help="VDB file, or folder of them")
    parser.add_argument("--render", type=Path, metavar="OUT.png", help="draw the first file of each path")
    parser.add_argument("--blender", default="blender", help="the program (default: the one on the path)")
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    given = parser.parse_args(arguments)
    if bpy is not None:
        return inside_blender(given.paths, given.render)
    for path in given.paths:
        vdb_files(path)
    if shutil.which(given.blender) is None:
        refuse(f"no program {given.blender}: install Blender (apt-get install blender), or name it with --blender")
    code = run_in_blender(Path(__file__).resolve(), arguments, functools.partial(print, flush=True), given.blender)
    # A file that is cut short can bring Blender down.
    return 1 if code else 0


if __name__ == "__main__":
    # Blender goes on after a script, unless that ends it.
    sys.exit(main())
