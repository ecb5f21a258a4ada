"""The density, velocity and obstacle of an OpenVDB file, each made of one grid or several.

Several grids of one name are parts of one quantity if their active voxels do not overlap; three scalar grids may be the
components of a velocity, at the centres of the density's voxels or, half a voxel lower along their own axes, on faces.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tnst_mi.errors import InputError, naming
from tnst_mi.geometry.affine import PLACE_TOLERANCE
from tnst_mi.geometry.boxes import Box, union
from tnst_mi.io.grids.vdb.file_format.reader import HALF, Grid, VdbFile
from tnst_mi.io.grids.vdb.level_set import fog_volume, is_level_set
from tnst_mi.io.grids.vdb.programs import NAME
from tnst_mi.io.interpretation.conventions import Taken
from tnst_mi.io.interpretation.grid_names import FLAGS, listed, plain_name
from tnst_mi.io.interpretation.layouts import solid_cells
from tnst_mi.io.interpretation.roles import Entry, Roles, Wanted, chosen_roles


@dataclass(frozen=True)
class Quantity:
    """One grid, several that together are one, or a scalar grid for each component of a vector.

    Attributes:
        grids: in the order of the file, or of the components.
        components: of a value: 1 or 3.
    """

    grids: tuple[Grid, ...]
    components: int

    @property
    def name(self) -> str:
        """The names of its grids, each once."""
        return listed(list(dict.fromkeys(grid.name for grid in self.grids)), quoted=True)

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

    def active_box(self) -> Box | None:
        """The smallest box around all active voxels; None if there are none."""
        return union(grid.topology.active_box() for grid in self.grids)

    def values_in(self, box: Box) -> np.ndarray:
        """The values of all voxels of a box, (Z, Y, X) or (Z, Y, X, 3).

        Raises:
            InputError: grids of one name overlap, or a tree is damaged.
        """
        first, *others = self.grids
        values = first.tree.values_in(box)
        if self.split:
            components = [values, *(grid.tree.values_in(box) for grid in others)]
            return np.stack([*components, *(np.zeros_like(values) for _ in range(3 - len(components)))], axis=-1)
        taken = first.tree.active_in(box) if others else None
        for grid in others:
            active = grid.tree.active_in(box)
            if taken is None or (both := int((taken & active).sum())):
                raise InputError(
                    f"{grid.path}: {len(self.grids)} grids are called {grid.name!r} and overlap in {both} voxels; "
                    f"choose one of them, such as with --density '{grid.name}[0]'"
                )
            values[active] = grid.tree.values_in(box)[active]
            taken |= active
        return values

    def active_in(self, box: Box) -> np.ndarray:
        """Which voxels of a box are active in any grid, (Z, Y, X) bool."""
        return np.logical_or.reduce([grid.tree.active_in(box) for grid in self.grids])


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
        Quantity(tuple(file.grids[index] for index in chosen), components) if chosen else None
        for chosen, components in ((roles.density, 1), (roles.velocity, 3), (roles.obstacle, 1))
    )
    if velocity is not None and len(velocity.grids) == 1 and velocity.split:
        raise InputError(
            f"{path}: grid {velocity.name} holds {type_in_words(velocity.main)}, expected vectors; --velocity none "
            "goes without it, or choose another with --velocity NAME"
        )
    if density is not None and fog:
        grids = tuple(fog_volume(grid) if is_level_set(grid) else grid for grid in density.grids)
        density = Quantity(grids, density.components)
    names = [None if quantity is None else quantity.name for quantity in (density, velocity, obstacle)]
    left = tuple(_in_words(file.grids[index]) for index in roles.left)
    taken = Taken(names[0], names[1], names[2], left=left)
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
        grid = file.grids[roles.density[0]]
        if is_level_set(grid) and not fog:
            raise InputError(
                f"{file.path}: grid {grid.name!r} is a level set (signed distances), expected a density; --fog takes "
                "its inside as one, or choose another grid with --density NAME"
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
    if is_level_set(obstacle.main):
        return values < 0.0, "obstacle is the inside of a level set"
    with naming(obstacle.main.path):
        return solid_cells(values, plain_name(obstacle.main.name) == FLAGS)


def _in_words(grid: Grid) -> str:
    """The name of a grid, with the type of one whose values cannot be read."""
    return repr(grid.name) if grid.kind is not None else f"{grid.name!r} ({type_in_words(grid)})"


def type_in_words(grid: Grid) -> str:
    """The type of a grid's values, such as "float", "half vec3s", "bool" or "points"."""
    words = grid.tree_type.removeprefix("Tree_").removesuffix(HALF).removesuffix("_5_4_3")
    words = "points" if words.startswith("ptdataidx") else words
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
