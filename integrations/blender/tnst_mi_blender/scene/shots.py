"""From the panel's settings to shots, with the cameras and regions that the scene has in each frame."""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from ..export_camera import UnusableCameraError, camera_table, cameras_of
from ..problems import CannotStylizeError
from ..recipes import commands
from ..recipes.advanced import keys_of
from ..recipes.commands import Goal, Shot
from .regions import Region
from .smoke import Smoke, frames_between

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
) -> Shot:
    """The shot of a take; goes through its frames, and comes back to the current one.

    Args:
        context: of Blender.
        settings: of the smoke's object.
        smoke: that is stylized.
        take: which part of the timeline.
        files: folder for its cameras and masks.
        weights: of the network for pictures and channels; empty for those that are found.

    Raises:
        CannotStylizeError: something is missing, or cannot be used.
        OSError: a file cannot be written.
    """
    if not settings.looks:
        raise CannotStylizeError("choose what the smoke is to look like: press + under Look")
    goals = [_goal(look) for look in settings.looks]
    if take.name and smoke.playback is not None and smoke.playback.mode != "CLIP":
        raise CannotStylizeError("markers: shots of a sequence that is played again are the same: set its Mode to Clip")
    numbers = frames_between(smoke, take.bounds)
    placed = [
        None if look.region is None else Region(look.region, look.edge, smoke, files / f"region_{index + 1}")
        for index, look in enumerate(settings.looks)
    ]
    camera = None
    current = context.scene.frame_current
    try:
        tables = _through_frames(context, settings, smoke, take, numbers, [region for region in placed if region])
        if tables:
            camera = _write(cameras_of(tables), files / "cameras.json")
        masks = [() if region is None else (region.mask(),) for region in placed]
    finally:
        context.scene.frame_set(current)
    regions = ()
    if any(masks) or any(look.weight != 1.0 for look in settings.looks):
        regions = tuple(
            commands.Region(goal, mask, look.weight)
            for goal, mask, look in zip(goals, masks, settings.looks, strict=True)
        )
    return Shot(
        goals=() if regions else tuple(goals),
        regions=regions,
        quality=settings.quality,
        frames=(numbers[0], numbers[-1]) if numbers else None,
        camera=camera,
        voxel_size=smoke.voxel_size,
        keys=_keys(context.scene, settings, len(numbers), any(masks), weights),
    )


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
    if regions:
        smoke.require_even("regions")
    if settings.use_camera:
        smoke.require_even("the camera")
        smoke.require_unmirrored()
    scene, tables = context.scene, {}
    for number in numbers or (scene.frame_current + smoke.shift,):
        if settings.use_camera or regions:
            scene.frame_set(number - smoke.shift)
        graph = context.evaluated_depsgraph_get()
        for region in regions:
            region.record(number, graph)
        if not settings.use_camera:
            continue
        camera = take.camera or scene.camera
        if camera is None:
            raise CannotStylizeError("the scene has no camera: add one, or switch Camera off")
        try:
            tables[str(number)] = camera_table(camera, scene, graph, smoke.space)
        except UnusableCameraError as error:
            raise CannotStylizeError(str(error)) from None
    return tables


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
