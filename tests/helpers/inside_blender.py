"""Runs inside Blender, or in a Python that has bpy: installs the add-on's zip, uses it, and tells what came of it.

    blender --background --factory-startup --python inside_blender.py -- JSON

The JSON names a scenario, which is a function of this file, and its arguments, of which `out` is a folder. What came of
it is in told.json there.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
from mathutils import Matrix, Vector

# Blender looks for modules beside its own scripts alone.
sys.path.insert(0, str(Path(__file__).parent))
from drawn_layout import Layout

#: Names of the add-on's package, as an extension and as an add-on.
EXTENSION, ADDON = "bl_ext.user_default.tnst_mi_blender", "tnst_mi_blender"


def install(zip_file: str, program: str) -> str:
    """Install the zip as an artist does, and return the name of its package."""
    if bpy.app.version >= (4, 2):
        bpy.ops.extensions.package_install_files(filepath=zip_file, repo="user_default", enable_on_install=True)
        package = EXTENSION
    else:
        bpy.ops.preferences.addon_install(filepath=zip_file)
        bpy.ops.preferences.addon_enable(module=ADDON)
        package = ADDON
    bpy.context.preferences.addons[package].preferences.program = program
    return package


def module(package: str, name: str) -> Any:
    """A module of the add-on."""
    return sys.modules[f"{package}.{name}"]


def look_at(target: Vector, place: tuple[float, float, float]) -> None:
    """Give the scene a camera that looks at a point, a sun, and a small picture by Cycles."""
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location = place
    camera.rotation_euler = (target - camera.location).to_track_quat("-Z", "Y").to_euler()
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.rotation_euler = 4.0, (0.6, 0.3, 0.0)
    for item in (camera, sun):
        scene.collection.objects.link(item)
    scene.camera = camera
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 16, False
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 120, 100, 100


def smoke_material() -> bpy.types.Material:
    """A material that shows the grid density."""
    material = bpy.data.materials.new("thick smoke")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    output, shader = nodes.new("ShaderNodeOutputMaterial"), nodes.new("ShaderNodeVolumePrincipled")
    shader.inputs["Density"].default_value = 8.0
    material.node_tree.links.new(shader.outputs["Volume"], output.inputs["Volume"])
    return material


def volume_of(folder: str) -> bpy.types.Object:
    """A moved, turned and scaled volume of the files smoke_0007.vdb to smoke_0009.vdb, from frame 21 on."""
    data = bpy.data.volumes.new("Smoke")
    data.filepath = str(Path(folder, "smoke_0007.vdb"))
    data.is_sequence, data.frame_start, data.frame_offset, data.frame_duration = True, 21, 6, 3
    item = bpy.data.objects.new("Smoke", data)
    item.location, item.rotation_euler, item.scale = (3.0, 1.0, 2.0), (0.2, -0.1, 0.6), (0.1, 0.1, 0.1)
    bpy.context.scene.collection.objects.link(item)
    bpy.context.view_layer.objects.active = item
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = 21, 23
    bpy.context.scene.frame_set(21)
    data.materials.append(smoke_material())
    return item


def choose(item: bpy.types.Object, package: str, out: str, **keys: str) -> None:
    """Settings of a short run towards a picture, and advanced keys by their texts."""
    settings = item.tnst_mi
    settings.looks.add()
    settings.looks[0].goal, settings.looks[0].picture = "PICTURE", "spirals"
    settings.out, settings.steady, settings.quality = out, False, "final"
    for key, text in ({"octaves": "1", "iterations": "2", "views": "1", "weights": "patterns"} | keys).items():
        override = settings.overrides.add()
        module(package, "recipes.advanced").fill_in(override, key)
        override.text = text


def bounds(item: bpy.types.Object) -> list[list[float]]:
    """The corners of an object's bounds in the world, in its current frame."""
    bpy.context.view_layer.update()
    evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    if item.type == "VOLUME":
        evaluated.data.grids.load()
    return [list(evaluated.matrix_world @ Vector(corner)) for corner in evaluated.bound_box]


def picture(out: str) -> None:
    """Render the current frame."""
    bpy.context.scene.render.filepath = out
    bpy.ops.render.render(write_still=True)


def reported(operator: Any) -> str:
    """What an operator that is refused reports."""
    try:
        operator()
    except RuntimeError as error:
        return str(error).strip()
    return "was not refused"


def shown_objects() -> dict[str, Any]:
    """The volume objects of the scene."""
    return {
        item.name: {
            "file": item.data.filepath,
            "frames": [item.data.frame_start, item.data.frame_offset, item.data.frame_duration],
            "materials": [material.name for material in item.data.materials],
            "hidden": [item.hide_viewport, item.hide_render],
        }
        for item in bpy.data.objects
        if item.type == "VOLUME"
    }


def refusals(zip: str, folder: str, out: str) -> dict[str, Any]:
    """The panel is drawn; everything that is bad is refused."""
    package = install(zip, str(Path(out, "no-such-program")))
    item = volume_of(folder)
    module(package, "interface.thumbnails")._cut_sheet()
    settings, stylize = item.tnst_mi, bpy.ops.tnst_mi.stylize
    told: dict[str, Any] = {"package": package, "environment": reported(stylize)}
    program = Path(out, "tnst-mi")
    failing = f"echo \"tnst-mi: {out}/a/recipe.toml: frames = '4': none; lower iterations = 2 or --lam\"; exit 2"
    version = module(package, "version").VERSION
    program.write_text(f'#!/bin/sh\ncase "$1" in --version) echo tnst-mi {version};; *) {failing};; esac\n')
    program.chmod(0o755)
    bpy.context.preferences.addons[package].preferences.program = str(program)
    told["no look"] = reported(stylize)
    settings.looks.add()
    # Previews have no icons in the background, but pictures.
    thumbnails = module(package, "interface.thumbnails")
    shown = [thumbnails._Loaded.pictures[choice[0]] for choice in thumbnails.motif_items()]
    told["motifs"] = [[*each.image_size, len(set(each.image_pixels_float)) > 2] for each in shown]
    told["no camera"] = reported(stylize)
    settings.use_camera = False
    settings.looks[0].goal = "PICTURE"
    told["no picture"] = reported(stylize)
    settings.looks[0].picture = "spirals"
    settings.looks[0].region = bpy.data.objects.new("somewhere", None)
    told["region"] = reported(stylize)
    settings.looks[0].region = None
    settings.use_range, settings.frame_start, settings.frame_end = True, 30, 40
    told["frames"] = reported(stylize)
    settings.use_range = False
    item.scale.x = 0.3
    settings.use_camera = True
    look_at(item.location, (3.5, -6.0, 3.0))
    bpy.context.view_layer.update()
    told["uneven"] = reported(stylize)
    item.scale.x = -0.1
    bpy.context.view_layer.update()
    told["mirrored"] = reported(stylize)
    item.scale.x = 0.0
    bpy.context.view_layer.update()
    told["flat"] = reported(stylize)
    item.scale.x = 0.1
    told["foreseen"] = foreseen(package, item, out)
    bpy.context.scene.timeline_markers.new("late", frame=24)
    bpy.context.scene.frame_end = 40
    told["no smoke"] = reported(bpy.ops.tnst_mi.bake_markers)
    bpy.context.scene.timeline_markers.clear()
    settings.use_camera = False
    bpy.context.view_layer.update()
    sphere = bpy.data.objects.new("sphere", None)
    sphere.empty_display_type, sphere.hide_viewport = "SPHERE", True
    bpy.context.scene.collection.objects.link(sphere)
    settings.looks[0].region = sphere
    told["unseen"] = reported(stylize)
    settings.looks[0].region = None
    bpy.context.scene.timeline_markers.new("", frame=21)
    item.data.sequence_mode = "REPEAT"
    told["repeated"] = reported(bpy.ops.tnst_mi.bake_markers)
    item.data.sequence_mode = "CLIP"
    bpy.context.scene.timeline_markers.clear()
    module(package, "recipes.advanced").fill_in(settings.overrides.add(), "lam")
    settings.overrides[0].text = "1.5"
    told["advanced"] = reported(stylize)
    settings.overrides[0].key = "lambda"
    told["unknown"] = reported(stylize)
    settings.overrides[0].key = "lam"
    told["markers"] = reported(bpy.ops.tnst_mi.bake_markers)
    told["resume"] = reported(bpy.ops.tnst_mi.resume)
    settings.out, settings.overrides[0].text = "//results", "0.5"
    told["unsaved"] = reported(stylize)
    settings.out = str(program)
    told["unwritable"] = reported(stylize)
    settings.out = str(Path(out, "results"))
    told["failed"] = reported(stylize)
    preferences = module(package, "interface.preferences")
    if bpy.app.version >= (4, 2):
        bpy.context.preferences.system.use_online_access = True
    install_to = lambda *given: (_ for _ in ()).throw(OSError("\n".join(map(str, given[:2]))))  # noqa: E731
    preferences.Installation, installation = install_to, preferences.Installation
    told["installation"] = reported(bpy.ops.tnst_mi.install).removeprefix("Error: ").splitlines()
    preferences.Installation = installation
    settings.show_advanced = True
    told["panels"] = panels_of(package, item)
    told["copies"] = copies(package, item)
    panels = module(package, "interface.panel")
    layout = Layout()
    for goal in ("MOTIF", "PICTURE", "CHANNEL"):
        settings.looks[0].goal = goal
        panels._draw_looks(layout, settings)
    panels._draw_advanced(layout, settings, 300)
    panels._draw_buttons(layout)
    module(package, "interface.preferences").TnstMiPreferences.draw(
        type(
            "Drawn", (), {"layout": layout, "bl_rna": module(package, "interface.preferences").TnstMiPreferences.bl_rna}
        )(),
        bpy.context,
    )
    bpy.ops.preferences.addon_disable(module=package)
    told["drawn"], told["left"] = layout.drawn, hasattr(bpy.types.Object, "tnst_mi")
    return told


def panels_of(package: str, item: bpy.types.Object) -> dict[str, list[str]]:
    """The texts and buttons of the sidebar's panel, with various objects selected, and while another one's run goes on.

    An empty list where there is no panel.
    """
    panel, watched = module(package, "interface.panel").TNST_MI_PT_sidebar, module(package, "interface.running")
    result = bpy.data.objects.new("result", bpy.data.volumes.new("result"))
    bpy.context.scene.collection.objects.link(result)
    result.tnst_mi.original = item

    def drawn(selected: bpy.types.Object | None) -> list[str]:
        context = SimpleNamespace(object=selected, region=SimpleNamespace(width=2000))
        layout = Layout()
        if panel.poll(context):
            panel.draw(SimpleNamespace(layout=layout), context)
        return [*layout.texts, *layout.drawn]

    told = {"volume": drawn(item), "result": drawn(result), "camera": drawn(bpy.context.scene.camera)}
    told["nothing"] = drawn(None)
    now = watched.Running(SimpleNamespace(cancelled=False), "Stylizing other", str)
    watched._Watched.running = now
    told |= {"nothing, running": drawn(None), "volume, running": drawn(item)}
    watched._Watched.running = None
    collection = item.users_collection[0]
    collection.objects.unlink(item)
    told["lost original"] = drawn(result)
    collection.objects.link(item)
    bpy.context.view_layer.objects.active = item
    bpy.data.objects.remove(result)
    return told


def copies(package: str, item: bpy.types.Object) -> dict[str, Any]:
    """Whose run is in the folder of Smoke: of copies, of what is renamed, linked and appended, in copies of scenes."""
    last_run, plans = module(package, "interface.last_run"), module(package, "recipes.plan")
    scene, folder = bpy.context.scene, Path(item.tnst_mi.out)
    plan = plans.read_plan(folder)

    def refused(asking: bpy.types.Object, plan: Any = plan) -> str:
        try:
            last_run.require_own(folder, plan, asking)
        except module(package, "problems").CannotStylizeError as error:
            return str(error)
        return ""

    copy = item.copy()
    scene.collection.objects.link(copy)
    told: dict[str, Any] = {"named": [refused(item), refused(copy)]}
    told["said"] = [last_run.run_of(item) is not None, last_run.run_of(copy) is not None]
    bpy.context.view_layer.objects.active = copy
    told["stylized"], told["resumed"] = reported(bpy.ops.tnst_mi.stylize), reported(bpy.ops.tnst_mi.resume)
    # Names change hands.
    item.name, copy.name = "Fog", "Smoke"
    told["renamed"] = [refused(item), refused(copy)]
    other = replace(plan, identifier=plans.new_identifier())
    last_run.keep(copy, other, folder)
    told["each its own"] = [refused(item), refused(copy), refused(item, other), refused(copy, other)]
    bpy.ops.scene.new(type="FULL_COPY")
    full = bpy.context.scene
    (of_full,) = (run.item for run in full.tnst_mi_runs if run.identifier == plan.identifier)
    told["full copy"] = [of_full != item, refused(item), refused(of_full), last_run.run_of(of_full) is None]
    bpy.data.scenes.remove(full)
    bpy.data.objects.remove(copy)
    there, gone = folder / "asset.blend", folder / "gone.blend"
    there.touch()
    of_file = [replace(other, scene=str(file)) for file in (there, gone)] + [replace(other, scene="")]
    told["of a file"] = [refused(item, each) for each in of_file]
    bpy.context.view_layer.objects.active, item.name = item, "Smoke"
    return told


def foreseen(package: str, item: bpy.types.Object, out: str) -> dict[str, Any]:
    """What is known of a shot before it is run: how many frames are gone through for it, and notes."""
    shots = module(package, "scene.shots")
    camera_table, scene = shots.camera_table, bpy.context.scene
    gone_through: list[int] = []

    def noted(*arguments: Any) -> Any:
        gone_through.append(scene.frame_current)
        return camera_table(*arguments)

    shots.camera_table = noted

    def prepared(**part: Any) -> dict[str, Any]:
        gone_through.clear()
        bpy.context.view_layer.update()
        smoke = module(package, "scene.smoke").smoke_of(item)
        shot, notes = shots.shot_of(bpy.context, item.tnst_mi, smoke, shots.Take(**part), Path(out, "foreseen"), "")
        cameras = {} if shot.camera is None else json.loads(shot.camera.read_text("utf-8"))
        found = {"frames": list(gone_through), "notes": list(notes), "differ": "frames" in cameras}
        return found | {"across": [table["matrix"][0][3] for table in cameras.get("frames", {"": cameras}).values()]}

    told = {"still": prepared()}
    camera, holder = scene.camera, bpy.data.objects.new("holder", None)
    scene.collection.objects.link(holder)
    camera.parent = holder
    told["held"] = prepared()
    holder.keyframe_insert("location", frame=21)
    holder.location.x = 1.0
    holder.keyframe_insert("location", frame=23)
    scene.frame_set(21, subframe=0.5)
    told["carried"] = prepared()
    told["came back"] = [scene.frame_current, scene.frame_subframe]
    scene.frame_set(21)
    told["last frame"] = prepared(bounds=(23, 23))
    camera.hide_viewport, scene.camera = True, None
    told["hidden camera"] = prepared(camera=camera)
    scene.timeline_markers.new("only", frame=30).camera = camera
    told["only of a marker"] = prepared()
    scene.timeline_markers.clear()
    camera.hide_viewport, scene.camera = False, camera
    scene.render.frame_map_new = 200
    try:
        prepared()
    except module(package, "problems").CannotStylizeError as error:
        told["stretched"] = str(error)
    scene.render.frame_map_new = 100
    camera.parent = None
    camera.data.driver_add("lens").driver.expression = "40 + frame"
    told["driven"] = prepared()
    camera.data.driver_remove("lens")
    camera.data.lens = 50.0
    item.keyframe_insert("location", frame=21)
    item.location.x += 1.0
    item.keyframe_insert("location", frame=23)
    scene.frame_set(21)
    told["moving smoke"] = prepared()
    item.hide_viewport = True
    told["hidden smoke"] = prepared()
    item.hide_viewport = False
    collection = bpy.data.collections.new("excluded")
    scene.collection.children.link(collection)
    collection.objects.link(item)
    scene.collection.objects.unlink(item)
    bpy.context.view_layer.layer_collection.children["excluded"].exclude = True
    told["excluded smoke"] = prepared()
    scene.collection.objects.link(item)
    bpy.data.collections.remove(collection)
    bpy.context.view_layer.objects.active = item
    item.tnst_mi.use_camera = False
    handler = lambda scene, *_: gone_through.append(scene.frame_current)  # noqa: E731
    bpy.app.handlers.frame_change_pre.append(handler)
    gone_through_for_nothing = module(package, "scene.smoke").smoke_of(item)
    gone_through.clear()
    shots.shot_of(bpy.context, item.tnst_mi, gone_through_for_nothing, shots.Take(), Path(out, "foreseen"), "")
    told["without camera"] = list(gone_through)
    bpy.app.handlers.frame_change_pre.remove(handler)
    item.tnst_mi.use_camera = True
    told["left"] = [each.name for each in bpy.data.objects if "tnst_mi" in each.name]
    item.animation_data_clear()
    camera.rotation_euler.z += 3.0
    told["turned away"] = prepared()
    camera.rotation_euler.z -= 3.0
    shots.camera_table = camera_table
    told["may move"] = may_move(package)
    return told


def may_move(package: str) -> dict[str, bool]:
    """Whether an object that is attached in various ways to one that has keyframes, or that stays, may move."""
    scene, tested = bpy.context.scene, module(package, "scene.motion").may_move
    keyed, still = bpy.data.objects.new("keyed", None), bpy.data.objects.new("still", None)
    keyed.keyframe_insert("location", frame=21)
    mesh = bpy.data.objects.new("mesh", bpy.data.meshes.new("mesh"))
    items = [keyed, still, mesh]
    ways: dict[str, Callable[[bpy.types.Object], object]] = {
        "alone": lambda item: None,
        "child of keyed": lambda item: setattr(item, "parent", keyed),
        "child of still": lambda item: setattr(item, "parent", still),
        "child of a vertex": lambda item: (setattr(item, "parent", mesh), setattr(item, "parent_type", "VERTEX")),
        "hidden by a driver": lambda item: item.driver_add("hide_render"),
        "driven": lambda item: item.driver_add("location", 0),
        "follows a path": lambda item: item.constraints.new("FOLLOW_PATH"),
        "follows a path, muted": lambda item: setattr(item.constraints.new("FOLLOW_PATH"), "mute", True),
        "limited": lambda item: item.constraints.new("LIMIT_LOCATION"),
        "tracks keyed": lambda item: setattr(item.constraints.new("TRACK_TO"), "target", keyed),
        "tracks still": lambda item: setattr(item.constraints.new("TRACK_TO"), "target", still),
        "limited in space of keyed": lambda item: setattr(
            item.constraints.new("LIMIT_LOCATION"), "space_object", keyed
        ),
        "tracks in space of keyed": lambda item: setattr(item.constraints.new("TRACK_TO"), "space_object", keyed),
        "tracks in space of still": lambda item: setattr(item.constraints.new("TRACK_TO"), "space_object", still),
    }
    told = {}
    for name, attach in ways.items():
        items.append(bpy.data.objects.new(name, None))
        attach(items[-1])
        told[name] = tested([items[-1]], scene)
    called = lambda *_: None  # noqa: E731
    bpy.app.handlers.frame_change_post.append(called)
    told["alone, with a script"] = tested([still], scene)
    bpy.app.handlers.frame_change_post.remove(called)
    scene.keyframe_insert("gravity", frame=21)
    told["alone, in a scene with keyframes"] = tested([still], scene)
    scene.animation_data_clear()
    for each in items:
        bpy.data.objects.remove(each)
    return told


def linked(package: str, item: bpy.types.Object, out: str) -> dict[str, Any]:
    """The result of an object that belongs to another file, of its override, and of one of an object with keyframes."""
    keyed = item.copy()
    keyed.name = "Keyed"
    keyed.keyframe_insert("location", frame=21)
    library = str(Path(out, "library.blend"))
    bpy.data.libraries.write(library, {item, keyed})
    bpy.data.objects.remove(keyed)
    with bpy.data.libraries.load(library, link=True) as (_, wanted):
        wanted.objects = [item.name, "Keyed"]
    (of_library, with_keyframes), told = wanted.objects, {}
    for each in (of_library, with_keyframes):
        bpy.context.scene.collection.objects.link(each)
    smoke_of = module(package, "scene.smoke").smoke_of
    visibility, last_run = module(package, "scene.visibility"), module(package, "interface.last_run")
    plan = module(package, "recipes.plan").read_plan(Path(out, "results"))
    last_run.keep(item, plan, Path(out, "results"), "of the asset")
    told["knows the asset's"] = last_run.run_of(of_library) is not None
    for name, linked_one in (("linked", of_library), ("keyed", with_keyframes), ("override", of_library)):
        each = linked_one if name == "linked" else linked_one.override_create(remap_local_usages=True)
        smoke = smoke_of(each)
        part = module(package, "recipes.plan").Part("", str(Path(out, "results", "later")))
        shown = module(package, "scene.results").load_result(each, smoke, part, "IN_PLACE")
        last_run.keep(each, replace(plan, identifier=name), Path(out, "results"), f"of the {name}")
        notes = visibility.hide_in_frames_of_results(each, smoke, "IN_PLACE")
        told[name] = {
            "notes": [*module(package, "scene.smoke").note_of_library(each), *notes],
            "shown": [shown.library is None, shown.parent == each, bpy.context.scene in shown.users_scene],
            "hidden": hidden_in(each),
            "run": last_run.run_of(each).text,
        }
    each.tnst_mi.quality = "preview"
    each.tnst_mi.looks.add().picture = "net"
    bpy.ops.wm.save_as_mainfile(filepath=str(Path(out, "scene.blend")))
    bpy.ops.wm.open_mainfile(filepath=str(Path(out, "scene.blend")))
    overrides = [item for item in bpy.data.objects if item.override_library is not None]
    opened = {item.override_library.reference.name: item for item in overrides}
    kept = opened["Smoke"].tnst_mi
    told["kept"] = [kept.quality, [look.picture for look in kept.looks]]
    told["kept hidden"] = {name: hidden_in(item) for name, item in opened.items()}
    told["runs"] = {
        (each.override_library.reference.name if each.override_library else "own"): run.text
        for each in bpy.data.objects
        if (run := last_run.run_of(each)) is not None
    }
    return told


def hidden_in(item: bpy.types.Object) -> list[int]:
    """The frames, of 18 to 29, in which an object is hidden, in viewports and in pictures."""
    scene, frames = bpy.context.scene, []
    current = scene.frame_current
    for frame in range(18, 30):
        scene.frame_set(frame)
        # What is hidden in viewports is not evaluated, but for that.
        if item.hide_viewport != item.hide_render:
            raise ValueError(f"frame {frame}: hidden in one of both")
        if item.hide_render:
            frames.append(frame)
    scene.frame_set(current)
    return frames


def volume(zip: str, program: str, folder: str, out: str) -> dict[str, Any]:
    """A volume is stylized, twice, with a region; the original stays beside the second."""
    package = install(zip, program)
    item = volume_of(folder)
    look_at(item.location + Vector((0.5, 0.5, 0.8)), (3.5, -6.0, 3.0))
    choose(item, package, str(Path(out, "results")))
    item.modifiers.new("waves", "VOLUME_DISPLACE").strength = 0.0
    item.material_slots[0].link = "OBJECT"
    item.material_slots[0].material = bpy.data.materials["thick smoke"].copy()
    item.material_slots[0].material.name = "of the object"

    def move(_words: str) -> bool:
        item.location.x += 0.5
        bpy.context.view_layer.update()
        return True

    once_while_running(package, move)
    told: dict[str, Any] = {"first": list(bpy.ops.tnst_mi.stylize())}
    shown = bpy.data.objects["Smoke_stylized"]
    told["in place"], told["objects"] = bounds(shown), shown_objects()
    told["modifiers"] = [[each.type, each.strength] for each in shown.modifiers]
    picture(str(Path(out, "seen.png")))
    bpy.ops.mesh.primitive_cube_add(size=1.2, location=bounds(item)[0], rotation=(0.3, 0.2, 0.1))
    item.tnst_mi.looks[0].region = bpy.context.object
    item.tnst_mi.place = "BESIDE"
    bpy.context.view_layer.objects.active = item
    told["second"] = list(bpy.ops.tnst_mi.stylize())
    told["beside"], told["again"] = bounds(shown), shown_objects()
    told["played"] = {}
    for mode in ("CLIP", "EXTEND", "REPEAT", "PING_PONG"):
        item.data.sequence_mode = mode
        # A frame without smoke.
        bpy.context.scene.frame_set(5)
        smoke = module(package, "scene.smoke").smoke_of(item)
        part = module(package, "recipes.plan").Part("", str(Path(out, "results", "final")))
        module(package, "scene.results").load_result(item, smoke, part, "BESIDE")
        told["played"][mode] = [files_of(item), files_of(shown)]
    bpy.context.scene.frame_set(21)
    told["beside from afar"] = bounds(shown)
    # Blender makes bounds anew in a frame with another file.
    told["original"] = bounds(item)
    item.data.sequence_mode = "CLIP"
    width, files = module(package, "scene.extent").width, sorted(Path(out, "extents").glob("*.vdb"))
    told["widths"] = [width(Matrix(), some) for some in ([files[0]], [files[2]], files)]
    told["artist"] = hidden_by_artist(package, item, out)
    told["of a library"] = linked(package, item, out)
    return told


def hidden_by_artist(package: str, item: bpy.types.Object, out: str) -> dict[str, Any]:
    """An original is hidden in the frames of its result alone; the keyframes of an artist that hide it stay."""
    hide = module(package, "scene.visibility").hide_in_frames_of_results
    smoke = module(package, "scene.smoke").smoke_of(item)
    show, Part = module(package, "scene.results").load_result, module(package, "recipes.plan").Part
    all_frames, later = Path(out, "results", "final"), Path(out, "results", "later")
    show(item, smoke, Part("", str(all_frames)), "IN_PLACE")
    told: dict[str, Any] = {"all": [list(hide(item, smoke, "IN_PLACE")), hidden_in(item)]}
    told["no drivers"] = item.animation_data is None
    (later / "density").mkdir(parents=True)
    for file in sorted((all_frames / "density").iterdir())[1:]:
        shutil.copy(file, later / "density")
    show(item, smoke, Part("", str(later)), "IN_PLACE")
    told["later"] = [list(hide(item, smoke, "IN_PLACE")), hidden_in(item)]
    told["simple"] = [curve.driver.is_simple_expression for curve in item.animation_data.drivers]
    bpy.context.scene.frame_set(23, subframe=0.5)
    told["between"] = item.hide_render
    for mode in ("EXTEND", "REPEAT", "PING_PONG"):
        item.data.sequence_mode = mode
        again = module(package, "scene.smoke").smoke_of(item)
        show(item, again, Part("", str(later)), "IN_PLACE")
        told[mode] = [list(hide(item, again, "IN_PLACE")), hidden_in(item)]
    item.data.sequence_mode = "CLIP"
    show(item, smoke, Part("", str(later)), "IN_PLACE")
    hide(item, smoke, "IN_PLACE")
    # With keyframes for one of both.
    item.driver_remove("hide_render")
    item.keyframe_insert("hide_render", frame=18)
    told["one keyed"] = [len(hide(item, smoke, "IN_PLACE")), len(item.animation_data.drivers), item.hide_viewport]
    item.keyframe_delete("hide_render", frame=18)
    told["beside"] = [list(hide(item, smoke, "BESIDE")), hidden_in(item), len(item.animation_data.drivers)]
    told["lost"] = lost_results(package, item, smoke, later)
    item.animation_data_clear()
    item.hide_render = True
    told["by hand"] = []
    for place in ("BESIDE", "IN_PLACE", "BESIDE"):
        hide(item, smoke, place)
        told["by hand"].append([item.hide_render, item.animation_data is None or len(item.animation_data.drivers)])
    item.hide_render = False
    item.animation_data_clear()
    for path in ("hide_viewport", "hide_render"):
        item.keyframe_insert(path, frame=18)
        setattr(item, path, True)
        item.keyframe_insert(path, frame=28)
    told["keyed"] = [list(hide(item, smoke, "IN_PLACE")), hidden_in(item)]
    item.animation_data_clear()
    item.hide_viewport = item.hide_render = False
    return told


def lost_results(package: str, item: bpy.types.Object, smoke: Any, later: Path) -> dict[str, Any]:
    """Whether an original is shown when files of a shown or a hidden result are gone; and what was unlinked."""
    results, visibility = module(package, "scene.results"), module(package, "scene.visibility")
    Part, scene = module(package, "recipes.plan").Part, bpy.context.scene
    result = results.load_result(item, smoke, Part("", str(later)), "IN_PLACE")
    shot = results.load_result(item, smoke, Part("shot", str(later)), "IN_PLACE")
    told: dict[str, Any] = {}
    for name, parts in (("of another part", ["shot"]), ("of the shown part", ["", "shot"])):
        result.hide_render = result.hide_viewport = False
        visibility.hide_other_parts(item, parts)
        visibility.hide_in_frames_of_results(item, smoke, "IN_PLACE")
        file, result.data.filepath = result.data.filepath, str(later / "gone.vdb")
        told[name] = [results.show_original_of_lost(item), hidden_in(item)]
        result.data.filepath = file
    bpy.data.objects.remove(shot)
    duplicate = result.copy()
    duplicate.name = "A, kept"
    scene.collection.objects.link(duplicate)
    told["with a duplicate"] = results.load_result(item, smoke, Part("", str(later)), "IN_PLACE") == result
    bpy.data.objects.remove(duplicate)
    scene.collection.objects.unlink(result)
    elsewhere = bpy.data.scenes.new("elsewhere")
    elsewhere.collection.objects.link(result)
    again = results.load_result(item, smoke, Part("", str(later)), "IN_PLACE")
    told["unlinked"] = [again == result, sorted(each.name for each in result.users_scene)]
    bpy.data.scenes.remove(elsewhere)
    return told


def files_of(item: bpy.types.Object) -> list[str]:
    """The names of the files that a volume shows in the frames 18 to 29."""
    names = []
    for frame in range(18, 30):
        bpy.context.scene.frame_set(frame)
        grids = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.grids
        names.append(Path(grids.frame_filepath).name if grids.load() and len(grids) else "")
    return names


def once_while_running(package: str, act: Callable[[str], bool]) -> None:
    """Call a function with the words of a job's progress whenever it is looked at, until it returns True."""
    job = module(package, "processes.job").Job
    poll = job.poll

    def looked_at(self: Any) -> Any:
        progress = poll(self)
        if act(progress.text):
            job.poll = poll
        return progress

    job.poll = looked_at


def markers(zip: str, program: str, folder: str, out: str) -> dict[str, Any]:
    """The shots of two markers, each with a camera of its own."""
    package = install(zip, program)
    item = volume_of(folder)
    look_at(item.location, (3.5, -6.0, 3.0))
    other = bpy.context.scene.camera.copy()
    bpy.context.scene.collection.objects.link(other)
    other.location.x += 4.0
    bpy.context.scene.timeline_markers.new("close", frame=21).camera = bpy.context.scene.camera
    bpy.context.scene.timeline_markers.new("close", frame=23).camera = other
    bpy.context.scene.timeline_markers.new("late", frame=24)
    bpy.context.scene.frame_end = 27
    choose(item, package, str(Path(out, "results")))
    # A frame without smoke.
    bpy.context.scene.frame_set(5)
    ended = list(bpy.ops.tnst_mi.bake_markers())
    told = {"ended": ended, "objects": shown_objects(), "current": bpy.context.scene.frame_current}
    plan = module(package, "recipes.plan").read_plan(Path(out, "results"))
    told |= {"notes": plan.notes, "hidden": hidden_in(item), "said": bpy.context.scene.tnst_mi_runs[0].text}
    for name, stylize in (("one", bpy.ops.tnst_mi.stylize), ("shots", bpy.ops.tnst_mi.bake_markers)):
        told[f"then {name}"] = [list(stylize()), {name: each["hidden"] for name, each in shown_objects().items()}]
    return told


def cancelled(zip: str, program: str, folder: str, out: str) -> dict[str, Any]:
    """A run is cancelled once it iterates; it is resumed from the scene saved elsewhere, with the object renamed."""
    package = install(zip, program)
    item = volume_of(folder)
    look_at(item.location, (3.5, -6.0, 3.0))
    choose(item, package, "//results", iterations="60")
    for name in ("project", "elsewhere"):
        Path(out, name).mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(Path(out, "project", "scene.blend")))
    cancel = bpy.ops.tnst_mi.cancel
    told: dict[str, Any] = {"before": cancel.poll()}

    def press(words: str) -> bool:
        if "octave" not in words:
            return False
        told["during"], told["pressed"], told["twice"] = cancel.poll(), list(cancel()), cancel.poll()
        return True

    once_while_running(package, press)
    told["cancelled"] = list(bpy.ops.tnst_mi.stylize())
    told["processes"] = [
        process.name
        for process in Path("/proc").iterdir()
        if process.name.isdigit() and str(Path(out, "project", "results")) in _command_line(process)
    ]
    told["objects"] = shown_objects()
    item.name = "Fog"
    bpy.ops.wm.save_as_mainfile(filepath=str(Path(out, "elsewhere", "scene.blend")))
    bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath)
    item = bpy.data.objects["Fog"]
    (run,) = bpy.context.scene.tnst_mi_runs
    told["stopped"] = run.text
    plan = module(package, "recipes.plan").read_plan(Path(run.folder))
    told["known"] = [plan.identifier == run.identifier, plan.scene]
    told["resumed"] = list(bpy.ops.tnst_mi.resume())
    told["then"], told["after"], told["whose"] = shown_objects(), run.text, run.item.name
    return told


def _command_line(process: Path) -> str:
    try:
        line = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode("utf-8", "replace")
    except OSError:
        return ""
    return "" if "inside_blender" in line else line


def domain(
    zip: str, program: str, out: str, adaptive: bool, noise: bool, format: str, sides: list[float]
) -> dict[str, Any]:
    """A small domain, moved, turned and scaled, is baked and stylized with strength 0: nothing may be seen of that."""
    package = install(zip, program)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 3
    bpy.ops.mesh.primitive_ico_sphere_add(radius=0.5, subdivisions=3, location=(3.4, 0.8, 1.9))
    source = bpy.context.object
    modifier = source.modifiers.new("Fluid", "FLUID")
    modifier.fluid_type = "FLOW"
    modifier.flow_settings.flow_type, modifier.flow_settings.flow_behavior = "SMOKE", "INFLOW"
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=(3.0, 1.0, 2.0), rotation=(0.2, -0.1, 0.6))
    item = bpy.context.object
    item.name, item.scale = "Domain", sides
    modifier = item.modifiers.new("Fluid", "FLUID")
    modifier.fluid_type = "DOMAIN"
    settings = modifier.domain_settings
    settings.domain_type, settings.resolution_max, settings.use_adaptive_domain = "GAS", 24, adaptive
    settings.use_noise, settings.noise_scale = noise, 2
    settings.cache_type, settings.cache_frame_start, settings.cache_frame_end = "ALL", 1, 3
    settings.cache_data_format, settings.cache_directory = format, str(Path(out, "cache"))
    with bpy.context.temp_override(object=item, active_object=item, scene=scene):
        bpy.ops.fluid.bake_all()
    item.data.materials.append(smoke_material())
    source.hide_render = True
    look_at(Vector((3.4, 0.8, 1.9)), (3.5, -7.0, 3.0))
    scene.camera.data.lens = 70.0
    choose(item, package, str(Path(out, "results")))
    item.tnst_mi.strength = 0.0
    scene.frame_set(3)
    picture(str(Path(out, "domain.png")))
    drawn = bounds(item)
    told: dict[str, Any] = {"drawn": drawn, "ended": list(bpy.ops.tnst_mi.stylize()), "objects": shown_objects()}
    picture(str(Path(out, "stylized.png")))
    told["hidden"], told["cell"] = item.hide_render, max(sides) / 24
    shown = bpy.data.objects["Domain_stylized"]
    told["bounds"] = bounds(shown)
    if noise:
        told["without noise"] = baked_anew(out)
    return told


def baked_anew(out: str) -> dict[str, Any]:
    """A domain that had noise is baked without it, with no smoke in its first frame; and a part of it is stylized."""
    # Blender 3.4 crashes where noise is switched off in the session in which it was baked.
    bpy.ops.wm.save_as_mainfile(filepath=str(Path(out, "scene.blend")))
    bpy.ops.wm.open_mainfile(filepath=str(Path(out, "scene.blend")))
    scene, item = bpy.context.scene, bpy.data.objects["Domain"]
    (source,) = (each for each in scene.objects if each.type == "MESH" and each != item)
    flow, settings = source.modifiers["Fluid"].flow_settings, item.modifiers["Fluid"].domain_settings
    for frame, flows in ((1, False), (2, True)):
        flow.use_inflow = flows
        flow.keyframe_insert("use_inflow", frame=frame)
    # Blender neither frees nor bakes domains that are hidden.
    item.hide_viewport = False
    with bpy.context.temp_override(object=item, active_object=item, scene=scene):
        bpy.ops.fluid.free_all()
        settings.use_noise = False
        bpy.ops.fluid.bake_all()
    bpy.context.view_layer.objects.active = item
    item.tnst_mi.place = "BESIDE"
    told: dict[str, Any] = {"ended": list(bpy.ops.tnst_mi.stylize()), "shown": shown_objects()["Domain_stylized"]}
    for frame in (2, 3):
        bpy.data.objects["Domain_stylized"].hide_render = True
        scene.frame_set(frame)
        picture(str(Path(out, f"original_{frame}.png")))
    # Its last frame alone: the others show the original.
    item.tnst_mi.place = "IN_PLACE"
    item.tnst_mi.use_range, item.tnst_mi.frame_start, item.tnst_mi.frame_end = True, 3, 3
    told["in range"] = [list(bpy.ops.tnst_mi.stylize()), shown_objects()["Domain_stylized"]["frames"]]
    for frame in (2, 3):
        scene.frame_set(frame)
        told[f"hidden in {frame}"] = item.hide_render
        picture(str(Path(out, f"in_range_{frame}.png")))
    item.tnst_mi.frame_start = item.tnst_mi.frame_end = 1
    told["without smoke"] = list(bpy.ops.tnst_mi.stylize())
    return told


def main() -> None:
    """Run the scenario that the arguments name."""
    arguments = json.loads(sys.argv[sys.argv.index("--") + 1])
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scenarios = {each.__name__: each for each in (refusals, volume, markers, cancelled, domain)}
    told = scenarios[arguments.pop("scenario")](**arguments)
    Path(arguments["out"], "told.json").write_text(json.dumps(told), "utf-8")


main()
