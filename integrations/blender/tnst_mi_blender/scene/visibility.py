"""Originals are hidden where their results are shown: in all frames, or in those alone that were stylized.

The latter is done by drivers, which leave an artist's keyframes alone, and need no leave to run scripts: Blender
computes such expressions itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import bpy

from ..versions import animated_paths
from .playback import Playback
from .smoke import Smoke, numbers_in

#: What hides an object.
_HIDING = ("hide_viewport", "hide_render")

#: The expression of drivers that are from here.
_TIME = "frame"


def results_of(original: bpy.types.Object) -> Iterator[bpy.types.Object]:
    """The results of an object that are shown."""
    return (item for item in bpy.data.objects if item.type == "VOLUME" and item.tnst_mi.original == original)


def hide_other_parts(original: bpy.types.Object, parts: Sequence[str]) -> None:
    """Hide the results of an object that are of other parts: of shots, or of all frames, in the same place."""
    for result in results_of(original):
        if result.tnst_mi.part not in parts:
            result.hide_render = result.hide_viewport = True


def hide_in_frames_of_results(original: bpy.types.Object, smoke: Smoke, place: str) -> tuple[str, ...]:
    """Hide an original in the frames of its results where they are in its place, and show it in all others.

    If all of its frames were stylized, it is just hidden, as artists hide it, who can show it by a click. An artist's
    own keyframes and drivers stay, and so does what was hidden by hand.

    Args:
        original: that was stylized.
        smoke: of it.
        place: "IN_PLACE", or "BESIDE", where it is shown in all frames.

    Returns:
        A note if it cannot be hidden so.
    """
    show_always(original)
    if place != "IN_PLACE":
        return ()
    if animated_paths(original) & set(_HIDING) or any(_driver(original, path) for path in _HIDING):
        return (
            f"{original.name}: when it is hidden is animated, and was left so: hide it by that animation where its "
            "result is shown, or choose Show Beside",
        )
    numbers = _numbers_of_results(original)
    if numbers >= set(smoke.numbers):
        original.tnst_mi.hidden = {path for path in _HIDING if not getattr(original, path)}
        for path in original.tnst_mi.hidden:
            setattr(original, path, True)
        return ()
    if not _keeps_drivers(original):
        return (
            f"{original.name} belongs to another file: Blender does not keep there that it is hidden in the frames "
            "of its result alone, so it is seen in all of them: stylize all frames, or make it local "
            "(Object > Relations > Make Local)",
        )
    playback = smoke.playback or Playback(
        smoke.numbers[0] - smoke.shift, smoke.numbers[0] - 1, smoke.numbers[-1] - smoke.numbers[0] + 1
    )
    for path in _HIDING:
        if not getattr(original, path):
            _drive(original, path, playback.steps(numbers), playback.period is not None)
    return ()


def show_always(original: bpy.types.Object) -> None:
    """Show an original in all frames, but for what its artist has hidden."""
    hidden = set(original.tnst_mi.hidden)
    for path in _HIDING:
        if _is_ours(_driver(original, path)):
            original.driver_remove(path)
            hidden.add(path)
    for path in hidden:
        setattr(original, path, False)
    original.tnst_mi.hidden = set()


def _keeps_drivers(original: bpy.types.Object) -> bool:
    """Whether drivers of an object are saved: not if it is linked, or an override of one that has any animation."""
    override = original.override_library
    return original.library is None and (override is None or override.reference.animation_data is None)


def _numbers_of_results(original: bpy.types.Object) -> set[int]:
    """The numbers of the files of those results that are not hidden."""
    shown = [result for result in results_of(original) if not (result.hide_render and result.hide_viewport)]
    folders = {Path(bpy.path.abspath(result.data.filepath, library=result.library)).parent for result in shown}
    return {number for folder in folders for number in numbers_in(folder, r".*?(\d+)\D*\.vdb")}


def _drive(original: bpy.types.Object, path: str, steps: Sequence[tuple[int, bool]], again: bool) -> None:
    """Let a driver set a property by steps, over and over if they are a period.

    Its value is the time, which its own curve makes a step of: expressions have no room for many frames.
    """
    curve = original.driver_add(path)
    curve.driver.type, curve.driver.expression = "SCRIPTED", _TIME
    for modifier in list(curve.modifiers):
        curve.modifiers.remove(modifier)
    for point in reversed(list(curve.keyframe_points)):
        curve.keyframe_points.remove(point)
    curve.keyframe_points.add(len(steps))
    for point, (frame, on) in zip(curve.keyframe_points, steps, strict=True):
        point.co, point.interpolation = (frame, on), "CONSTANT"
    if again:
        curve.modifiers.new("CYCLES")
    curve.update()


def _is_ours(curve: bpy.types.FCurve | None) -> bool:
    """Whether a driver is from here: one of the time alone, and of steps."""
    if curve is None or curve.driver.expression != _TIME or not len(curve.keyframe_points):
        return False
    return all(point.interpolation == "CONSTANT" and point.co.y in (0, 1) for point in curve.keyframe_points)


def _driver(original: bpy.types.Object, path: str) -> bpy.types.FCurve | None:
    animation = original.animation_data
    return None if animation is None else animation.drivers.find(path)
