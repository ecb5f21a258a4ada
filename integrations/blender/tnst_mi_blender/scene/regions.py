"""Objects of the scene as masks: empties as spheres and boxes, all others as files that Blender's OpenVDB fills."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bmesh
import bpy
from mathutils import Matrix, Vector

from .. import versions
from ..problems import CannotStylizeError
from ..recipes.commands import Box, Mask, MaskFile, Sphere
from .motion import may_change_shape
from .smoke import EVEN, Smoke, is_even

#: Displays of empties that can be regions.
SHAPES = ("SPHERE", "CUBE")

#: Digits of the coordinates that are written.
_DIGITS = 6


class Region:
    """An object of the scene, of which note is taken frame by frame, as a mask of smoke.

    Args:
        item: a mesh, or an empty displayed as a sphere or a cube.
        edge: depth in the world at which its mask has risen from 0 to 1.
        smoke: that it is a region of.
        files: folder for the mask's files, where it needs any.

    Attributes:
        item: that object.

    Raises:
        CannotStylizeError: it cannot be a region.
    """

    def __init__(self, item: bpy.types.Object, edge: float, smoke: Smoke, files: Path) -> None:
        if item.type not in ("EMPTY", "MESH"):
            raise CannotStylizeError(f"{item.name}: is {item.type.lower()}, expected an empty or a mesh as a region")
        if item.type == "EMPTY" and item.empty_display_type not in SHAPES:
            raise CannotStylizeError(
                f"{item.name}: choose Sphere or Cube as what the empty is displayed as (Object Data properties)"
            )
        if item.hide_viewport or not _is_enabled(item, bpy.context.view_layer.layer_collection):
            # Blender would leave it where it is in the current frame.
            raise CannotStylizeError(
                f"{item.name}: a region has to be in the scene, neither disabled in viewports (the eye does no harm) "
                "nor in a collection that is excluded"
            )
        self.item = item
        self._smoke, self._files = smoke, files
        self._edge = round(edge / smoke.scale, _DIGITS)
        self._matrices: dict[int, Matrix] = {}
        self._spaces: dict[int, Matrix] = {}
        self._sizes: dict[int, float] = {}

    def record(self, number: int, graph: bpy.types.Depsgraph, space: Matrix) -> None:
        """Take note of where it is in the scene's current frame, which is the smoke's frame of a number.

        Args:
            number: of that frame.
            graph: the evaluated scene.
            space: that of the smoke in this frame.
        """
        now = self.item.evaluated_get(graph)
        self._spaces[number] = space
        self._matrices[number] = space.inverted() @ now.matrix_world
        self._sizes[number] = now.empty_display_size

    def mask(self) -> Mask:
        """The mask of all frames that were recorded.

        Raises:
            CannotStylizeError: it has to be a file, and the smoke's files do not say where they are, or the size of
                an empty is animated; or the mesh encloses nothing.
        """
        shape = None if self.item.type == "MESH" else self._shape()
        if shape is not None:
            return shape
        if not self._smoke.placed:
            raise CannotStylizeError(
                f"{self.item.name}: meshes, and empties that are turned against the smoke, are regions of OpenVDB "
                "files alone: bake the domain with Cache > Format Volumes OpenVDB"
            )
        if self.item.type == "EMPTY" and len(set(self._sizes.values())) > 1:
            raise CannotStylizeError(
                f"{self.item.name}: is turned against the smoke, and its display size is animated: animate its scale"
            )
        return MaskFile(self._written())

    def _shape(self) -> Mask | None:
        """The mask of an empty; None if it is no sphere, and no box along the axes of the smoke, in some frame."""
        sphere = self.item.empty_display_type == "SPHERE"
        first, second = {}, {}
        for number, matrix in self._matrices.items():
            centre, size = matrix.translation, self._sizes[number]
            if sphere:
                if not is_even(matrix):
                    return None
                first[number] = _rounded(centre)
                second[number] = round(size * matrix.col[0].to_3d().length, _DIGITS)
            else:
                half = _half_sides(matrix)
                if half is None:
                    return None
                first[number], second[number] = _rounded(centre - size * half), _rounded(centre + size * half)
        kind = Sphere if sphere else Box
        return kind(_keyed(first), _keyed(second), self._edge)

    def _written(self) -> Path:
        """Write the file of the mask, or one for each frame where the object changes."""
        self._files.mkdir(parents=True, exist_ok=True)
        with _volume_of(self.item, self._edge, self._smoke) as volume:
            if not self._changes():
                # The scene is in the frame that was recorded last.
                volume.matrix_world = list(self._spaces.values())[-1]
                return self._save(volume, "mask.vdb")
            for number, space in self._spaces.items():
                bpy.context.scene.frame_set(number - self._smoke.shift)
                volume.matrix_world = space
                self._save(volume, f"mask_{number:04d}.vdb")
        return self._files / "mask_####.vdb"

    def _changes(self) -> bool:
        """Whether the object moves or may change its shape between frames."""
        first, *others = self._matrices.values()
        near = 1e-3 * self._smoke.cell
        if any((a - b).length > near for matrix in others for a, b in zip(matrix.col, first.col, strict=True)):
            return True
        return bool(others) and may_change_shape(self.item)

    def _save(self, volume: bpy.types.Object, name: str) -> Path:
        bpy.context.view_layer.update()
        grids = volume.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.grids
        file = self._files / name
        if not len(grids) or not grids.save(filepath=str(file)):
            raise CannotStylizeError(f"{self.item.name}: encloses nothing: close the holes of its mesh")
        return file


@contextmanager
def _volume_of(item: bpy.types.Object, edge: float, smoke: Smoke) -> Iterator[bpy.types.Object]:
    """A volume on the cells of the smoke that is 1 inside of an object, as long as it is needed."""
    scene = bpy.context.scene
    data = bpy.data.volumes.new("tnst_mi region")
    volume = bpy.data.objects.new(data.name, data)
    solid = item if item.type == "MESH" else _solid(item)
    try:
        for each in {volume, solid} - {item}:
            scene.collection.objects.link(each)
        modifier = volume.modifiers.new("Mesh to Volume", "MESH_TO_VOLUME")
        modifier.object, modifier.density = solid, 1.0
        modifier.resolution_mode, modifier.voxel_size = "VOXEL_SIZE", smoke.cell
        versions.fill(modifier, edge)
        yield volume
    finally:
        bpy.data.volumes.remove(data)
        if solid is not item:
            bpy.data.meshes.remove(solid.data)


def _solid(empty: bpy.types.Object) -> bpy.types.Object:
    """A mesh in the shape of an empty, which moves with it."""
    form, size = bmesh.new(), empty.empty_display_size
    if empty.empty_display_type == "SPHERE":
        bmesh.ops.create_icosphere(form, subdivisions=4, radius=size)
    else:
        bmesh.ops.create_cube(form, size=2 * size)
    mesh = bpy.data.meshes.new("tnst_mi region")
    form.to_mesh(mesh)
    form.free()
    solid = bpy.data.objects.new(mesh.name, mesh)
    solid.parent = empty
    return solid


def _is_enabled(item: bpy.types.Object, branch: bpy.types.LayerCollection) -> bool:
    """Whether a branch of the collections has an object, and is neither excluded nor disabled in viewports."""
    if branch.collection.hide_viewport:
        return False
    here = not branch.exclude and item in branch.collection.objects.values()
    return here or any(_is_enabled(item, child) for child in branch.children)


def _half_sides(matrix: Matrix) -> Vector | None:
    """Half the sides of the cube from −1 to 1 as a matrix maps it; None if they are not along the axes."""
    half = Vector(abs(matrix[axis][axis]) for axis in range(3))
    beside = max(abs(matrix[row][column]) for row in range(3) for column in range(3) if row != column)
    return half if beside <= EVEN * max(half) else None


def _rounded(vector: Vector) -> tuple[float, ...]:
    return tuple(round(number, _DIGITS) for number in vector)


def _keyed(values: Mapping[int, Any]) -> Any:
    """A value for all frames, or a table of them where they differ."""
    first, *others = values.values()
    return first if all(value == first for value in others) else dict(values)
