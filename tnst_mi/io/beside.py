"""Frames in formats that hold whole frames, whose velocity or obstacle is in a companion file nevertheless."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.io.array_frames import obstacle_beside, velocity_beside
from tnst_mi.io.context import SequenceContext
from tnst_mi.io.files import companions
from tnst_mi.io.grids.vdb.frames import read_simulation_of_noise, read_vdb_frame, read_vdb_obstacle
from tnst_mi.io.interpretation.conventions import StoredFrame
from tnst_mi.io.interpretation.roles import NONE, Wanted


def with_arrays_beside(file: Path, frame: StoredFrame, wanted: Wanted) -> StoredFrame:
    """A frame with the velocity and the obstacle that lie in other files of arrays.

    Raises:
        InputError: they cannot be used.
    """
    if frame.density is None:
        return frame
    velocity, obstacle = _found_beside(file, frame, wanted)
    cells = frame.density.shape
    if velocity:
        frame = _with_velocity_of(frame, velocity, velocity_beside(velocity, cells))
    if obstacle is not None:
        frame = _with_obstacle_of(frame, obstacle, obstacle_beside(obstacle, cells))
    return frame


def with_grids_beside(file: Path, frame: StoredFrame, context: SequenceContext, wanted: Wanted) -> StoredFrame:
    """A frame with the velocity and the obstacle that lie in other .vdb files.

    Raises:
        InputError: they cannot be used.
    """
    if frame.density is None:
        return frame
    velocity, obstacle = _found_beside(file, frame, wanted)
    if velocity:
        first, *others = velocity
        if first == companions.simulation_of(file):
            stored = read_simulation_of_noise(first, context.run, name=file.stem)
        else:
            stored = read_vdb_frame(first, context.run, name=file.stem, others=others)
        frame = _with_velocity_of(frame, velocity, stored)
    if obstacle is not None:
        frame = _with_obstacle_of(frame, obstacle, read_vdb_obstacle(obstacle, file.stem, context.run))
    return frame


def _found_beside(file: Path, frame: StoredFrame, wanted: Wanted) -> tuple[tuple[Path, ...], Path | None]:
    """The companions that hold what the file of a density does not."""
    velocity, obstacle = (), None
    if frame.velocity is None and wanted.velocity != NONE:
        velocity = companions.found_velocity(file)
    if frame.obstacle is None and wanted.obstacle != NONE:
        obstacle = companions.found_companion(file, companions.OBSTACLE)
    return velocity, obstacle


def _with_velocity_of(frame: StoredFrame, files: tuple[Path, ...], other: StoredFrame) -> StoredFrame:
    """A frame with the velocity that a companion holds, or three with a component each."""
    if other.velocity is None:
        raise InputError(f"{files[0]}: holds no velocity, which is looked for there; --velocity none goes without it")
    return replace(
        frame,
        velocity=other.velocity,
        staggered=other.staggered,
        from_faces=other.from_faces,
        known=other.known,
        velocity_units=other.velocity_units,
        dt=other.dt,
        velocity_cell=other.velocity_cell,
        taken=replace(frame.taken, velocity=companions.all_numberless(files)),
        layouts=(*frame.layouts, *other.layouts),
    )


def _with_obstacle_of(frame: StoredFrame, file: Path, other: StoredFrame) -> StoredFrame:
    """A frame with the obstacle that a companion holds."""
    if other.obstacle is None:
        raise InputError(f"{file}: holds no obstacle, as which its name has it read; --obstacle none goes without it")
    return replace(
        frame,
        obstacle=other.obstacle,
        taken=replace(frame.taken, obstacle=companions.numberless(file)),
        layouts=(*frame.layouts, *other.layouts),
    )
