"""The colour of a frame's smoke: which of the grids beside its density that is, and its values as linear RGB.

Where there are no colours, temperatures may stand in for them, with those of black bodies.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.arrays import LARGEST
from tnst_mi.frame import Frame
from tnst_mi.io.interpretation.grid_names import is_colour, plain_name
from tnst_mi.io.pictures.srgb import srgb
from tnst_mi.machine.terminal import quoted, some_of
from tnst_mi.rendering.fire import glow_colours

#: Names that say enough by themselves, in order of preference: Houdini's, and Blender's.
_USUAL = ("cd", "color", "colour")

_SHOWN = 6


def colour_name(names: Iterable[str]) -> str | None:
    """The name of the grid of the smoke's colours: Cd, color, or else the first whose name says that it is one.

    Example:
        >>> from tnst_mi.rendering.smoke_colour import colour_name
        >>> colour_name(["flame", "smoke_color", "Cd"]), colour_name(["flame", "emission_color"])
        ('Cd', None)
    """
    found = [name for name in names if is_colour(name) and "emission" not in plain_name(name).split()]
    usual = [name for word in _USUAL for name in found if plain_name(name) == word]
    return next(iter(usual + found), None)


def colours_of(grids: Mapping[str, np.ndarray], name: str, frame: str) -> np.ndarray:
    """A grid of colours as linear RGB, (D, H, W, 3) float32; uint8 and uint16 count as parts of their largest.

    Args:
        grids: of a frame, by name.
        name: of the grid.
        frame: name of the frame, for messages.

    Raises:
        InputError: it is a scalar grid, or has other whole numbers.
    """
    values = grids[name]
    if values.ndim != 4:
        raise InputError(f"{frame}: grid {quoted(name)} has shape {values.shape}, expected colours, {values.shape} × 3")
    if values.dtype.kind == "f":
        return values.astype(np.float32)
    if values.dtype.name not in LARGEST:
        raise InputError(
            f"{frame}: grid {quoted(name)} has colours of {values.dtype}, expected floating-point numbers, linear RGB, "
            "or uint8 or uint16 of which the largest counts as 1"
        )
    return values.astype(np.float32) / np.float32(LARGEST[values.dtype.name])


def are_colours(values: np.ndarray) -> bool:
    """Whether `colours_of` takes the values of a grid."""
    return values.ndim == 4 and (values.dtype.kind == "f" or values.dtype.name in LARGEST)


def shown_colours(
    grids: Mapping[str, np.ndarray],
    name: str | None,
    frame: str,
    cells: tuple[int, ...],
    hottest: float | None = None,
) -> np.ndarray | None:
    """The colours of a grid, (D, H, W, 3), as the pictures of a run show them: display values, of which white is 1.

    The light that smoke gives has no curve in these pictures, so that its colour alone has it. No colour is negative.
    None without a name; frames that lack the grid are white, on `cells` (D, H, W).

    Args:
        grids: of a frame, by name.
        name: of the grid.
        frame: name of the frame, for messages.
        cells: of the frame.
        hottest: where the grid has temperatures, the largest of all frames; None for colours.

    Raises:
        InputError: it has no colours, and no temperatures either.
    """
    if name is None:
        return None
    if name not in grids:
        return np.ones((*cells, 3), np.float32)
    if hottest is None:
        return srgb(np.maximum(colours_of(grids, name, frame), 0))
    if grids[name].ndim != 3:
        raise InputError(f"{frame}: grid {quoted(name)} has shape {grids[name].shape}, expected a temperature")
    return srgb(glow_colours(grids[name].astype(np.float32), hottest))


def own_colours(frame: Frame) -> np.ndarray | None:
    """The colours of the grid of a frame that has some, as `shown_colours` gives them; None if none has."""
    name = colour_name(frame.grids)
    if name is None or frame.grids[name].ndim != 4:
        return None
    return shown_colours(frame.grids, name, frame.name, frame.density.shape)


def shown_grid(names: Sequence[str], temperature: tuple[str, float] | None) -> tuple[str | None, float | None]:
    """The grid of a frame that colours it in pictures of a run, None for grey ones, and `hottest` of `shown_colours`.

    Args:
        names: of the grids that move with the smoke of the frame.
        temperature: the grid whose temperatures are shown in all frames, and their largest; None for colours.
    """
    if temperature is None:
        return colour_name(names), None
    return temperature if temperature[0] in names else (None, None)


def find_colour(frames: Iterable[Frame], choice: str | None) -> str | None:
    """The name of the grid that colours the smoke of frames, if any.

    Args:
        frames: read one after the other, up to the first that has such a grid.
        choice: its name, or "none"; None for the one whose name says that it is one.

    Raises:
        InputError: no frame has the chosen one, or it is a scalar grid.
    """
    if choice == "none":
        return None
    for frame in frames:
        name = colour_name(frame.grids) if choice is None else choice
        if name is not None and name in frame.grids:
            if frame.grids[name].ndim == 3 and choice is None:
                return None
            colours_of(frame.grids, name, frame.name)
            return name
    if choice is not None:
        raise InputError(
            f"--colour {choice}: no frame has such a grid; expected the name of a grid of colours, or none"
        )
    return None


def colour_said(name: str | None) -> list[str]:
    """What commands that light smoke say of the grid that colours it, if any."""
    return [] if name is None else [f"colour: grid {name} times the albedo of the smoke (--colour GRID|none)"]


def require_colour(carried: Iterable[str], there: Iterable[str]) -> str:
    """The name of the grid of colours among those that move with the smoke.

    Args:
        carried: the names of these.
        there: the names of all grids that could.

    Raises:
        InputError: there is none, or it is left behind.
    """
    name, known = colour_name(carried), list(there)
    if name is not None:
        return name
    if (left := colour_name(known)) is not None:
        raise InputError(f"colour = 'keep': the smoke's colour {quoted(left)} is left out by carry; add it there")
    among = some_of([quoted(one) for one in known], _SHOWN) or "none"
    raise InputError(
        "colour = 'keep': no grid of colours, such as Cd or color, nor of temperatures above 0 moves with the smoke, "
        f"those beside the density are: {among}; expected colour = 'off'"
    )
