"""Originals are hidden where their results are shown: in all frames, or in those alone that were stylized.

The latter is done by drivers, which leave an artist's keyframes alone, and need no leave to run scripts: Blender
computes such expressions itself.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import bpy

from ..versions import animated_paths
from .smoke import Smoke

#: What hides an object.
_HIDING = ("hide_viewport", "hide_render")

#: The expressions of drivers that are from here.
_RANGE = r"frame >= -?\d+ and frame <= -?\d+"
_OURS = re.compile(rf"{_RANGE}( or {_RANGE})*")


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

    If all of its frames were stylized, it is just hidden, as artists hide it, who can show it by a click.

    Args:
        original: that was stylized.
        smoke: of it.
        place: "IN_PLACE", or "BESIDE", where it is shown in all frames.

    Returns:
        A note if it was left as it is, since keyframes or drivers of the artist say when it is hidden.
    """
    if _is_animated(original):
        return (
            f"{original.name}: when it is hidden is animated, and was left so: hide it by that animation where its "
            "result is shown, or choose Show Beside",
        )
    show_always(original)
    if place != "IN_PLACE":
        return ()
    ranges = _frames_of_results(original)
    frames = {number - smoke.shift for number in smoke.numbers}
    covered = ranges is None or all(any(first <= frame <= last for first, last in ranges) for frame in frames)
    # Blender does not let what belongs to another file have drivers.
    if covered or original.library is not None:
        for path in _HIDING:
            setattr(original, path, True)
        return ()
    for path in _HIDING:
        driver = original.driver_add(path).driver
        driver.type = "SCRIPTED"
        driver.expression = " or ".join(f"frame >= {first} and frame <= {last}" for first, last in ranges)
    return ()


def show_always(original: bpy.types.Object) -> None:
    """Show an original in all frames, unless its artist's animation hides it."""
    for path in _HIDING:
        if _driver(original, path) is not None and _is_ours(original, path):
            original.driver_remove(path)
        setattr(original, path, False)


def _frames_of_results(original: bpy.types.Object) -> list[tuple[int, int]] | None:
    """The first and last frames of the results that are not hidden, merged; None where one of them is shown in all."""
    ranges = []
    for result in results_of(original):
        volume = result.data
        if result.hide_render and result.hide_viewport:
            continue
        if not volume.is_sequence or volume.sequence_mode != "CLIP":
            return None
        ranges.append((volume.frame_start, volume.frame_start + volume.frame_duration - 1))
    merged: list[tuple[int, int]] = []
    for first, last in sorted(ranges):
        if merged and first <= merged[-1][1] + 1:
            merged[-1] = (merged[-1][0], max(last, merged[-1][1]))
        else:
            merged.append((first, last))
    return merged


def _is_animated(original: bpy.types.Object) -> bool:
    """Whether its artist has animated when an original is hidden."""
    if animated_paths(original) & set(_HIDING):
        return True
    return any(_driver(original, path) is not None and not _is_ours(original, path) for path in _HIDING)


def _is_ours(original: bpy.types.Object, path: str) -> bool:
    curve = _driver(original, path)
    return curve is not None and _OURS.fullmatch(curve.driver.expression) is not None


def _driver(original: bpy.types.Object, path: str) -> bpy.types.FCurve | None:
    animation = original.animation_data
    return None if animation is None else animation.drivers.find(path)
