"""What `compare` is given: the density of the first frame, and the views that it is seen from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tnst_mi.commands.base import Unit, cameras_of, checked, given, say, unit_of, view_of
from tnst_mi.commands.compare_arguments import COMPARE_VIEWS, CompareArguments
from tnst_mi.errors import InputError
from tnst_mi.fields.density_unit import scaled
from tnst_mi.io import open_frames
from tnst_mi.recipe.keys import Number
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.shots import camera_of, shot_view
from tnst_mi.rendering.cameras.views import View
from tnst_mi.run.inputs import conventions_of
from tnst_mi.run.readable import Readable


@dataclass(frozen=True, eq=False)
class ComparedSmoke:
    """The first frame of an input.

    Attributes:
        name: of the frame.
        density: (D, H, W) float32, somewhere > 0, in the unit of the comparison.
        views: what it is seen from.
        unit: of the density.
        readable: the frames that were read.
    """

    name: str
    density: np.ndarray
    views: tuple[View, ...]
    unit: Unit
    readable: Readable

    def note(self) -> None:
        """Say on stderr how it was read."""
        say(self.readable.lines())
        self.unit.note()


def views_and_gammas(arguments: CompareArguments) -> tuple[tuple[View, ...], tuple[float, ...]]:
    """Of --views and --gamma.

    Raises:
        InputError: one is invalid, or there are none, or the same twice.
    """
    views = tuple(view_of(text) for text in arguments.views)
    gammas = tuple(checked("gamma", text, Number(above=0.0, high=1e4)) for text in arguments.gamma)
    for flag, values in (("views", views), ("gamma", gammas)):
        if len(set(values)) < max(len(values), 1):
            raise InputError(f"--{flag}: expected one or more different values")
    return views, gammas


def read_smoke(arguments: CompareArguments, views: tuple[View, ...]) -> ComparedSmoke:
    """Read the first frame; `views` are those of --views, in whose place --camera may stand.

    Raises:
        InputError: it cannot be read, or its density is 0 everywhere.
    """
    recipe = Recipe().updated_by_flags(given(arguments.reading))
    camera = arguments.camera
    cameras = None if camera is None else cameras_of(camera, arguments.views, COMPARE_VIEWS, recipe.flip)
    readable = Readable(open_frames(arguments.input, recipe.frame_range, conventions_of(recipe))[:1])
    frame = next(iter(readable))
    if cameras is not None:
        shape = frame.density.shape
        views = (shot_view(camera_of(cameras, frame, shape), shape).view,)
    unit = unit_of([frame], arguments.density_scale)
    density = scaled(frame.density, unit.factor)
    if not density.any():
        raise InputError(f"{arguments.input}: the density is 0 everywhere, expected smoke to compare renderers on")
    return ComparedSmoke(frame.name, density, views, unit, readable)
