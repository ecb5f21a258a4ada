"""Every accepted input, as a sequence of frames; and frames in another unit of density."""

from __future__ import annotations

import hashlib
from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import overload

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.density_unit import ReferenceDensity, scaled
from tnst_mi.frame import Frame
from tnst_mi.io.interpretation.conventions import Boxing, Conventions
from tnst_mi.io.interpretation.roles import Wanted
from tnst_mi.io.sequence import open_frames
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.sections import Reading

#: A file or folder, one frame, several, or a density grid (D, H, W).
Frames = str | Path | Frame | Sequence[Frame] | np.ndarray


def sequence_of(frames: Frames, recipe: Recipe) -> Sequence[Frame]:
    """The frames of an input; those in files are read on access.

    Raises:
        InputError: there are none, or they cannot be used.
    """
    if isinstance(frames, str | Path):
        span, conventions = recipe.frame_range, conventions_of(recipe)
        files = open_frames(frames, span, conventions)
        if span is None or recipe.context == 0:
            return files
        first, last = span[0] - recipe.context, span[1] + recipe.context
        there = [number for number in files.numbers_there if first <= number <= last and type(number) is type(span[0])]
        return open_frames(frames, (there[0], there[-1]), conventions) if there else files
    if recipe.frames is not None:
        raise InputError(f"frames = {recipe.frames!r}: selects from a folder, but the frames were given as arrays")
    for key in Reading.__annotations__:
        if (value := getattr(recipe, key)) != getattr(Recipe(), key):
            raise InputError(f"{key} = {value!r}: says how files are read, but the frames were given as arrays")
    if isinstance(frames, np.ndarray):
        return [Frame(frames)]
    if isinstance(frames, Frame):
        return [frames]
    if not isinstance(frames, Sequence) or not frames or not all(isinstance(frame, Frame) for frame in frames):
        raise InputError("frames: expected a path, a density grid, or frames (tnst_mi.Frame)")
    return frames


def conventions_of(recipe: Recipe) -> Conventions:
    """What a recipe says about the reading of files."""
    return Conventions(
        up=recipe.up,
        flip=(recipe.flip or "").replace(",", ""),
        velocity_units=recipe.units,
        dt=recipe.dt,
        fps=recipe.fps,
        voxel_size=recipe.voxel_size,
        scale=recipe.scale,
        origin=recipe.origin,
        names=Wanted(recipe.density, recipe.velocity, recipe.obstacle),
        box=Boxing(recipe.crop, recipe.ignore_stray),
        fog=recipe.fog,
    )


class FramesOnAccess(Sequence[Frame]):
    """Frames that are made when they are asked for, and parts of them, which are made no earlier."""

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Frame]: ...
    def __getitem__(self, index: int | slice) -> Frame | Sequence[Frame]:
        """A frame, or several."""
        return self._part(index) if isinstance(index, slice) else self._frame(index)

    @abstractmethod
    def _frame(self, index: int) -> Frame:
        """The frame of an index."""

    @abstractmethod
    def _part(self, chosen: slice) -> Sequence[Frame]:
        """The chosen frames, to be made on access."""


class ScaledFrames(FramesOnAccess):
    """Frames with their densities, or their velocities, scaled, on access.

    Args:
        frames: the frames as they are stored.
        factor: of the densities.
        velocity_factor: of the velocities.
    """

    def __init__(self, frames: Sequence[Frame], factor: float = 1.0, velocity_factor: float = 1.0) -> None:
        self._frames, self._factor, self._velocity_factor = frames, factor, velocity_factor

    def __len__(self) -> int:
        """Number of frames."""
        return len(self._frames)

    def _part(self, chosen: slice) -> ScaledFrames:
        return ScaledFrames(self._frames[chosen], self._factor, self._velocity_factor)

    def _frame(self, index: int) -> Frame:
        frame, velocity = self._frames[index], None
        if frame.velocity is not None:
            velocity = scaled(frame.velocity, self._velocity_factor)
        return replace(frame, density=scaled(frame.density, self._factor), velocity=velocity)


class UnchangedFrames(FramesOnAccess):
    """Frames that are checked on access to be those that were measured: files can change while a run reads them again.

    Their other grids are not read for that: they are checked when they are carried.

    Args:
        frames: the frames.
        digests: their SHA-256, see `frame_digest`, in their order.
    """

    def __init__(self, frames: Sequence[Frame], digests: Sequence[str]) -> None:
        self._frames, self._digests = frames, digests

    def __len__(self) -> int:
        """Number of frames."""
        return len(self._frames)

    def _part(self, chosen: slice) -> UnchangedFrames:
        return UnchangedFrames(self._frames[chosen], self._digests[chosen])

    def _frame(self, index: int) -> Frame:
        """The frame; raises InputError if it is not what it was."""
        frame = self._frames[index]
        if frame_digest(frame) != self._digests[index]:
            raise InputError(changed(frame.name))
        return frame


def frame_digest(frame: Frame) -> str:
    """The SHA-256 of a frame's arrays, without its other grids."""
    digest = hashlib.sha256(frame.density.data)
    for array in (frame.velocity, frame.obstacle):
        if array is not None:
            digest.update(array.data)
    return digest.hexdigest()


def grid_digest(values: np.ndarray) -> str:
    """The SHA-256 of a grid beside the density."""
    return hashlib.sha256(np.ascontiguousarray(values).data).hexdigest()


def changed(what: str) -> str:
    """The message that a part of the input is not what was measured."""
    return (
        f"{what}: has changed since the run began; restore it and go on with --resume, or begin anew with --overwrite"
    )


def reference_density(frames: Iterable[Frame]) -> ReferenceDensity:
    """The reference density of some frames, each of which is read once."""
    reference = ReferenceDensity()
    for frame in frames:
        reference.add(frame.density)
    return reference
