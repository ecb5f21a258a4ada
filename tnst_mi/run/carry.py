"""The grids of a frame that move with its smoke: which the recipe chooses, where they come from, and moved."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.geometry.other_grids import OtherGrid, OtherGrids
from tnst_mi.io.formats import held
from tnst_mi.io.grids.vdb.other_grids import stored_velocity
from tnst_mi.io.interpretation.grid_names import is_colour
from tnst_mi.io.pictures.srgb import linear_of
from tnst_mi.machine.terminal import quoted, some_of
from tnst_mi.optimisation.movement import Movement
from tnst_mi.optimisation.result import Stylized
from tnst_mi.rendering.smoke_colour import colour_name
from tnst_mi.run.inputs import changed, grid_digest

#: The name in `carry` and in records of the simulation's velocity, whatever its file calls it.
VELOCITY = "velocity"

_SHOWN = 6


@dataclass(frozen=True)
class Carried:
    """What moves with the smoke of a frame.

    Attributes:
        grids: the other grids, and in files of the format of their source the grids of the velocity.
        read_velocity: gives the velocity, (D, H, W, 3) in cells per frame, where it is none of these; else None.
        names: of all, with `VELOCITY` for this one.
    """

    grids: OtherGrids
    read_velocity: Callable[[], OtherGrid] | None
    names: tuple[str, ...]

    @property
    def velocity(self) -> np.ndarray | None:
        """What `read_velocity` gives."""
        return None if self.read_velocity is None else self.read_velocity().values

    def in_memory(self) -> dict[str, np.ndarray]:
        """All of it, by name."""
        velocity = self.velocity
        return dict(self.grids) | ({} if velocity is None else {VELOCITY: velocity})


def movable(frame: Frame) -> list[str]:
    """The names of what can move with the smoke of a frame; a velocity in another file than the density stays there."""
    has_velocity = frame.velocity is not None and stored_velocity(frame.placement) != {}
    return [*frame.grids, *([VELOCITY] if has_velocity else [])]


def chosen(carry: str, names: Iterable[str]) -> list[str]:
    """The names that a recipe's key `carry` chooses: all of them, none, or those it lists.

    Example:
        >>> from tnst_mi.run.carry import chosen
        >>> chosen("flame, heat", ["temperature", "flame"]), chosen("none", ["flame"])
        (['flame'], [])
    """
    return [name for name in names if carry == "all" or name in _listed(carry)]


def with_colour(names: Sequence[str], colour: str | None) -> list[str]:
    """Some names, and that of the grid of optimised colours, if there is one, in the place of the colours that they are
    made from.
    """
    if colour is None:
        return list(names)
    own = colour_name(names)
    return [*(name for name in names if name not in (own, colour)), colour]


def require_there(carry: str, names: Iterable[str]) -> None:
    """Check that `carry` lists nothing that no frame has.

    Raises:
        InputError: it does; the message says what is there.
    """
    known = list(dict.fromkeys(names))
    unknown = [name for name in _listed(carry) if name not in known]
    if unknown:
        there = some_of([repr(name) for name in known], _SHOWN) or "none"
        raise InputError(f"carry = {carry!r}: no grid {unknown[0]!r} beside the density, those found are: {there}")


def read_chosen(frame: Frame, carry: str) -> Iterable[tuple[str, np.ndarray]]:
    """The other grids of a frame that `carry` chooses, one after the other.

    Raises:
        InputError: one cannot be used.
    """
    for name in chosen(carry, frame.grids):
        yield name, frame.grids[name]


def carried(
    frame: Frame,
    stylized: Stylized,
    carry: str,
    suffix: str | None = None,
    digests: Mapping[str, str] | None = None,
) -> Carried:
    """What moves with the smoke of a frame, moved: each when it is asked for.

    Args:
        frame: the input.
        stylized: its result.
        carry: the recipe's key.
        suffix: of the files that hold it; None for memory.
        digests: SHA-256 of its other grids when they were measured, see `grid_digest`, by name. Reading one that has
            changed raises InputError.
    """
    names, movement = chosen(carry, movable(frame)), stylized.movement
    own_colour = None if stylized.colour is None else stylized.colour_grid
    names = with_colour(names, own_colour)
    if suffix is not None:
        names = held(frame.name, suffix, names)
    readers = {
        name: partial(_unchanged, frame, name, (digests or {}).get(name))
        for name in frame.other_grids.readers
        if name in names and name != own_colour
    }
    read_velocity = None
    if VELOCITY in names and frame.velocity is not None:
        own = stored_velocity(frame.placement) if suffix == ".vdb" else None
        if own is None:
            read_velocity = partial(_moved, partial(OtherGrid, frame.velocity), movement)
        else:
            readers |= own
    shown = movement is not None and movement.shows_colours
    moved = {name: partial(_moved, reader, movement, shown and is_colour(name)) for name, reader in readers.items()}
    if own_colour in names and stylized.colour is not None:
        moved[own_colour] = partial(OtherGrid, linear_of(stylized.colour))
    return Carried(OtherGrids(moved, frame.density.shape, frame.name), read_velocity, tuple(names))


def _listed(carry: str) -> list[str]:
    return [] if carry in ("all", "none") else [name.strip() for name in carry.split(",")]


def _unchanged(frame: Frame, name: str, digest: str | None) -> OtherGrid:
    """A grid beside the density, which is what it was when it had this digest.

    Raises:
        InputError: it is not, or cannot be used.
    """
    grid = frame.other_grids.read(name)
    if digest is not None and grid_digest(grid.values) != digest:
        raise InputError(changed(f"{frame.name}: grid {quoted(name)}"))
    return grid


def _moved(read: Callable[[], OtherGrid], movement: Movement | None, of_colour: bool = False) -> OtherGrid:
    grid = read()
    return grid if movement is None else replace(grid, values=movement.carried(grid, of_colour))
