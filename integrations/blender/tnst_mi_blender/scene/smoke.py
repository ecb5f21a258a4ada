"""The smoke of an object: which files it is in, and where their cells are in Blender's scene.

A run of tnst-mi knows the space of the files alone: cell centres lie where OpenVDB's transform puts them, and results
lie there too. `Smoke.space` leads from it to the world. So cameras and regions are written in the space of the files,
results are placed by the same matrix, and nothing needs to be moved. Uneven scales and parents are in the matrix.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import bpy
from mathutils import Matrix, Vector

from ..problems import CannotStylizeError
from ..versions import DRAWN_OFF
from .playback import Playback

#: Grids of the smoke, the first of these that a file has.
DENSITIES = ("density", "density_noise")

#: Cells that Blender gives a domain along each axis at least.
LEAST_CELLS = 4

#: The axes of a space whose scales differ by less than this share are of one scale, and in right angles likewise.
EVEN = 1e-4


@dataclass(frozen=True)
class Smoke:
    """The smoke of an object.

    Attributes:
        source: what tnst-mi reads: a file, a folder or a pattern.
        numbers: of the frames that are shown, in order; empty for one file without a number of frames.
        shift: number of a file's frame less that of the scene's, where it is shown for the first time.
        playback: of a sequence; None for one file, and for domains, which play each frame once.
        on_object: from the space of the files to that of the object, as a child that is a volume of them has it.
        world: from the space of the object to the world.
        cells: from the space in which cell centres are to that of the object, as they are drawn.
        cell: edge of a cell in the space of the files.
        voxel_size: that edge, where the files do not tell it truly and tnst-mi has to be told; else None.
        placed: whether the files say where they are, so that masks in files can lie among them.
    """

    source: Path
    numbers: tuple[int, ...]
    shift: int
    playback: Playback | None
    on_object: Matrix
    world: Matrix
    cells: Matrix
    cell: float
    voxel_size: float | None
    placed: bool

    @property
    def space(self) -> Matrix:
        """From the space in which cell centres are to the world, as they are drawn."""
        return self.world @ self.cells

    @property
    def scale(self) -> float:
        """How much larger the smoke is in the world than in its files."""
        return abs(self.space.to_3x3().determinant()) ** (1 / 3)

    def require_even(self, what: str) -> None:
        """Require that lengths in the world and in the files differ by one scale alone.

        Raises:
            CannotStylizeError: they do not.
        """
        if not is_even(self.space):
            raise CannotStylizeError(
                f"{what} cannot be brought into the space of smoke that is scaled unevenly: give the object, and what "
                "it is attached to, the same scale along all axes, and a domain 4 cells or more along each"
            )

    def require_unmirrored(self) -> None:
        """Require that no camera has to be mirrored to see the smoke of the files as that in the world is seen.

        Raises:
            CannotStylizeError: it would have to be.
        """
        if self.space.is_negative:
            raise CannotStylizeError(
                "the camera cannot see smoke that is mirrored: make the negative scale of its object, and of what that "
                "is attached to, positive, or switch Camera off"
            )


def is_even(matrix: Matrix) -> bool:
    """Whether a matrix does nothing but rotate, mirror, move and scale by one number."""
    axes = [matrix.col[axis].to_3d() for axis in range(3)]
    length = max(axis.length for axis in axes)
    alike = all(abs(axis.length - length) <= EVEN * length for axis in axes)
    return alike and all(abs(axes[i].dot(axes[i - 1])) <= EVEN * length**2 for i in range(3))


def domain_settings(item: bpy.types.Object | None) -> bpy.types.FluidDomainSettings | None:
    """The settings of a domain of smoke; None of any other object."""
    for modifier in () if item is None else item.modifiers:
        if modifier.type == "FLUID" and modifier.fluid_type == "DOMAIN":
            found = modifier.domain_settings
            return found if found is not None and found.domain_type == "GAS" else None
    return None


def can_be_stylized(item: bpy.types.Object | None) -> bool:
    """Whether an object is a volume or a domain of smoke."""
    return item is not None and (item.type == "VOLUME" or domain_settings(item) is not None)


def note_of_library(item: bpy.types.Object) -> tuple[str, ...]:
    """A note if Blender does not save the settings of an object, since it belongs to another file."""
    if item.library is None:
        return ()
    return (
        f"{item.name} belongs to {Path(item.library.filepath).name}: its settings here, and that it is hidden, are not "
        "saved; make it an override (Object > Library Override > Make)",
    )


def smoke_of(item: bpy.types.Object, chosen: str = "") -> Smoke:
    """The smoke of an object.

    Args:
        item: a volume or a domain.
        chosen: folder or file that is read instead of its own; empty for none.

    Raises:
        CannotStylizeError: it has none in files.
    """
    settings = domain_settings(item)
    if not item.matrix_world.determinant():
        raise CannotStylizeError(f"{item.name}: is flat, its scale {_in_words(item.matrix_world)}: expected none of 0")
    if settings is not None:
        return _of_domain(item, settings, chosen)
    if item.type != "VOLUME":
        raise CannotStylizeError(f"{item.name}: is no volume and no domain of smoke; select one")
    return _of_volume(item, chosen)


def _of_domain(item: bpy.types.Object, settings: bpy.types.FluidDomainSettings, chosen: str) -> Smoke:
    """A domain's cache lies along the object's axes in the unit of the world, from its lowest corner on.

    It has whole cells of one size, at least 4 along each axis, which Blender stretches to fill the box. Cameras and
    regions are taken without that where it is less than a cell, since they need one scale.
    """
    cache = _path(chosen or settings.cache_directory, item.library)
    finer = settings.noise_scale if _frames_in(cache / "noise") else 1
    numbers = _frames_in(cache / "noise") or _frames_in(cache / "data")
    if not numbers:
        raise CannotStylizeError(
            f"{item.name}: there is no baked smoke in {cache}: bake the domain, with Cache > Format Volumes OpenVDB"
        )
    # The mesh as it is stored: that of an adaptive domain is evaluated as the part around the smoke.
    corners = [vertex.co for vertex in item.data.vertices]
    low = Vector([min(corner[axis] for corner in corners) for axis in range(3)])
    high = Vector([max(corner[axis] for corner in corners) for axis in range(3)])
    scale = [abs(factor) or 1.0 for factor in item.scale]
    sides = [(high[axis] - low[axis]) * scale[axis] for axis in range(3)]
    if not all(sides):
        raise CannotStylizeError(f"{item.name}: is flat: expected a box as the domain")
    base = max(sides) / settings.resolution_max
    cell = base / finer
    filled = [max(int(side / base + 0.5), LEAST_CELLS) * base for side in sides]
    drawn = [side / (size * factor) for side, size, factor in zip(sides, filled, scale, strict=True)]
    stretched = any(abs(side - size) > base for side, size in zip(sides, filled, strict=True))
    even = drawn if stretched else [1 / factor for factor in scale]
    corner = Matrix.Translation(low)
    openvdb = bool(next((cache / "data").glob("*.vdb"), None))
    untrue = settings.use_adaptive_domain or not openvdb
    return Smoke(
        source=cache,
        numbers=numbers,
        shift=-settings.cache_frame_offset,
        playback=None,
        on_object=corner @ Matrix.Diagonal(drawn).to_4x4() @ Matrix.Translation([(0.5 - DRAWN_OFF) * cell] * 3),
        world=item.matrix_world.copy(),
        cells=corner @ Matrix.Diagonal(even).to_4x4() @ Matrix.Translation([0.5 * cell] * 3),
        cell=cell,
        voxel_size=cell if untrue else None,
        placed=openvdb,
    )


def _of_volume(item: bpy.types.Object, chosen: str) -> Smoke:
    volume = item.data
    file = _path(chosen, item.library) if chosen else _path(volume.filepath, volume.library)
    numbered = re.fullmatch(r"(.*?)(\d+)(\D*)", file.name) if volume.is_sequence else None
    numbers: tuple[int, ...] = ()
    playback = None
    source = file
    if numbered is not None:
        before, digits, after = numbered.groups()
        source = file.with_name(f"{before}{'#' * len(digits)}{after}")
        playback = Playback(volume.frame_start, volume.frame_offset, volume.frame_duration, volume.sequence_mode)
        there = numbers_in(file.parent, rf"{re.escape(before)}(\d+){re.escape(after)}")
        numbers = tuple(filter(playback.plays, there))
    if not file.is_file():
        raise CannotStylizeError(f"{item.name}: there is no file {file}: choose another in its properties")
    if playback is not None and not numbers:
        raise CannotStylizeError(
            f"{item.name}: plays {playback.duration} frames from {source.name} {playback.offset + 1} on, and there are "
            "none: change its Frames and Offset"
        )
    grids = grids_in(file)
    axes = next((grids[name] for name in DENSITIES if name in grids), next(iter(grids.values()))).to_3x3()
    return Smoke(
        source=source,
        numbers=numbers,
        shift=0 if playback is None else playback.shift,
        playback=playback,
        on_object=Matrix(),
        world=item.matrix_world.copy(),
        cells=Matrix.Translation(axes @ Vector([DRAWN_OFF] * 3)),
        cell=abs(axes.determinant()) ** (1 / 3),
        voxel_size=None,
        placed=True,
    )


def grids_in(file: Path) -> dict[str, Matrix]:
    """The grids of a VDB file by their names, with their transforms.

    A volume of the scene has those of its current frame alone, and none where it has no frame.

    Raises:
        CannotStylizeError: it cannot be read, or has none.
    """
    volume = bpy.data.volumes.new("tnst_mi file")
    try:
        volume.filepath = str(file)
        if not volume.grids.load() or not len(volume.grids):
            raise CannotStylizeError(f"{file}: {volume.grids.error_message or 'has no grids'}; choose another file")
        return {grid.name: grid.matrix_object.copy() for grid in volume.grids}
    finally:
        bpy.data.volumes.remove(volume)


def shown_between(smoke: Smoke, bounds: tuple[int, int]) -> tuple[int, ...]:
    """The numbers of the files' frames that are shown in a range of the scene's frames; none for one file."""
    frames = range(bounds[0], bounds[1] + 1)
    shown = {frame + smoke.shift if smoke.playback is None else smoke.playback.number_at(frame) for frame in frames}
    return tuple(number for number in smoke.numbers if number in shown)


def frames_between(smoke: Smoke, bounds: tuple[int, int] | None) -> tuple[int, ...]:
    """The numbers of the files' frames that are in a range of the scene's frames, all of them for None.

    Raises:
        CannotStylizeError: there are none.
    """
    if bounds is None or not smoke.numbers:
        return smoke.numbers
    found = shown_between(smoke, bounds)
    if not found:
        has = f"{smoke.numbers[0] - smoke.shift} to {smoke.numbers[-1] - smoke.shift}"
        raise CannotStylizeError(
            f"there is no smoke in the frames {bounds[0]} to {bounds[1]}, but in {has}: choose others, or bake these"
        )
    return found


def _path(text: str, library: bpy.types.Library | None) -> Path:
    return Path(bpy.path.abspath(text, library=library))


def _in_words(matrix: Matrix) -> str:
    """The scale of a matrix along its axes."""
    return " × ".join(f"{matrix.col[axis].to_3d().length:g}" for axis in range(3))


def _frames_in(folder: Path) -> tuple[int, ...]:
    """The frames that a folder of a domain's cache has."""
    return numbers_in(folder, r"(?:fluid_(?:data|noise)|density(?:_noise)?)_(\d+)\.(?:vdb|uni)")


def numbers_in(folder: Path, pattern: str) -> tuple[int, ...]:
    """The numbers in the names of a folder's files, as the one group of a pattern, in order."""
    names = (file.name for file in folder.iterdir()) if folder.is_dir() else ()
    return tuple(sorted({int(found[1]) for name in names if (found := re.fullmatch(pattern, name))}))
