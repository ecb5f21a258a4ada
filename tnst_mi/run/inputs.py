"""Every accepted input, as a sequence of frames."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io.sequence import open_frames
from tnst_mi.recipe.recipe import Recipe

#: A file or folder, one frame, several, or a density grid (D, H, W).
Frames = str | Path | Frame | Sequence[Frame] | np.ndarray


def sequence_of(frames: Frames, recipe: Recipe) -> Sequence[Frame]:
    """The frames of an input; those in files are read on access.

    Raises:
        InputError: there are none, or they cannot be used.
    """
    if isinstance(frames, str | Path):
        return open_frames(frames, recipe.frame_range)
    if recipe.frames is not None:
        raise InputError(f"frames = {recipe.frames!r}: selects from a folder, but the frames were given as arrays")
    if isinstance(frames, np.ndarray):
        return [Frame(frames)]
    if isinstance(frames, Frame):
        return [frames]
    if not isinstance(frames, Sequence) or not frames or not all(isinstance(frame, Frame) for frame in frames):
        raise InputError("frames: expected a path, a density grid, or frames (tnst_mi.Frame)")
    return frames
