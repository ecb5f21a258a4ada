"""The parts of the timeline that are stylized by themselves: all of it, a range of frames, or the shots of markers."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import bpy

from ..problems import CannotStylizeError
from .smoke import Smoke, shown_between


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
        if not smoke.numbers or shown_between(smoke, take.bounds):
            found.append(take)
        else:
            notes.append(f"{take.name}: skipped, there is no smoke in its frames {take.bounds[0]} to {take.bounds[1]}")
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
