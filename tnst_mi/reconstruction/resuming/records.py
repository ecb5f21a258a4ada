"""What is known of each frame that is done: names of its files, and the keys that a state has to have of it."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from pathlib import PurePosixPath
from typing import Any

#: Keys whose values are numbers, not negative. Of scattered light there is no brightness.
_NUMBERS = ("gamma", "background", "peak", "noise", "mass", "largest_density", "seconds")

#: Those of a velocity, and of an estimated one besides.
_OF_VELOCITIES, _OF_ESTIMATES = ("largest", "mean_in_smoke"), ("rms", "seconds")


def frame_name(number: int | None) -> str:
    """The name of a frame, with which those of all its files begin.

    Example:
        >>> frame_name(49)
        'smoke_0049'
    """
    return "smoke" if number is None else f"smoke_{number:04d}"


def density_file(number: int | None, format: str) -> PurePosixPath:
    """The file of a frame's density in the folder of the results."""
    return PurePosixPath("density") / f"{frame_name(number)}.{format}"


def require_sound_record(record: Any, number: int | None, format: str, judges: Collection[str]) -> None:
    """Check that a record has all that is read from it, and nothing that it cannot have.

    Args:
        record: what a file says.
        number: of the frame whose record it should be.
        format: of its density.
        judges: names of the views that were held out.

    Raises:
        KeyError, TypeError, ValueError: it lacks something, or has something else.
    """
    _require(isinstance(record, dict) and record["finished"] is True)
    _require(record["name"] == frame_name(number) and record["number"] == number)
    _require(record["density"] == str(density_file(number, format)))
    _require(all(_is_number(record[key]) for key in _NUMBERS) and record["gamma"] > 0 and record["peak"] > 0)
    _require(record["brightness"] is None or (_is_number(record["brightness"]) and record["brightness"] > 0))
    views, colour = record["psnr_of_views"], record["mean_colour"]
    _require(isinstance(views, dict) and set(views) <= set(judges))
    _require(isinstance(record["masked_views"], list) and set(record["masked_views"]) <= set(judges))
    # A PSNR may be negative, and there is none of images that are the same.
    _require(all(value is None or _is_finite(value) for value in (record["psnr"], *views.values())))
    _require(colour is None or (isinstance(colour, list) and len(colour) == 3 and all(map(_is_number, colour))))
    for level in record["convergence"]:
        _require(isinstance(level["steps"], int) and all(map(_is_number, level["rms"])))
        _require(len(level["rms"]) <= level["steps"])
    if (velocity := record.get("velocity")) is not None:
        _require_sound_velocity(velocity)


def _require_sound_velocity(velocity: Mapping[str, Any]) -> None:
    _require(velocity["source"] in ("known", "estimated"))
    keys = (*_OF_VELOCITIES, *(_OF_ESTIMATES if velocity["source"] == "estimated" else ()))
    _require(all(_is_number(velocity[key]) for key in keys))


def _is_finite(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_number(value: Any) -> bool:
    return _is_finite(value) and value >= 0


def _require(sound: bool) -> None:
    if not sound:
        raise ValueError("not what a record has")
