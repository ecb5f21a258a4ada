"""Which of the grids or arrays of a file are the density, the velocity and the obstacle of a frame.

The names decide (`tnst_mi.io.interpretation.grid_names`). What is not called by a usual name is never taken silently:
the user names it, by `--density NAME` and the like.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tnst_mi.errors import InputError
from tnst_mi.io.interpretation import grid_names
from tnst_mi.machine.terminal import quoted

#: In place of a name: the role stays empty, whatever the file holds.
NONE = "none"

# Names of lone arrays: those that numpy gives by itself, PhiFlow's, and that of the data of the paper's authors.
_UNNAMED = re.compile(r"(arr_\d+|data|x)$")

_Indices = tuple[int, ...]


@dataclass(frozen=True)
class Entry:
    """A grid or array, as its file describes it.

    Attributes:
        name: may be empty; several may share one.
        scalar: whether it can be a grid of numbers.
        vector: whether it can be a grid of vectors.
        kind: what it holds, in words, such as "float" or "bool".
        plane: whether it is one cell thick along z.
    """

    name: str
    scalar: bool
    vector: bool
    kind: str
    plane: bool = False


@dataclass(frozen=True)
class Wanted:
    """Names that the user gives for the roles; None leaves the choice to us, `NONE` leaves the role empty.

    Attributes:
        density: name of a grid.
        velocity: name of a grid of vectors, what the names of three scalar grids have in common, or all their names
            separated by commas.
        obstacle: name of a grid.
        alone: whether a single grid is read, by the name of `density`, for another purpose than a density: it has to be
            there, and messages do not speak of the flags that choose the parts of a frame.
    """

    density: str | None = None
    velocity: str | None = None
    obstacle: str | None = None
    alone: bool = False


@dataclass(frozen=True)
class Roles:
    """The entries chosen for each role, by their places in the file.

    Attributes:
        density: one, several of one name that together are the density, or none.
        velocity: the same, or two or three scalar ones, one for each axis.
        obstacle: as the density.
        left: all others.
        lacking: why there is no density; empty if there is one.
        like_velocity: where there is no velocity, those of `left` that may be one by another name.
    """

    density: _Indices
    velocity: _Indices
    obstacle: _Indices
    left: _Indices
    lacking: str = ""
    like_velocity: _Indices = ()


def chosen_roles(entries: Sequence[Entry], wanted: Wanted, noun: str = "grid") -> Roles:
    """Choose the entries of a file for the roles of a frame.

    Args:
        entries: all of them, in the order of the file.
        wanted: the user's own choice.
        noun: what an entry is called, "grid" or "array".

    Raises:
        InputError: several could be meant, a name that the user gives is not there, what is called by the name of a
            role holds no numbers, or there is nothing that could be read alone. The message does not name the file.

    Example:
        >>> from tnst_mi.io.interpretation.roles import Entry, Wanted, chosen_roles
        >>> names = ("Density", "vel.x", "vel.y", "vel.z", "temperature")
        >>> entries = [Entry(name, True, False, "float") for name in names]
        >>> chosen_roles(entries, Wanted())
        Roles(density=(0,), velocity=(1, 2, 3), obstacle=(), left=(4,), lacking='', like_velocity=())
        >>> chosen_roles(entries[4:], Wanted()).lacking
        "no grid 'density', the grids found are: 'temperature'; choose with --density NAME"
    """
    choice = _Choice(entries, noun, wanted.alone)
    density, lacking = choice.density(wanted.density)
    if wanted.alone and lacking:
        raise InputError(lacking)
    # A frame without smoke may lack its other grids too.
    velocity = choice.velocity(wanted.velocity, required=not lacking)
    obstacle = choice.obstacle(wanted.obstacle, required=not lacking)
    left = tuple(index for index in range(len(entries)) if index not in {*density, *velocity, *obstacle})
    like_velocity = () if velocity or wanted.velocity is not None else choice.like_velocity(left)
    return Roles(density, velocity, obstacle, left, lacking, like_velocity)


class _Choice:
    """The choice among the entries of one file."""

    def __init__(self, entries: Sequence[Entry], noun: str, alone: bool) -> None:
        self._entries, self._noun, self._alone = entries, noun, alone
        self._all = tuple(range(len(entries)))

    def density(self, wanted: str | None) -> tuple[_Indices, str]:
        """The entries of the density, and why there are none."""
        if wanted is not None:
            found = self._wanted("density", wanted)
            lacking = self._absent("density", wanted)
        else:
            found = self._called("density", grid_names.DENSITY)
            found = found or self._partly("density", grid_names.is_partly_density, lambda entry: entry.scalar)
            found = found or self._unnamed(lambda entry: entry.scalar)
            expected = "grid 'density'" if self._noun == "grid" else "array 'density' (or 'x')"
            lacking = f"no {expected}, the {self._noun}s found are: {self._names(self._all)}"
            nameless = " ('' for the nameless one)" if any(not entry.name for entry in self._entries) else ""
            lacking += (
                f"; choose with {self._flag('density')}{nameless}" if any(e.scalar for e in self._entries) else ""
            )
            if len(self._all) == 1 and self._unnamed(lambda entry: entry.vector and not entry.scalar):
                lacking = "holds vectors, expected a density"
        self._require("density", found)
        return found, "" if found else lacking

    def velocity(self, wanted: str | None, required: bool) -> _Indices:
        """The entry of the velocity, or those of its components."""
        if wanted is not None:
            found = self._wanted_velocity(wanted)
            if not found and required and wanted != NONE:
                raise InputError(self._absent("velocity", wanted))
            return found
        found = self._called("velocity", grid_names.VELOCITY, lambda entry: entry.vector)
        if not found and (components := self._components(None)):
            return components
        found = found or self._partly("velocity", grid_names.is_partly_velocity, lambda entry: entry.vector)
        found = found or self._unnamed(lambda entry: entry.vector and not entry.scalar)
        # What is called so but has other values is refused where it is read, rather than dropped.
        return found or self._called("velocity", ("velocity",))

    def like_velocity(self, left: _Indices) -> _Indices:
        """Those of some entries that are vectors and not said to be something else than a velocity."""
        return tuple(
            index
            for index in left
            if self._entries[index].vector and (self._entries[index].plane or not self._entries[index].scalar)
            if grid_names.may_be_velocity(self._entries[index].name)
        )

    def obstacle(self, wanted: str | None, required: bool) -> _Indices:
        """The entry of the obstacle."""
        if wanted is None:
            found = self._called("obstacle", grid_names.OBSTACLE, lambda entry: entry.scalar)
        else:
            found = self._wanted("obstacle", wanted)
            if not found and required and wanted != NONE:
                raise InputError(self._absent("obstacle", wanted))
        self._require("obstacle", found)
        return found

    def _called(self, role: str, names: Sequence[str], fits: Callable[[Entry], bool] = lambda entry: True) -> _Indices:
        """The entries with the first of some names that is there, preferably spelt just so."""
        fitting = [index for index in self._all if fits(self._entries[index])]
        for name in names:
            for spelling in (str, grid_names.plain_name):
                if found := tuple(index for index in fitting if spelling(self._entries[index].name) == name):
                    return self._one_name(role, found)
        return ()

    def _partly(self, role: str, says: Callable[[str], bool], fits: Callable[[Entry], bool]) -> _Indices:
        found = [index for index in self._all if fits(self._entries[index]) and says(self._entries[index].name)]
        return self._one_name(role, tuple(found))

    def _unnamed(self, fits: Callable[[Entry], bool]) -> _Indices:
        """The only array that fits and has no name of its own; none if there are several."""
        if self._noun == "grid":
            return ()
        found = [index for index in self._all if _UNNAMED.match(self._entries[index].name)]
        found = [index for index in found if fits(self._entries[index])]
        return tuple(found) if len(found) == 1 else ()

    def _components(self, vector: str | None) -> _Indices:
        """The scalar entries that are the components of a vector: the one of that name, or that of a velocity."""
        vectors: dict[str, list[list[int]]] = {}
        for index in self._all:
            part = grid_names.component(self._entries[index].name, vector)
            if part and self._entries[index].scalar:
                vectors.setdefault(part[0], [[], [], []])[part[1]].append(index)
        for name in sorted(vectors, key=len, reverse=True):  # velocity before vel before v
            axes = vectors[name]
            plane = all(self._entries[index].plane for axis in axes for index in axis)
            if axes[0] and axes[1] and (axes[2] or plane):
                return tuple(self._one("velocity", tuple(axis)) for axis in axes if axis)
        return ()

    def _wanted_velocity(self, wanted: str) -> _Indices:
        found = self._wanted("velocity", wanted)
        vectors = tuple(index for index in found if self._entries[index].vector)
        if vectors or wanted == NONE:
            return vectors
        if components := self._components(wanted):
            return components
        parts = [self._wanted("velocity", part) for part in wanted.split(",")]
        if 2 <= len(parts) <= 3 and all(parts):
            chosen = tuple(self._one("velocity", part) for part in parts)
            self._require("velocity", chosen)
            return chosen
        return found

    def _wanted(self, role: str, wanted: str) -> _Indices:
        """The entries of a name that the user gives: NAME, or NAME[1] for the second of that name."""
        if literal := tuple(index for index in self._all if self._entries[index].name == wanted):
            return literal
        if numbered := re.fullmatch(r"(.*)\[(\d{1,4})\]", wanted, re.DOTALL):
            same = [index for index in self._all if self._entries[index].name == numbered[1]]
            return tuple(same[int(numbered[2]) :][:1])
        similar = [i for i in self._all if self._entries[i].name.strip().lower() == wanted.strip().lower()]
        return self._one_name(role, tuple(similar))

    def _one_name(self, role: str, found: _Indices) -> _Indices:
        """The entries, if they are grids of one name but for numbers that tell equal ones apart."""
        names = {grid_names.base_name(self._entries[index].name) for index in found}
        if len(names) > 1 or (len(found) > 1 and self._noun == "array"):
            raise InputError(self._several(role, found))
        return found

    def _one(self, role: str, found: Sequence[int]) -> int:
        if len(found) > 1:
            raise InputError(self._several(role, tuple(found)))
        return found[0]

    def _require(self, role: str, found: _Indices) -> None:
        """Check that entries hold numbers."""
        for index in found:
            entry = self._entries[index]
            if not entry.scalar:
                called = f"{self._noun} {quoted(entry.name)}"
                if self._alone and entry.vector:
                    raise InputError(f"{called} holds vectors, expected one number for each cell")
                without = "" if role == "density" else f", or go without it with --{role} none"
                raise InputError(
                    f"{called} holds {entry.kind}, expected numbers; export it as such, or choose another with "
                    f"{self._flag(role)}{without}"
                )

    def _several(self, role: str, found: _Indices) -> str:
        meant = "meant" if self._alone else f"the {role}"
        return f"several {self._noun}s may be {meant}: {self._names(found)}; choose with {self._flag(role)}"

    def _absent(self, role: str, wanted: str) -> str:
        start = "" if self._alone else f"--{role} {quoted(wanted)}: "
        such = f"{self._noun} {quoted(wanted)}" if self._alone else f"such {self._noun}"
        return f"{start}no {such}, those found are: {self._names(self._all)}"

    def _flag(self, role: str) -> str:
        """What chooses a grid by its name: a flag of the part of a frame, or the key in the table of a mask."""
        return "grid = NAME" if self._alone else f"--{role} NAME"

    def _names(self, indices: _Indices) -> str:
        """Names in a message: numbered where they are equal, with the type of what is no usual grid of numbers."""
        names = [self._entries[index].name for index in indices]
        labels: list[tuple[str, str]] = []
        for place, index in enumerate(indices):
            entry = self._entries[index]
            number = f"[{names[:place].count(entry.name)}]" if names.count(entry.name) > 1 else ""
            usual = (entry.scalar or entry.vector) and not entry.kind.startswith("level set")
            labels.append((f"{entry.name}{number}", "" if usual else f" ({entry.kind})"))
        return grid_names.listed(labels, in_quotes=self._noun == "grid")
