"""Going through frames of the scene, in which what is hidden is evaluated, too; and coming back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

import bpy


@contextmanager
def evaluated(items: Iterable[bpy.types.Object], scene: bpy.types.Scene) -> Iterator[None]:
    """Let Blender evaluate objects also if they are hidden in viewports, or in collections that are excluded.

    It leaves these as they were in some earlier frame, unless something that is shown is attached to them. So something
    is attached to each of them meanwhile: an empty, or a camera with the same data.
    """
    attached = []
    try:
        for item in items:
            data = item.data if item.type == "CAMERA" else None
            attached.append(bpy.data.objects.new("tnst_mi evaluated", data))
            attached[-1].parent = item
            scene.collection.objects.link(attached[-1])
        yield
    finally:
        for each in attached:
            bpy.data.objects.remove(each)


@contextmanager
def coming_back(scene: bpy.types.Scene) -> Iterator[None]:
    """Let the scene be in its current frame again in the end."""
    before = scene.frame_current, scene.frame_subframe
    try:
        yield
    finally:
        if (scene.frame_current, scene.frame_subframe) != before:
            scene.frame_set(before[0], subframe=before[1])


@contextmanager
def frame_by_frame(context: bpy.types.Context, frames: Sequence[int]) -> Iterator[Iterator[int]]:
    """Frames, one after the other, with the scene in each of them, and Blender's progress at the cursor."""

    def each() -> Iterator[int]:
        for done, frame in enumerate(frames):
            manager.progress_update(done)
            context.scene.frame_set(frame)
            yield frame

    manager = context.window_manager
    manager.progress_begin(0, len(frames))
    try:
        yield each()
    finally:
        manager.progress_end()
