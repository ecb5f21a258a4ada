"""What is written of a frame: its density, and pictures of it and of the views that were held out."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.io.formats import write_frame
from tnst_mi.io.pictures.exr import write_exr
from tnst_mi.io.pictures.png import write_png
from tnst_mi.io.pictures.srgb import srgb
from tnst_mi.reconstruction.descent import Descent
from tnst_mi.reconstruction.one_frame import FrameReconstruction, HeldOutView, mean_psnr
from tnst_mi.reconstruction.preparation import Preparation
from tnst_mi.reconstruction.sides import three_sides

#: By how much the third part of a picture, the difference, is brighter than the others.
_TIMES = 10


def write_frame_results(
    out: Path,
    format: str,
    prepared: Preparation,
    number: int | None,
    frame: FrameReconstruction,
    descent: Descent,
    seconds: float,
    finished: bool,
) -> dict[str, Any]:
    """Judge what was found of a frame, write its density and pictures, and give its record.

    Raises:
        OSError: something cannot be written.
    """
    name = "smoke" if number is None else f"smoke_{number:04d}"
    extinction = frame.full_extinction(descent)
    views = frame.judged(extinction)
    gamma = prepared.settings.gamma_of(frame.brightness)
    density = extinction / np.float32(gamma)
    file = Path("density") / f"{name}.{format}"
    write_frame(out / file, density, placement=prepared.place.placement)
    write_png(out / "images" / f"{name}_sides.png", srgb(three_sides(extinction)))
    for view in views:
        _write_pictures(out / "images" / f"{name}_{view.name}", view, frame.peak)
    value = mean_psnr(views)
    return {
        "name": name,
        "number": number,
        "density": file.as_posix(),
        "finished": finished,
        "psnr": _finite(value),
        "psnr_of_views": {view.name: _finite(view.psnr) for view in views},
        "gamma": gamma,
        "brightness": frame.brightness,
        "background": frame.background,
        "peak": frame.peak,
        "noise": frame.noise,
        "mass": float(density.sum(dtype=np.float64)),
        "largest_density": float(density.max()),
        "seconds": round(seconds, 1),
    }


def _write_pictures(path: Path, view: HeldOutView, peak: float) -> None:
    """The rendering as EXR in the pictures' unit, and as PNG: picture, rendering, ten times the difference."""
    write_exr(path.with_name(f"{path.name}.exr"), view.rendering * peak, {"view": view.name})
    difference = np.abs(view.rendering - view.picture) * _TIMES
    side_by_side = np.concatenate([view.picture, view.rendering, difference], axis=1)
    write_png(path.with_name(f"{path.name}.png"), srgb(np.clip(side_by_side, 0.0, 1.0)))


def _finite(value: float | None) -> float | None:
    """A number that JSON can have: two images that are the same have no PSNR."""
    return value if value is not None and math.isfinite(value) else None
