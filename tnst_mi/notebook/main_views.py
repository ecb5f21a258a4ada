"""The main views of frames and results, as pictures for a notebook."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tnst_mi.fields.density_unit import scaled
from tnst_mi.frame import Frame
from tnst_mi.io.pictures.exr import read_exr
from tnst_mi.machine.backend import own_variant
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.driving import main_view, stills
from tnst_mi.rendering.exposure import exposure_for
from tnst_mi.rendering.levels import by_cell, full_level
from tnst_mi.rendering.smoke_colour import shown_colours, shown_grid
from tnst_mi.run.api import Result
from tnst_mi.run.inputs import reference_density
from tnst_mi.run.record import mass_change

#: Paths per pixel of a path-traced view that no file has: a notebook should not wait for a still.
_GLANCE_SPP = 16


@dataclass(frozen=True)
class ShownFrame:
    """A frame as it is shown.

    Attributes:
        name: of the frame.
        pictures: the smoke, or the smoke before and after its stylization: each (rows, columns), in colour
            (rows, columns, 3), 1 is white.
        told: what became of its loss and its mass, in words; empty for a frame that is not stylized.
    """

    name: str
    pictures: tuple[np.ndarray, ...]
    told: str = ""


def shown_frames(frames: list[Frame]) -> list[ShownFrame]:
    """Frames as the network sees them by default, in the unit of density of a run, the brightest pixel of all white."""
    factor = reference_density(frames).scale("auto")
    with own_variant():
        views = [main_view(scaled(frame.density, factor), by_cell(Recipe(), frame.density.shape)) for frame in frames]
    exposure = exposure_for(max((float(view.max()) for view in views), default=0.0))
    return [ShownFrame(frame.name, (exposure * view,)) for frame, view in zip(frames, views, strict=True)]


def shown_results(result: Result, chosen: Sequence[int]) -> list[ShownFrame]:
    """The chosen frames of a result before and after, exposed as in the run: the pictures in its folder, if it has one.

    Raises:
        InputError: a file of the result has been damaged or removed since the run.
    """
    return [
        ShownFrame(record["name"], _before_and_after(result, index), _told(record))
        for index, record in ((index, result.run["frames"][index]) for index in chosen)
    ]


def _told(record: dict[str, Any]) -> str:
    before, after, mass = record["loss_before"], record["loss_after"], mass_change(record)
    if before is None or after is None or mass is None:
        return "unchanged"
    return f"loss {before:.4g} → {after:.4g}, mass {mass:+.1%}"


def _before_and_after(result: Result, index: int) -> tuple[np.ndarray, np.ndarray]:
    record = result.run["frames"][index]
    if result.out is not None:
        images = result.out / "images"
        return read_exr(images / f"{record['name']}_before.exr"), read_exr(images / f"{record['name']}_after.exr")
    frame, factor = result.frames[index], result.run["density_scale"]
    recipe = by_cell(result.recipe.at(frame.number), frame.density.shape)
    shot = result.run.get("shots", {}).get(frame.name)
    recipe = replace(recipe, shots=() if shot is None else (tuple(shot),))
    size = full_level(result.recipe, frame.density.shape).size
    densities = frame.density, result.densities[index]
    name, hottest = None, None
    if recipe.colour != "off":
        name, hottest = shown_grid(tuple(result.grids[index]), result.run.get("temperature"))
    with own_variant():
        if name is None:
            first, last = (
                stills(scaled(density, factor), [recipe.main_view], recipe, size, _GLANCE_SPP)[0]
                for density in densities
            )
        else:
            first, last = (
                main_view(
                    scaled(density, factor),
                    recipe,
                    size,
                    shown_colours(grids, name, frame.name, density.shape, hottest),
                )
                for density, grids in zip(densities, (frame.grids, result.grids[index]), strict=True)
            )
    return record["exposure"] * first, record["exposure"] * last
