"""Frames as OpenVDB files: which box of voxels a frame spans, and its grids at the cells of its run.

A file holds the active voxels, not the domain of the simulation. Our files and Blender's declare the domain; otherwise
it is the box around the active voxels. The grid on which all files of a run are read is chosen in `run_grid`.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Note
from tnst_mi.geometry.affine import EDGE_TOLERANCE, Affine, between
from tnst_mi.geometry.boxes import Box, extents, image, union
from tnst_mi.geometry.placement import OwnVoxels
from tnst_mi.io.grids.contents import Contents
from tnst_mi.io.grids.vdb.adaptive_domain import domain_corner, placed
from tnst_mi.io.grids.vdb.clumps import clumps_of
from tnst_mi.io.grids.vdb.component_files import read_parts
from tnst_mi.io.grids.vdb.file_format.reader import Grid, VdbFile, read_vdb
from tnst_mi.io.grids.vdb.limits import require_small
from tnst_mi.io.grids.vdb.on_cells import density_on, is_as_stored, known_on, solid_on, stored_velocity, velocity_on
from tnst_mi.io.grids.vdb.other_grids import other_grids
from tnst_mi.io.grids.vdb.programs import BLENDER, program_of
from tnst_mi.io.grids.vdb.quantities import Quantities, on_faces, quantities_of, type_in_words
from tnst_mi.io.grids.vdb.results import HIGHEST, LOWEST, source_of
from tnst_mi.io.grids.vdb.run_grid import RunGrid, run_grid
from tnst_mi.io.grids.vdb.span import Span, require_one_up
from tnst_mi.io.interpretation.conventions import WITHOUT_SMOKE, Boxing, StoredFrame
from tnst_mi.io.interpretation.roles import Wanted
from tnst_mi.machine.gate import gate
from tnst_mi.machine.terminal import quoted, shortened


def read_vdb_frame(
    path: Path,
    run: RunGrid | None = None,
    wanted: Wanted | None = None,
    smoke: bool = False,
    fog: bool = False,
    name: str | None = None,
    others: Sequence[Path] = (),
) -> StoredFrame:
    """Read a frame at the cells of a run.

    Args:
        path: the file.
        run: the grid of the run; None for the file's own.
        wanted: names that the user gives for grids.
        smoke: whether other frames of its sequence have a density, so that one without is a frame without smoke.
        fog: whether the inside of a level set is its density.
        name: of the frame; None for that of the file without its ending.
        others: where the file holds one component of a velocity, those of the other two.

    Raises:
        InputError: a file cannot be used, or it has no active voxel and no box.
    """
    file = read_parts((path, *others))
    found = quantities_of(file, wanted or Wanted(), fog)
    density, velocity, obstacle, main = found.density, found.velocity, found.obstacle, found.main
    notes: tuple[Note, ...] = ()
    if density is None and smoke and run is not None:
        notes = (Note(WITHOUT_SMOKE),)
    elif main is None:
        return StoredFrame(density=None, taken=found.taken, lacking=found.lacking)
    if run is None:
        run = run_grid([span] if (span := _span_of(file, found)) else [])
    cells = run.box_of(name or path.stem)
    require_small(path, cells, found.components or 1)
    # A frame without smoke may have other grids, which lie where they do.
    grid = next((file.grids[index] for index in found.others), None) if main is None else main.main
    if grid is None:
        return StoredFrame(
            density=_nothing(cells), up=run.up, up_because=run.up_because, taken=found.taken, notes=notes
        )
    own = OwnVoxels(grid.stored_affine, _from(cells, between(run.cells, grid.affine)), grid.placed)
    values = None
    if density is not None:
        values, own = density_on(density, cells, run.cells, own)
    motion, known, staggered, drift = None, None, False, run.drift_of(name or path.stem)
    if velocity is not None:
        staggered = is_as_stored(velocity, grid, run.cells)
        if staggered:
            motion, known = stored_velocity(velocity, grid, cells, run.cells)
        else:
            motion = velocity_on(velocity, cells, run.cells)
            known = None if drift is None else known_on(velocity, cells, run.cells)
    solid, words = (None, "") if obstacle is None or density is None else solid_on(obstacle, cells, run.cells)
    program, source = program_of(file, grid), source_of(file, found, cells, run.cells)
    beside = other_grids(file, source)
    x, y, z = run.cells(cells[0]).tolist()
    return StoredFrame(
        density=_nothing(cells) if notes else values,
        velocity=motion,
        obstacle=solid,
        staggered=staggered,
        from_faces=velocity is not None and not staggered and on_faces(velocity, grid),
        # Blender stores velocities only where there is smoke; the zeros elsewhere are not data.
        known=known,
        up=run.up,
        up_because=program.up_because if program.up == run.up else run.up_because,
        velocity_units=program.velocity_units,
        velocity_cell=1.0 if velocity is None else _ratio(velocity.main.affine.edge, run.cells.edge),
        drift=drift,
        voxel_size=run.cells.edge,
        corner=(x, y, z),
        own=own,
        source=source,
        grids=beside,
        taken=replace(found.taken, others=tuple(map(quoted, beside)), left=found.unreadable),
        layouts=(words,) if words else (),
        notes=notes,
        lacking=found.lacking,
    )


def read_simulation_of_noise(path: Path, run: RunGrid | None, name: str) -> StoredFrame:
    """Read the frame to which Blender has added noise, at the cells of the noise.

    The transforms of the two files place the lowest corners of voxel (0, 0, 0) at one point, not its centres.

    Args:
        path: the file of the simulation.
        run: the grid of the run, whose cells are the voxels of the noise.
        name: of the frame.

    Raises:
        InputError: the file cannot be used.
    """
    main = quantities_of(placed(read_vdb(path)), Wanted()).main
    if run is not None and main is not None:
        between_centres = np.full(3, 0.5 * (main.main.affine.edge - run.cells.edge))
        run = replace(run, cells=run.cells.moved(-between_centres))
    return read_vdb_frame(path, run, name=name)


def read_vdb_obstacle(path: Path, name: str, run: RunGrid | None) -> StoredFrame:
    """Read the obstacle of a frame, whose density is in another file; None if there is none.

    Args:
        path: the file.
        name: of the frame.
        run: the grid of its run.

    Raises:
        InputError: a file cannot be used.
    """
    found = quantities_of(placed(read_vdb(path)), Wanted())
    obstacle = found.obstacle or found.density
    if obstacle is None or run is None:
        return StoredFrame(density=None)
    solid, words = solid_on(obstacle, run.box_of(name), run.cells)
    return StoredFrame(density=None, obstacle=solid, layouts=(words,) if words else ())


def has_density(path: Path, wanted: Wanted) -> bool:
    """Whether a file has a grid that is its density.

    Raises:
        InputError: the file cannot be used.
    """
    return not quantities_of(read_vdb(path), wanted).lacking


def describe_vdb(path: Path) -> list[Contents]:
    """The grids of a file; of a cache of Blender, where its domain begins too."""
    contents, file = list[Contents](), placed(read_vdb(path))
    for grid in file.grids:
        kind = ", ".join((type_in_words(grid), shortened(str(grid.metadata.get("class", "unknown"))), grid.codec))
        numbers, box = [_voxels(grid)], None
        if grid.kind is not None:
            box = grid.topology.active_box()
            numbers += [f"{grid.topology.active_voxels} active voxels", *_range(grid)]
        span = "" if box is None else f"from {tuple(box[0].tolist())} to {tuple(box[1].tolist())}"
        contents.append(Contents(f"grid {quoted(grid.name)}: {kind}", span, ", ".join(numbers)))
    if any(BLENDER in grid.metadata for grid in file.grids) and (corner := domain_corner(path)):
        flags = f"--origin={','.join(f'{number:g}' for number in corner)}"
        if file.grids[0].placed is not None:
            flags += f" --voxel-size={file.grids[0].affine.edge:g}"
        contents.append(
            Contents(f"domain of Blender: at the origin in the cache; {flags} places results as in its object")
        )
    return contents


def run_grid_of(
    paths: Sequence[Path],
    wanted: Wanted | None = None,
    boxing: Boxing | None = None,
    fog: bool = False,
    numbers: Mapping[Path, float] | None = None,
    beside: Sequence[Sequence[Path]] = (),
    up: str | None = None,
) -> RunGrid | None:
    """The grid on which the files of a sequence are read; None if none has a density or velocity with voxels.

    Files that cannot be read are left out: reading their frames tells why.

    Args:
        paths: the files, in the order of the frames.
        wanted: names that the user gives for grids.
        boxing: which part of the grids is read.
        fog: whether the inside of a level set is its density.
        numbers: of the frames, as far as they are known.
        beside: files of which velocities alone are read, those of components in threes. They have a say only where no
            density has voxels.
        up: the axis that the user says is up; None to take it from the files.

    Raises:
        InputError: the grid would be too large, or out of proportion to the files; or these differ in which axis is up.
    """
    spans = list(
        _spans([(path,) for path in paths], lambda file: quantities_of(file, wanted or Wanted(), fog), numbers or {})
    )
    if up is None:
        require_one_up(spans)
    spans_beside = list(_spans(beside, lambda file: replace(quantities_of(file, Wanted()), density=None), {}))
    if any(span.box is not None for span in spans):
        return run_grid(spans, boxing, spans_beside)
    return run_grid(spans_beside, boxing) if any(span.box is not None for span in spans_beside) else None


def _spans(
    groups: Iterable[Sequence[Path]], quantities: Callable[[VdbFile], Quantities], numbers: Mapping[Path, float]
) -> Iterator[Span]:
    """What those files span that can be read and have a density or a velocity; of components, each three together."""
    for paths in groups:
        with contextlib.suppress(InputError), gate(paths[0], "a .vdb file"):
            file = read_parts(paths)
            span = _span_of(file, quantities(file), numbers.get(paths[0]))
            if span is not None:
                yield span


def _nothing(box: Box) -> np.ndarray:
    """A density (Z, Y, X) without smoke."""
    return np.zeros(extents(box)[::-1], np.float32)


def _from(cells: Box, voxels_of: Affine) -> Affine:
    """A map from cells that counts them from the lowest one of a box."""
    return Affine(voxels_of.matrix, voxels_of(cells[0]))


def _ratio(edge: float, other: float) -> float:
    """The ratio of two edges, which is 1 if they differ by rounding alone."""
    return 1.0 if math.isclose(edge, other, rel_tol=EDGE_TOLERANCE) else edge / other


def _voxels(grid: Grid) -> str:
    """The size of a grid's voxels, in words."""
    if isinstance(grid.transform, str):
        return f"placed by a {grid.transform}"
    edges = [f"{edge:g}" for edge in grid.transform.edges]
    return f"voxel size {edges[0] if len(set(edges)) == 1 else '×'.join(edges)}"


def _range(grid: Grid) -> list[str]:
    """The range of the active values of a grid, in words, if there are any; of vectors, of all components."""
    try:
        tree = grid.tree
    except InputError as error:
        # A grid that makes no part of the frame does not keep it from being read.
        return [f"cannot be read ({str(error).removeprefix(f'{grid.path}: ')})"]
    values = np.concatenate([tree.leaf_values[tree.leaf_active].ravel(), tree.tile_values[tree.tile_active].ravel()])
    return [f"{values.min():g} to {values.max():g}"] if values.size else []


def _span_of(file: VdbFile, found: Quantities, number: float | None = None) -> Span | None:
    """What a file spans; None if it has neither density nor velocity."""
    if found.main is None:
        return None
    grid, density, velocity = found.main.main, found.density, found.velocity
    voxels = grid.affine
    trees = [] if density is None else list(density.placed_trees())
    told = _told_box(file, found)
    boxes = [told, *(tree.active_box() for tree in trees)]
    moves = None if velocity is None else between(velocity.main.affine, voxels)
    # A velocity with voxels of its own is read where there is smoke.
    if velocity is not None and moves is not None and told is None and (moves.whole or density is None):
        active = velocity.active_box()
        boxes.append(None if active is None else image(active, moves))
    program = program_of(file, grid)
    return Span(
        file.path,
        voxels,
        union(boxes),
        tuple(clumps_of(trees)),
        () if velocity is None else tuple(grid.affine for grid in velocity.grids),
        None if grid.placed is None else grid.stored_affine,
        BLENDER in grid.metadata,
        float(trees[0].background) if trees else 0.0,
        number,
        found.components,
        file.path.stat().st_size,
        program.up,
        program.up_because,
    )


def _told_box(file: VdbFile, found: Quantities) -> Box | None:
    """The domain that a file declares, in voxels of its density or else of its velocity; None if it does not."""
    corners = [file.metadata.get(key) for key in (LOWEST, HIGHEST)]
    resolution = None if found.main is None else found.main.main.metadata.get(BLENDER)
    if not all(isinstance(corner, tuple) and len(corner) == 3 for corner in corners):
        if not isinstance(resolution, tuple) or len(resolution) != 3:
            return None
        corners = [(0, 0, 0), np.array(resolution, np.int64) - 1]
    low, high = (np.array(corner, np.int64) for corner in corners)
    if (high < low).any():
        raise InputError(f"{file.path}: damaged: says that it spans voxels {low.tolist()} to {high.tolist()}")
    return low, high
