"""What is written of a frame: its density, and pictures of it and of the views that were held out."""

from __future__ import annotations

import math
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.geometry.other_grids import OtherGrids
from tnst_mi.io.formats import write_frame
from tnst_mi.io.pictures.exr import write_exr
from tnst_mi.io.pictures.png import write_png
from tnst_mi.io.pictures.srgb import srgb
from tnst_mi.machine.interrupt import Interrupt
from tnst_mi.machine.progress_bar import progress_bar
from tnst_mi.reconstruction.fitting.smoke_colours import colour_steps
from tnst_mi.reconstruction.one_frame import FrameReconstruction, HeldOutView, mean_psnr
from tnst_mi.reconstruction.output.sides import three_sides
from tnst_mi.reconstruction.preparation import Preparation
from tnst_mi.reconstruction.resuming.records import density_file, frame_name

#: The grid of the smoke's colours, by the name that Houdini has for it.
COLOUR = "Cd"

#: By how much the third part of a picture, the difference, is brighter than the others.
_TIMES = 10


def in_colour(
    frame: FrameReconstruction, extinction: np.ndarray, levels: int, interrupt: Interrupt, shown: bool
) -> tuple[np.ndarray, np.ndarray] | None:
    """The extinction of a frame and its colours, with a progress bar; None if Ctrl-C was pressed."""
    with closing(progress_bar(total=colour_steps(levels), desc="colours", disable=not shown)) as bar:

        def goes_on() -> bool:
            bar.update(1)
            return not interrupt.requested

        return frame.in_colour(extinction, goes_on)


def write_frame_results(
    out: Path,
    prepared: Preparation,
    number: int | None,
    frame: FrameReconstruction,
    extinction: np.ndarray,
    colours: np.ndarray | None,
    seconds: float,
    finished: bool,
) -> dict[str, Any]:
    """Judge what was found of a frame, write its density and pictures, and give its record.

    Raises:
        OSError: something cannot be written.
    """
    name, file = frame_name(number), density_file(number, prepared.format)
    views = frame.judged(extinction, colours)
    gamma = prepared.settings.gamma_of(frame.brightness)
    density = extinction / np.float32(gamma)
    others = None if colours is None else OtherGrids.of_arrays({COLOUR: colours}, density.shape, name)
    write_frame(out / file, density, placement=prepared.place.placement, others=others)
    write_png(out / "images" / f"{name}_sides.png", srgb(np.clip(three_sides(extinction, colours), 0, 1)))
    for view in views:
        _write_pictures(out / "images" / f"{name}_{view.name}", view, frame.peak)
    value = mean_psnr(views)
    return {
        "name": name,
        "number": number,
        "density": str(file),
        "finished": finished,
        "psnr": _finite(value),
        "psnr_of_views": {view.name: _finite(view.psnr) for view in views if view.psnr is not None},
        "masked_views": [view.name for view in views if view.psnr is None],
        "gamma": gamma,
        # How bright smoke is that scatters light is up to the light.
        "brightness": None if prepared.settings.integrator == "prbvolpath" else frame.brightness,
        "background": frame.background,
        "peak": frame.peak,
        "noise": frame.noise,
        "mass": float(density.sum(dtype=np.float64)),
        "largest_density": float(density.max()),
        "mean_colour": None if colours is None else _mean_colour(density, colours),
        "seconds": round(seconds, 1),
    }


def _write_pictures(path: Path, view: HeldOutView, peak: float) -> None:
    """The rendering as EXR in the pictures' unit, and as PNG: picture, rendering, ten times the difference."""
    write_exr(path.with_name(f"{path.name}.exr"), view.rendering * peak, {"view": view.name})
    difference = np.abs(view.rendering - view.picture) * _TIMES
    side_by_side = np.concatenate([view.picture, view.rendering, difference], axis=1)
    write_png(path.with_name(f"{path.name}.png"), srgb(np.clip(side_by_side, 0.0, 1.0)))


def _mean_colour(density: np.ndarray, colours: np.ndarray) -> list[float]:
    """The mean over the smoke."""
    total = np.einsum("zyx,zyxc->c", density.astype(np.float64), colours)
    return (total / max(float(density.sum(dtype=np.float64)), 1e-30)).tolist()


def _finite(value: float | None) -> float | None:
    """A number that JSON can have: two images that are the same have no PSNR."""
    return value if value is not None and math.isfinite(value) else None
