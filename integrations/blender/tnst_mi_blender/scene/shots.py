"""From the panel's settings to shots, with the cameras and regions that the scene has in each frame."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
from mathutils import Matrix

from ..export_camera import UnusableCameraError, camera_table, cameras_of
from ..problems import CannotStylizeError
from ..recipes import commands
from ..recipes.advanced import keys_of
from ..recipes.commands import Goal, Shot
from .extent import corners_at
from .motion import may_change_shape, may_move
from .regions import Region
from .sight import may_see
from .smoke import Smoke, frames_between, note_of_library

#: What a stylization begins with; that of the bundled recipes. The list Advanced changes it.
BASIS = {"octaves": 2, "views": 3, "eta": 0.004}

#: Towards motifs it takes more, and thin smoke: scenes/by_name.toml.
MOTIFS = {"weights": "patterns", "iterations": 40, "gamma": 0.01}

#: Steady sequences: scenes/smokejet/sequence.toml.
STEADY = {"window": 9, "window_weights": "gaussian", "coherence": 2.5}

#: Frames per second that a recipe can have.
FASTEST = 240.0


@dataclass(frozen=True)
class Take:
    """A part of the timeline that is stylized by itself.

    Attributes:
        name: of the marker that it begins at, as no other take's; empty for all of it.
        bounds: first and last frame of the scene; None for all frames of the smoke.
        camera: the marker's own; None for that of the scene.
    """

    name: str = ""
    bounds: tuple[int, int] | None = None
    camera: bpy.types.Object | None = None


def takes_of_markers(scene: bpy.types.Scene) -> list[Take]:
    """A take for each marker: from its frame to the one before the next marker, or to the end of the scene.

    Raises:
        CannotStylizeError: there are no markers before the end of the scene.
    """
    markers = sorted(scene.timeline_markers, key=lambda marker: marker.frame)
    if not markers:
        raise CannotStylizeError("the timeline has no markers: add one at the first frame of each shot")
    ends = [marker.frame - 1 for marker in markers[1:]] + [scene.frame_end]
    names = _distinct([marker.name for marker in markers])
    takes = [
        Take(name, (marker.frame, end), marker.camera)
        for name, marker, end in zip(names, markers, ends, strict=True)
        if marker.frame <= end
    ]
    if not takes:
        raise CannotStylizeError(f"all markers are after the scene, which ends at {scene.frame_end}: move them")
    return takes


def takes_with_smoke(smoke: Smoke, takes: Sequence[Take]) -> tuple[list[Take], tuple[str, ...]]:
    """The takes in whose frames there is smoke, and a note of each other one.

    Raises:
        CannotStylizeError: there is smoke in none of them.
    """
    found, notes = [], []
    for take in takes:
        try:
            frames_between(smoke, take.bounds)
        except CannotStylizeError:
            notes.append(f"{take.name}: skipped, there is no smoke in its frames {take.bounds[0]} to {take.bounds[1]}")
        else:
            found.append(take)
    if not found:
        first, last = takes[0].bounds[0], takes[-1].bounds[1]
        raise CannotStylizeError(
            f"there is no smoke in the shots of markers, frames {first} to {last}, but in "
            f"{smoke.numbers[0] - smoke.shift} to {smoke.numbers[-1] - smoke.shift}: move the markers, or bake these"
        )
    return found, tuple(notes)


def _distinct(names: Sequence[str]) -> list[str]:
    """The names of markers; those that are empty or there before, with a number."""
    found: list[str] = []
    for name in names:
        free = (f"{name or 'marker'} {number}" for number in itertools.count(2 if name else 1))
        found.append(name if name and name not in found else next(each for each in free if each not in found))
    return found


def frame_bounds(settings: bpy.types.PropertyGroup) -> tuple[int, int] | None:
    """The frames of the scene that are asked for; None for all of the smoke."""
    if not settings.use_range:
        return None
    if settings.frame_start > settings.frame_end:
        raise CannotStylizeError(
            f"the frames {settings.frame_start} to {settings.frame_end} are none: expected a first and a last frame"
        )
    return settings.frame_start, settings.frame_end


def shot_of(
    context: bpy.types.Context,
    settings: bpy.types.PropertyGroup,
    smoke: Smoke,
    take: Take,
    files: Path,
    weights: str,
) -> tuple[Shot, tuple[str, ...]]:
    """The shot of a take; goes through its frames if anything changes in them, and comes back to the current one.

    Args:
        context: of Blender.
        settings: of the smoke's object.
        smoke: that is stylized.
        take: which part of the timeline.
        files: folder for its cameras and masks.
        weights: of the network for pictures and channels; empty for those that are found.

    Returns:
        The shot, and what the artist should know of it before it is run.

    Raises:
        CannotStylizeError: something is missing, or cannot be used.
        OSError: a file cannot be written.
    """
    if not settings.looks:
        wanted = "choose what the smoke is to look like: press + under Look"
        raise CannotStylizeError("; ".join((wanted, *note_of_library(settings.id_data))))
    goals = [_goal(look) for look in settings.looks]
    if take.name and smoke.playback is not None and smoke.playback.mode != "CLIP":
        raise CannotStylizeError("markers: shots of a sequence that is played again are the same: set its Mode to Clip")
    numbers = frames_between(smoke, take.bounds)
    placed = [
        None if look.region is None else Region(look.region, look.edge, smoke, files / f"region_{index + 1}")
        for index, look in enumerate(settings.looks)
    ]
    camera, notes = None, ()
    current = context.scene.frame_current
    try:
        tables = _through_frames(context, settings, smoke, take, numbers, [region for region in placed if region])
        if tables:
            camera = _write(cameras_of(tables), files / "cameras.json")
            notes = _of_what_is_seen(settings.id_data, smoke, numbers, tables, take)
        masks = [() if region is None else (region.mask(),) for region in placed]
    finally:
        if context.scene.frame_current != current:
            context.scene.frame_set(current)
    regions = ()
    if any(masks) or any(look.weight != 1.0 for look in settings.looks):
        regions = tuple(
            commands.Region(goal, mask, look.weight)
            for goal, mask, look in zip(goals, masks, settings.looks, strict=True)
        )
    shot = Shot(
        goals=() if regions else tuple(goals),
        regions=regions,
        quality=settings.quality,
        frames=(numbers[0], numbers[-1]) if numbers else None,
        camera=camera,
        voxel_size=smoke.voxel_size,
        keys=_keys(context.scene, settings, len(numbers), any(masks), weights),
    )
    return shot, notes


def _goal(look: bpy.types.PropertyGroup) -> Goal:
    if look.goal == "MOTIF":
        return Goal("tag", look.motif)
    key, text = ("style", look.picture) if look.goal == "PICTURE" else ("semantic", look.channel)
    if not text.strip():
        raise CannotStylizeError(f"Look: choose a {'picture' if key == 'style' else 'channel, as LAYER:NUMBER'}")
    return Goal(key, bpy.path.abspath(text) if text.startswith("//") else text.strip())


def _through_frames(
    context: bpy.types.Context,
    settings: bpy.types.PropertyGroup,
    smoke: Smoke,
    take: Take,
    numbers: Sequence[int],
    regions: Sequence[Region],
) -> dict[str, dict[str, Any]]:
    """Let regions take note of each frame, and return the tables of its cameras, if they count."""
    _require_even(smoke, settings, regions)
    scene, item, tables = context.scene, settings.id_data, {}
    cameras = _cameras(scene, take) if settings.use_camera else set()
    frames = [number - smoke.shift for number in numbers] or [scene.frame_current]
    watched = [item, *cameras, *(region.item for region in regions)]
    if len(cameras) < 2 and not may_move(watched, scene) and not any(may_change_shape(each.item) for each in regions):
        frames = frames[:1]
    there, manager = item.matrix_world.copy(), context.window_manager
    manager.progress_begin(0, len(frames))
    try:
        for done, frame in enumerate(frames):
            manager.progress_update(done)
            if len(frames) > 1:
                scene.frame_set(frame)
            graph = context.evaluated_depsgraph_get()
            # Keyframes may move the smoke, too.
            now = replace(smoke, space=item.evaluated_get(graph).matrix_world @ there.inverted() @ smoke.space)
            _require_even(now, settings, regions)
            for region in regions:
                region.record(frame + smoke.shift, graph, now.space)
            if settings.use_camera:
                tables[str(frame + smoke.shift)] = _camera(take.camera or scene.camera, scene, graph, now.space)
    finally:
        manager.progress_end()
    return tables


def _require_even(smoke: Smoke, settings: bpy.types.PropertyGroup, regions: Sequence[Region]) -> None:
    """Require that cameras and regions can be brought into the space of the smoke, if there are any."""
    if regions:
        smoke.require_even("regions")
    if settings.use_camera:
        smoke.require_even("the camera")
        smoke.require_unmirrored()


def _cameras(scene: bpy.types.Scene, take: Take) -> set[bpy.types.Object]:
    """The cameras that a take may be seen through.

    Raises:
        CannotStylizeError: there are none.
    """
    of_markers = {marker.camera for marker in scene.timeline_markers}
    cameras = ({take.camera} if take.camera else of_markers | {scene.camera}) - {None}
    if not cameras:
        raise CannotStylizeError("the scene has no camera: add one, or switch Camera off")
    return cameras


def _camera(
    camera: bpy.types.Object | None, scene: bpy.types.Scene, graph: bpy.types.Depsgraph, space: Matrix
) -> dict[str, Any]:
    """The table of a camera in the space of the smoke."""
    if camera is None:
        raise CannotStylizeError(
            f"the scene has no camera in frame {scene.frame_current}: add one, or switch Camera off"
        )
    try:
        return camera_table(camera, scene, graph, space)
    except UnusableCameraError as error:
        raise CannotStylizeError(str(error)) from None


def _of_what_is_seen(
    item: bpy.types.Object,
    smoke: Smoke,
    numbers: Sequence[int],
    tables: Mapping[str, dict[str, Any]],
    take: Take,
) -> tuple[str, ...]:
    """A note if the cameras see the smoke in no frame."""
    still = next(iter(tables.values()))
    if any(may_see(tables.get(str(number), still), corners_at(item, smoke, number)) for number in numbers or [None]):
        return ()
    of = f" of {take.name}" if take.name else ""
    return (
        f"the camera{of} does not see the smoke of {item.name} in any frame: nothing leads the stylization there; turn "
        "it to the smoke, or switch Camera off",
    )


def _keys(
    scene: bpy.types.Scene, settings: bpy.types.PropertyGroup, frames: int, masks: bool, weights: str
) -> dict[str, Any]:
    """The other keys of the recipe."""
    keys: dict[str, Any] = dict(BASIS)
    rate = scene.render.fps / scene.render.fps_base
    if rate <= FASTEST:
        keys["fps"] = round(rate, 6)
    if weights:
        keys["weights"] = bpy.path.abspath(weights)
    if any(look.goal == "MOTIF" for look in settings.looks):
        keys |= MOTIFS
    if settings.steady and frames > 1:
        keys |= STEADY
    if settings.strength != 1.0:
        keys["strength"] = round(settings.strength, 4)
    if masks:
        # Files of masks are for the whole grid.
        keys["crop"] = False
    return keys | keys_of(settings.overrides)


def _write(content: dict[str, Any], file: Path) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(content, indent=1) + "\n", "utf-8")
    return file
