"""Bake a smoke simulation with Blender's Mantaflow. Runs inside Blender, on which nothing of ours is installed:

    blender -b --factory-startup -P scripts/blender_bake.py -- smokejet CACHE --resolution 96 --frames 60

`scripts/simulate.py` is the way to frames that the package reads; this script leaves what Blender caches, `.uni` files
or (`--format OPENVDB`) a sequence of VDBs, in CACHE/data. The domain is 3 m high and 2 m wide and deep, Z up.

For who runs it as a program, lines on stdout that begin with `bake:` tell what happens: `bake: scene JSON` once, then
`bake: frame N` for every frame that is in the cache whole, or `bake: refused REASON` with exit code 2.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

try:
    import bpy
except ImportError:
    print("blender_bake.py: runs inside Blender: blender -b -P scripts/blender_bake.py -- --help", file=sys.stderr)
    raise SystemExit(2) from None

# Of the domain in metres; X, Y, Z.
SIZE = (2.0, 2.0, 3.0)
FRAMES_PER_SECOND = 25
# The density of the jet's source is a noise that drifts so far over so many frames, easing in and out, again and again.
NOISE_FRAMES = 84
NOISE_DRIFT = 8.4


@dataclass(frozen=True)
class Fluid:
    """What sets one simulation apart from another.

    Attributes:
        buoyancy_density: lift per density (Blender's alpha).
        buoyancy_heat: lift per temperature (Blender's beta).
        vorticity: strength of the vorticity confinement.
        inflow_speed: velocity of the inflow along X, in m/s.
        inflow_random: amount of noise on that velocity.
    """

    buoyancy_density: float
    buoyancy_heat: float
    vorticity: float
    inflow_speed: float = 0.0
    inflow_random: float = 0.0


@dataclass(frozen=True)
class Domain:
    """What sets the domain of one simulation apart from another; by default it is a box along the scene's axes.

    Attributes:
        adaptive: whether it is only as large as the smoke needs, frame by frame (Blender's Adaptive Domain).
        upres_factor: how many times finer the noise is that is added to the smoke; 1 for none.
        turn_degrees: angle of the domain object around Z.
    """

    adaptive: bool = False
    upres_factor: int = 1
    turn_degrees: float = 0.0


@dataclass(frozen=True)
class Scene:
    """A simulation: its fluid, what builds its objects, given the arguments, what these are, and its domain."""

    fluid: Fluid
    build: Callable[[Fluid, argparse.Namespace], None]
    description: str
    domain: Domain = Domain()


class RefusedError(Exception):
    """The user gave something that cannot be simulated."""


def tell(what: str) -> None:
    """Write a line for the program that runs this script; where that has gone, go too."""
    try:
        print(f"bake: {what}", flush=True)
    except BrokenPipeError:
        os._exit(1)


def sphere(name: str, radius: float, centre: tuple[float, float, float]) -> bpy.types.Object:
    """Add a sphere to the scene."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=5 if radius > 0.2 else 4, radius=radius, location=centre)
    bpy.context.object.name = name
    return bpy.context.object


def emit_smoke(source: bpy.types.Object, behaviour: str, distance: float) -> bpy.types.FluidFlowSettings:
    """Make an object a source of smoke of density 1, out to a distance of so many cells around its surface."""
    modifier = source.modifiers.new("Fluid", "FLUID")
    modifier.fluid_type = "FLOW"
    flow = modifier.flow_settings
    flow.flow_type = "SMOKE"
    flow.flow_behavior = behaviour
    flow.density = flow.temperature = flow.volume_density = 1.0
    flow.surface_distance = distance
    return flow


def vary_density(flow: bpy.types.FluidFlowSettings) -> None:
    """Multiply the density of a source by drifting noise, which breaks its symmetry."""
    noise = bpy.data.textures.new("noise", "CLOUDS")
    noise.noise_scale, noise.noise_depth, noise.contrast, noise.intensity = 0.1, 2, 1.5, 1.1
    flow.use_texture = True
    flow.noise_texture = noise
    flow.texture_map_type = "AUTO"
    flow.texture_size = 1.0
    for frame, offset in ((1, 0.0), (NOISE_FRAMES, NOISE_DRIFT)):
        flow.texture_offset = offset
        flow.keyframe_insert("texture_offset", frame=frame)
    curve = flow.id_data.animation_data.action.fcurves[0]
    cycles = curve.modifiers.new("CYCLES")
    cycles.mode_before, cycles.mode_after = "NONE", "REPEAT_OFFSET"


def jet(fluid: Fluid, arguments: argparse.Namespace) -> None:
    """A jet from a small sphere near the wall at X = 0."""
    flow = emit_smoke(sphere("source", 0.15, (0.28, 1.0, 0.36)), "INFLOW", distance=1.0)
    flow.use_initial_velocity = True
    flow.velocity_coord = (fluid.inflow_speed, 0.0, 0.0)
    flow.velocity_random = fluid.inflow_random
    vary_density(flow)


def jet_at_obstacle(fluid: Fluid, arguments: argparse.Namespace) -> None:
    """The jet, and a solid sphere in its way: where, and as large as, that of the paper's scene is."""
    jet(fluid, arguments)
    width, depth, height = SIZE
    solid = sphere("obstacle", 0.15 * width, (0.7 * width, 0.5 * depth, 0.5 * height))
    modifier = solid.modifiers.new("Fluid", "FLUID")
    modifier.fluid_type = "EFFECTOR"
    modifier.effector_settings.effector_type = "COLLISION"


def burning_torus(fluid: Fluid, arguments: argparse.Namespace) -> None:
    """A ring near the floor, off the middle, that burns and smokes."""
    width, depth, _ = SIZE
    bpy.ops.mesh.primitive_torus_add(location=(0.4 * width, 0.45 * depth, 0.4), major_radius=0.35, minor_radius=0.1)
    flow = emit_smoke(bpy.context.object, "INFLOW", distance=1.0)
    flow.flow_type = "BOTH"
    flow.fuel_amount = 1.0
    vary_density(flow)


def release_shape(shape: bpy.types.Object) -> None:
    """Bring a mesh to its place and size, close its holes, and fill it with smoke once, at the first frame."""
    bpy.context.view_layer.objects.active = shape
    bpy.ops.object.transform_apply(location=True, rotation=True, scale=True)
    vertices = shape.data.vertices
    extents = [(min(v.co[axis] for v in vertices), max(v.co[axis] for v in vertices)) for axis in range(3)]
    if extents[2][0] == extents[2][1]:
        raise RefusedError("the mesh is flat, expected one with a height")
    scale = 1.15 / (extents[2][1] - extents[2][0])
    if max(high - low for low, high in extents[:2]) * scale > SIZE[0]:
        raise RefusedError("the mesh is more than 1.7 times as wide as it is high, and would not fit into the domain")
    for vertex in vertices:
        vertex.co = [
            (vertex.co[axis] - (low + high) / 2) * scale + (1.0, 1.0, 0.85)[axis]
            for axis, (low, high) in enumerate(extents)
        ]
    shape.data.update()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.fill_holes(sides=0)
    bpy.ops.object.mode_set(mode="OBJECT")
    emit_smoke(shape, "GEOMETRY", distance=0.5)


def monkey(fluid: Fluid, arguments: argparse.Namespace) -> None:
    """Smoke in the shape of Blender's own monkey head."""
    bpy.ops.mesh.primitive_monkey_add(size=1.0)
    head = bpy.context.object
    head.modifiers.new("smooth", "SUBSURF").levels = 2
    bpy.ops.object.modifier_apply(modifier="smooth")
    release_shape(head)


def mesh(fluid: Fluid, arguments: argparse.Namespace) -> None:
    """Smoke in the shape of a Wavefront OBJ file, which is y up and looks along +z."""
    try:
        bpy.ops.wm.obj_import(filepath=str(arguments.mesh.resolve()), forward_axis="NEGATIVE_Z", up_axis="Y")
    except RuntimeError as error:
        raise RefusedError(f"Blender cannot read the mesh: {error}") from None
    parts = [part for part in bpy.context.selected_objects if part.type == "MESH" and part.data.polygons]
    if not parts:
        raise RefusedError("the mesh has no faces")
    bpy.context.view_layer.objects.active = parts[0]
    bpy.ops.object.join()
    release_shape(parts[0])


JET = "inflow from a sphere of radius 0.15 m at x 0.28 m, y 0.36 m, mid-depth, its density varied by drifting noise"
SCENES = {
    "smokejet": Scene(
        Fluid(0.3, 0.5, 0.1, inflow_speed=1.2, inflow_random=0.3),
        jet,
        JET,
    ),
    "suzanne": Scene(
        Fluid(0.5, 1.0, 0.05),
        monkey,
        "Blender's monkey head (subdivided twice, holes filled), 1.15 m high, filled with smoke once",
    ),
    "obstacle": Scene(
        Fluid(0.3, 0.5, 0.1, inflow_speed=1.2, inflow_random=0.3),
        jet_at_obstacle,
        f"{JET}; a solid sphere of radius 0.3 m at x 1.4 m, y 1.5 m, mid-depth",
    ),
    "mesh": Scene(
        Fluid(0.5, 1.0, 0.05),
        mesh,
        "a mesh (holes filled), 1.15 m high, filled with smoke once",
    ),
    "fire": Scene(
        Fluid(0.5, 2.0, 0.1),
        burning_torus,
        "a burning ring (radius 0.35 m, 0.2 m thick) 0.4 m above the floor, its smoke varied by drifting noise",
        Domain(adaptive=True, upres_factor=2, turn_degrees=30.0),
    ),
}


def add_domain(scene: Scene, arguments: argparse.Namespace) -> bpy.types.Object:
    """Add the domain, whose longest axis has `resolution` cells.

    Blender cuts the other axes off to whole cells and stretches these; for cells that are cubes at any resolution,
    the domain is made as wide as a number of whole cells.
    """
    sides = list(SIZE[:2])
    for axis, length in enumerate(sides):
        cells = length * arguments.resolution / SIZE[2]
        if cells != round(cells):
            # The small rest keeps Blender's rounding from losing a cell.
            sides[axis] = (round(cells) + 1e-4) * SIZE[2] / arguments.resolution
    bpy.ops.mesh.primitive_cube_add(size=1, location=[length / 2 for length in SIZE])
    box = bpy.context.object
    box.name = "domain"
    box.scale = (*sides, SIZE[2])
    bpy.ops.object.transform_apply(location=False, rotation=False, scale=True)
    box.rotation_euler.z = math.radians(scene.domain.turn_degrees)
    modifier = box.modifiers.new("Fluid", "FLUID")
    modifier.fluid_type = "DOMAIN"
    settings = modifier.domain_settings
    settings.domain_type = "GAS"
    settings.resolution_max = arguments.resolution
    settings.alpha, settings.beta = scene.fluid.buoyancy_density, scene.fluid.buoyancy_heat
    settings.vorticity = scene.fluid.vorticity
    settings.use_dissolve_smoke = False
    settings.use_adaptive_domain = scene.domain.adaptive
    settings.use_noise = scene.domain.upres_factor > 1
    settings.noise_scale = scene.domain.upres_factor
    # One step per frame: the velocity of a frame is then what carries its density to the next.
    settings.use_adaptive_timesteps = False
    settings.timesteps_min = settings.timesteps_max = 1
    for side in ("front", "back", "left", "right", "top", "bottom"):
        setattr(settings, f"use_collision_border_{side}", side == "bottom")
    settings.cache_type = "ALL"
    settings.cache_frame_start, settings.cache_frame_end = 1, arguments.frames
    settings.openvdb_data_depth = "32"
    settings.openvdb_cache_compress_type = "ZIP"
    settings.cache_data_format = arguments.format
    # A resumable cache also holds the solver's state, and where its obstacles are.
    settings.cache_resumable = arguments.format == "UNI"
    # Last: a change of the settings above would empty the folder.
    settings.cache_directory = str(arguments.cache.resolve())
    settings.cache_frame_pause_data = arguments.begin if arguments.begin > 1 else 0
    return box


def bake(scene: Scene, arguments: argparse.Namespace) -> None:
    """Build the scene and simulate it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    settings = bpy.context.scene
    settings.render.fps = FRAMES_PER_SECOND
    settings.render.fps_base = 1.0
    settings.frame_start, settings.frame_end = 1, arguments.frames
    scene.build(scene.fluid, arguments)
    # Last: objects added after the domain would be left out of what the bake simulates.
    box = add_domain(scene, arguments)
    # What is told is y up, as all that comes of it: x = X, y = Z, z = -Y.
    right, back, up = settings.gravity
    facts = {
        "blender_version": bpy.app.version_string,
        "source": scene.description,
        "simulation_parameters": {
            **asdict(scene.fluid),
            "gravity_m_s2": [right, up, -back],
            "substeps_per_frame": 1,
            "borders": "bottom closed, other five faces open (the outermost layer of cells stays empty there)",
        },
        "domain_height_m": SIZE[2],
        "domain": {**asdict(scene.domain), "centre_m": list(box.location)},
        "frames_per_second": FRAMES_PER_SECOND,
    }
    tell(f"scene {json.dumps(facts)}")

    def baked(current: bpy.types.Scene, *rest: object) -> None:
        tell(f"frame {current.frame_current}")

    bpy.app.handlers.frame_change_post.append(baked)
    with bpy.context.temp_override(object=box, active_object=box, scene=settings):
        bpy.ops.fluid.bake_all()
    bpy.app.handlers.frame_change_post.remove(baked)


def main() -> None:
    """Read the arguments after `--` and bake."""
    parser = argparse.ArgumentParser(
        prog="blender_bake.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scene", choices=SCENES)
    parser.add_argument("cache", type=Path, help="folder for Blender's cache")
    parser.add_argument("--resolution", type=int, default=96, help="cells along the height")
    parser.add_argument("--frames", type=int, default=60, help="number of the last frame; the first is 1")
    parser.add_argument("--mesh", type=Path, help="OBJ file, for the scene mesh")
    parser.add_argument("--format", choices=("UNI", "OPENVDB"), default="UNI")
    parser.add_argument("--begin", type=int, default=1, help="go on with this frame; UNI caches only")
    arguments = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else [])
    try:
        bake(SCENES[arguments.scene], arguments)
    except RefusedError as refused:
        tell(f"refused {refused}")
        sys.exit(2)


main()
