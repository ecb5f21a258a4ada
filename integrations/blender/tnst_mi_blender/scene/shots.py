"""From the panel's settings to shots, with the cameras and regions that the scene has in each frame."""

from __future__ import annotations

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
from .takes import Take
from .walk import coming_back, evaluated, frame_by_frame

#: What a stylization begins with; that of the bundled recipes. The list Advanced changes it.
BASIS = {"octaves": 2, "views": 3, "eta": 0.004}

#: Towards motifs it takes more, and thin smoke: scenes/by_name.toml.
MOTIFS = {"weights": "patterns", "iterations": 40, "gamma": 0.01}

#: Steady sequences: scenes/smokejet/sequence.toml.
STEADY = {"window": 9, "window_weights": "gaussian", "coherence": 2.5}

#: Frames per second that a recipe can have.
FASTEST = 240.0


@dataclass(frozen=True)
class _Seen:
    """What the scene has to be looked at for, frame by frame.

    Attributes:
        cameras: that smoke is seen through.
        regions: that it is in.
    """

    cameras: set[bpy.types.Object]
    regions: list[Region]

    @property
    def items(self) -> set[bpy.types.Object]:
        """The objects of both."""
        return self.cameras | {region.item for region in self.regions}

    def may_change(self, smoke: bpy.types.Object, scene: bpy.types.Scene) -> bool:
        """Whether it may be another one, or somewhere else on an object with smoke, in other frames."""
        shapes = any(may_change_shape(region.item) for region in self.regions)
        return len(self.cameras) > 1 or shapes or may_move({smoke, *self.items}, scene)


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
    scene, item = context.scene, settings.id_data
    if not settings.looks:
        wanted = "choose what the smoke is to look like: press Choose a Look"
        raise CannotStylizeError("; ".join((wanted, *note_of_library(item))))
    goals = [_goal(look) for look in settings.looks]
    if take.name and smoke.playback is not None and smoke.playback.mode != "CLIP":
        raise CannotStylizeError("markers: shots of a sequence that is played again are the same: set its Mode to Clip")
    numbers = frames_between(smoke, take.bounds)
    placed = [
        None if look.region is None else Region(look.region, look.edge, smoke, files / f"region_{index + 1}")
        for index, look in enumerate(settings.looks)
    ]
    camera, notes, masks = None, (), [() for _look in placed]
    seen = _Seen(
        _cameras(scene, take) if settings.use_camera else set(), [region for region in placed if region is not None]
    )
    if seen.cameras or seen.regions:
        with evaluated({item, *seen.items}, scene), coming_back(scene):
            tables = _through_frames(context, item, smoke, numbers, seen)
            masks = [() if region is None else (region.mask(),) for region in placed]
        if tables:
            camera = _write(cameras_of(tables), files / "cameras.json")
            notes = _of_what_is_seen(item, smoke, numbers, tables, take)
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
        keys=_keys(scene, settings, len(numbers), any(masks), weights),
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
    context: bpy.types.Context, item: bpy.types.Object, smoke: Smoke, numbers: Sequence[int], seen: _Seen
) -> dict[str, dict[str, Any]]:
    """Let regions take note of each frame, and return the tables of its cameras, if they count."""
    scene, tables = context.scene, {}
    frames = [number - smoke.shift for number in numbers] or [scene.frame_current]

    def look(frame: int) -> None:
        graph = context.evaluated_depsgraph_get()
        # Keyframes may move the smoke, too.
        now = replace(smoke, world=item.evaluated_get(graph).matrix_world.copy())
        _require_even(now, seen)
        for region in seen.regions:
            region.record(frame + smoke.shift, graph, now.space)
        if seen.cameras:
            # Of several, which are those of markers, Blender takes the frame's own.
            camera = scene.camera if len(seen.cameras) > 1 else next(iter(seen.cameras))
            tables[str(frame + smoke.shift)] = _table(camera, scene, graph, now.space)

    if seen.may_change(item, scene):
        _require_no_stretching(scene)
        with frame_by_frame(context, frames) as each:
            for frame in each:
                look(frame)
    else:
        look(frames[0])
    return tables


def _require_no_stretching(scene: bpy.types.Scene) -> None:
    """Require that each frame of the scene is one of the smoke.

    Raises:
        CannotStylizeError: time is stretched: a frame of the smoke is shown in several, or in none.
    """
    old, new = scene.render.frame_map_old, scene.render.frame_map_new
    if old != new:
        raise CannotStylizeError(
            f"what moves cannot be followed in a scene whose time is stretched, Old {old} to New {new}: make both the "
            "same (Output properties > Frame Range > Time Stretching), or switch Camera off and choose no Region"
        )


def _require_even(smoke: Smoke, seen: _Seen) -> None:
    """Require that cameras and regions can be brought into the space of the smoke, if there are any."""
    if seen.regions:
        smoke.require_even("regions")
    if seen.cameras:
        smoke.require_even("the camera")
        smoke.require_unmirrored()


def _cameras(scene: bpy.types.Scene, take: Take) -> set[bpy.types.Object]:
    """The cameras that a take is seen through, one or more.

    As Blender does, the scene's own counts only if no marker has any that is not disabled in renders.

    Raises:
        CannotStylizeError: there are none.
    """
    of_markers = {marker.camera for marker in scene.timeline_markers if marker.camera and not marker.camera.hide_render}
    cameras = ({take.camera} if take.camera else of_markers or {scene.camera}) - {None}
    if not cameras:
        raise CannotStylizeError("the scene has no camera: add one, or switch Camera off")
    return cameras


def _table(
    camera: bpy.types.Object, scene: bpy.types.Scene, graph: bpy.types.Depsgraph, space: Matrix
) -> dict[str, Any]:
    """The table of a camera in the space of the smoke."""
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
