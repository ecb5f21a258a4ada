"""The density, velocity and obstacle of an OpenVDB file, each made of one grid or several.

Several grids of one name are parts of one quantity if their voxels lie on one lattice and the active ones do not
overlap, such as those of a cluster, each with a translation of its own; three scalar grids may be the components of a
velocity, at the centres of the density's voxels or, half a voxel lower along their own axes, on faces.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tnst_mi.errors import InputError, naming
from tnst_mi.geometry.affine import PLACE_TOLERANCE, lattice_offset
from tnst_mi.geometry.boxes import Box, union
from tnst_mi.io.grids.vdb.file_format.reader import HALF, Grid, VdbFile
from tnst_mi.io.grids.vdb.file_format.tree import Tree
from tnst_mi.io.grids.vdb.level_set import fog_volume, is_level_set, looks_like_level_set
from tnst_mi.io.grids.vdb.programs import NAME
from tnst_mi.io.interpretation.conventions import Taken
from tnst_mi.io.interpretation.grid_names import FLAGS, listed, plain_name
from tnst_mi.io.interpretation.layouts import solid_cells
from tnst_mi.io.interpretation.roles import Entry, Roles, Wanted, chosen_roles
from tnst_mi.machine.terminal import quoted, shortened


@dataclass(frozen=True)
class Quantity:
    """One grid, several that together are one, or a scalar grid for each component of a vector.

    Attributes:
        grids: in the order of the file, or of the components.
        components: of a value: 1 or 3.
        role: what it is, "density", "velocity", "obstacle" or "other".
    """

    grids: tuple[Grid, ...]
    components: int
    role: str

    @property
    def name(self) -> str:
        """The names of its grids, each once."""
        return listed(list(dict.fromkeys(grid.name for grid in self.grids)), in_quotes=True)

    @property
    def main(self) -> Grid:
        """The first grid, whose metadata and transform are those of the quantity."""
        return self.grids[0]

    @property
    def split(self) -> bool:
        """Whether each component is a grid of its own."""
        return self.components == 3 and self.main.kind is not None and self.main.kind.components == 1

    @property
    def staggered(self) -> bool:
        """Whether the components lie on the faces of the voxels of a grid from which each is half a voxel lower."""
        return self.main.staggered and not self.split

    @cached_property
    def offsets(self) -> tuple[np.ndarray, ...]:
        """What takes voxels of the first grid to those of each, of grids that are parts of one quantity.

        Raises:
            InputError: their voxels do not lie on one lattice.
        """
        found = [lattice_offset(self.main.affine, grid.affine) for grid in self.grids]
        offsets = tuple(offset for offset in found if offset is not None)
        if len(offsets) < len(found):
            raise InputError(
                f"{self.main.path}: {len(self.grids)} grids are called {quoted(self.main.name)} and have different "
                f"voxels, expected the same; {self._remedy}"
            )
        return offsets

    def placed_trees(self) -> Iterator[Tree]:
        """The trees of grids that are parts of one quantity, placed in voxels of the first grid.

        They tell where voxels are, but are not to be expanded: their leaves need not be aligned.

        Raises:
            InputError: their voxels do not lie on one lattice, or a tree is damaged.
        """
        for grid, offset in zip(self.grids, self.offsets, strict=True):
            tree = grid.tree
            yield replace(tree, leaf_origins=tree.leaf_origins - offset, tile_origins=tree.tile_origins - offset)

    def active_box(self) -> Box | None:
        """The smallest box around all active voxels, in voxels of the first grid; None if there are none.

        Raises:
            InputError: the voxels of its grids do not lie on one lattice, or a tree is damaged.
        """
        if self.split:
            return union(grid.topology.active_box() for grid in self.grids)
        boxes = [grid.topology.active_box() for grid in self.grids]
        pairs = zip(boxes, self.offsets, strict=True)
        return union(None if box is None else _moved(box, -offset) for box, offset in pairs)

    def values_in(self, box: Box) -> np.ndarray:
        """The values of all voxels of a box of the first grid, (Z, Y, X) or (Z, Y, X, 3).

        Raises:
            InputError: grids of one name overlap or do not lie on one lattice, or a tree is damaged.
        """
        first, *others = self.grids
        values = first.tree.values_in(box)
        if self.split:
            components = [values, *(grid.tree.values_in(box) for grid in others)]
            return np.stack([*components, *(np.zeros_like(values) for _ in range(3 - len(components)))], axis=-1)
        taken = first.tree.active_in(box) if others else None
        for grid, offset in zip(others, self.offsets[1:], strict=True):
            place = _moved(box, offset)
            active = grid.tree.active_in(place)
            if taken is None or (both := int((taken & active).sum())):
                raise InputError(
                    f"{grid.path}: {len(self.grids)} grids are called {quoted(grid.name)} and overlap in {both} "
                    f"voxels; {self._remedy}"
                )
            values[active] = grid.tree.values_in(place)[active]
            taken |= active
        return values

    def active_in(self, box: Box) -> np.ndarray:
        """Which voxels of a box of the first grid are active in any grid, (Z, Y, X) bool."""
        offsets = (np.zeros(3, np.int64),) * len(self.grids) if self.split else self.offsets
        places = (_moved(box, offset) for offset in offsets)
        return np.logical_or.reduce([grid.tree.active_in(at) for grid, at in zip(self.grids, places, strict=True)])

    @property
    def _remedy(self) -> str:
        return f"choose one of them, such as with --{self.role} '{self.main.name}[0]'"


@dataclass(frozen=True)
class Quantities:
    """What a file holds of a frame; None for what is missing.

    Attributes:
        density: the density.
        velocity: the velocity.
        obstacle: the obstacle.
        others: the places in the file of the other grids.
        unreadable: the names of those that cannot be read, with their types.
        taken: the names of the grids.
        lacking: why there is no density; empty if there is one.
    """

    density: Quantity | None
    velocity: Quantity | None
    obstacle: Quantity | None
    others: tuple[int, ...]
    unreadable: tuple[str, ...]
    taken: Taken
    lacking: str

    @property
    def components(self) -> int:
        """Of the values of all of them together."""
        return sum(part.components for part in (self.density, self.velocity, self.obstacle) if part is not None)

    @property
    def main(self) -> Quantity | None:
        """The density, or else the velocity: its voxels are those of the frame."""
        return self.density or self.velocity


def quantities_of(file: VdbFile, wanted: Wanted, fog: bool = False) -> Quantities:
    """Choose the grids of a file for the quantities of a frame.

    Args:
        file: the file.
        wanted: names that the user gives for grids.
        fog: whether the inside of a level set is a density; without a density by name, that of a lone one is taken.

    Raises:
        InputError: several could be meant, one that the user names is not there, or one is of another type.
    """
    path = file.path
    entries = []
    for grid in file.grids:
        components = 0 if grid.kind is None else grid.kind.components
        level_set = "level set of " if is_level_set(grid) else ""
        entries.append(Entry(grid.name, components == 1, components == 3, level_set + type_in_words(grid)))
    wanted = _with_told_names(file, wanted)
    with naming(path):
        roles = chosen_roles(entries, wanted)
    roles = _with_level_set(file, roles, fog)
    density, velocity, obstacle = (
        Quantity(tuple(file.grids[index] for index in chosen), components, role) if chosen else None
        for role, chosen, components in (
            ("density", roles.density, 1),
            ("velocity", roles.velocity, 3),
            ("obstacle", roles.obstacle, 1),
        )
    )
    if velocity is not None and len(velocity.grids) == 1 and velocity.split:
        raise InputError(
            f"{path}: grid {velocity.name} holds {type_in_words(velocity.main)}, expected vectors; --velocity none "
            "goes without it, or choose another with --velocity NAME"
        )
    if density is not None and fog:
        grids = tuple(
            fog_volume(grid) if is_level_set(grid) or looks_like_level_set(grid) else grid for grid in density.grids
        )
        density = replace(density, grids=grids)
    names = [None if quantity is None else quantity.name for quantity in (density, velocity, obstacle)]
    left = tuple(_in_words(file.grids[index]) for index in roles.left)
    like_velocity = tuple(file.grids[index].name for index in roles.like_velocity)
    taken = Taken(names[0], names[1], names[2], left=left, like_velocity=like_velocity)
    others = tuple(index for index in roles.left if file.grids[index].readable)
    unreadable = tuple(_in_words(file.grids[index]) for index in roles.left if index not in others)
    return Quantities(density, velocity, obstacle, others, unreadable, taken, roles.lacking)


def _with_told_names(file: VdbFile, wanted: Wanted) -> Wanted:
    """The names that the user gives, and where there are none, those that a file of ours tells."""
    told = {}
    for role in ("density", "velocity", "obstacle"):
        name = file.metadata.get(NAME.format(role))
        if getattr(wanted, role) is None and isinstance(name, str) and name in {grid.name for grid in file.grids}:
            told[role] = name
    return replace(wanted, **told)


def _with_level_set(file: VdbFile, roles: Roles, fog: bool) -> Roles:
    """The roles with the density that may be the inside of a level set.

    Raises:
        InputError: the density is a level set, and its inside is not asked for.
    """
    if roles.density:
        for grid in () if fog else (file.grids[index] for index in roles.density):
            named = is_level_set(grid)
            if named or looks_like_level_set(grid):
                what = "is a level set (signed distances)"
                if not named:
                    what = f"looks like a level set (negative inside, {float(grid.tree.background):g} outside)"
                raise InputError(
                    f"{file.path}: grid {quoted(grid.name)} {what}, expected a density; --fog takes its inside as "
                    "one, or choose another grid with --density NAME"
                )
        return roles
    found = tuple(index for index in roles.left if is_level_set(file.grids[index]))
    if fog and len(found) == 1:
        left = tuple(index for index in roles.left if index not in found)
        return replace(roles, density=found, left=left, lacking="")
    return replace(roles, lacking=f"{roles.lacking}; --fog takes the inside of a level set") if found else roles


def solid_voxels(obstacle: Quantity, box: Box) -> tuple[np.ndarray, str]:
    """Which voxels of a box an obstacle fills, (Z, Y, X) bool, and in words how that was stored.

    Raises:
        InputError: its values do not say so.
    """
    values = obstacle.values_in(box)
    if is_level_set(obstacle.main) or looks_like_level_set(obstacle.main):
        return values < 0.0, "obstacle is the inside of a level set"
    with naming(obstacle.main.path):
        return solid_cells(values, plain_name(obstacle.main.name) == FLAGS)


def _moved(box: Box, offset: np.ndarray) -> Box:
    return box[0] + offset, box[1] + offset


def _in_words(grid: Grid) -> str:
    """The name of a grid, with the type of one whose values cannot be read."""
    return quoted(grid.name) if grid.kind is not None else f"{quoted(grid.name)} ({type_in_words(grid)})"


def type_in_words(grid: Grid) -> str:
    """The type of a grid's values, such as "float", "half vec3s", "bool" or "points"."""
    words = grid.tree_type.removeprefix("Tree_").removesuffix(HALF).removesuffix("_5_4_3")
    words = "points" if words.startswith("ptdataidx") else shortened(words)
    return f"half {words}" if grid.half and grid.kind is not None else words


def on_faces(velocity: Quantity, main: Grid) -> bool:
    """Whether the components of a velocity lie on the lower faces of the voxels of another grid.

    A vector grid says so itself; of three scalar grids, each is then placed half a voxel lower along its own axis.
    """
    if not velocity.split:
        return velocity.staggered
    lower = -0.5 * np.eye(3)[: len(velocity.grids)]
    voxels = [main.affine.inverse().after(grid.affine) for grid in velocity.grids]
    turned = max(np.abs(map.matrix - np.eye(3)).max() for map in voxels)
    apart = np.abs(np.array([map.offset for map in voxels]) - lower).max()
    return bool(max(turned, apart) < PLACE_TOLERANCE)
