"""Descriptions for `mi.load_dict`: the medium of one grid, and a Mitsuba scene around it.

World units are full-resolution cells; the grid's centre is the origin. The density becomes the extinction σ_t = γ d
of a `heterogeneous` medium.
"""

from __future__ import annotations

import math
from typing import Any

import mitsuba as mi
import numpy as np

from tnst_mi.fields.grid import Shape

#: Majorant of the medium. The `emission_absorption` integrator needs none; with a fixed one, Mitsuba does not read the
#: maximum back to the host after each change of the density.
_MAJORANT = 1e6


def medium_description(shape: Shape, h: float) -> dict[str, Any]:
    """A medium on a grid (D, H, W) of cells of size h, in full-resolution cells; its density is initially 0."""
    d, rows, columns = shape
    return {
        "type": "heterogeneous",
        "albedo": 0.0,
        "sigma_t": {
            "type": "gridvolume",
            "grid": mi.VolumeGrid(np.zeros((d, rows, columns, 1), np.float32)),
            # gridvolume fills the unit cube [0, 1]³.
            "to_world": mi.ScalarTransform4f().scale([columns * h, rows * h, d * h]).translate(-0.5),
            "max_value": _MAJORANT,
            # GPU textures interpolate with 8-bit weights.
            "accel": False,
        },
    }


def view_distance(shape: Shape, h: float) -> float:
    """Distance of the ray origins of a view from the grid's centre: outside the grid in every view."""
    d, rows, columns = shape
    return 2 * math.hypot(columns * h / 2, rows * h / 2, d * h / 2) + h


def scene_description(
    shape: Shape,
    gamma: float,
    quadrature: str,
    h: float,
    view_count: int,
    step: float | None = None,
    size: tuple[int, int] | None = None,
) -> dict[str, Any]:
    """Box, medium, sensor and integrator; the density is initially 0.

    Args:
        shape: (D, H, W) of the grid.
        gamma: ratio γ of extinction to density, per full-resolution cell.
        quadrature: one of `tnst_mi.choices.QUADRATURES`.
        h: size of a cell in full-resolution cells.
        view_count: number of views stacked in the image.
        step: distance between the samples of a ray in full-resolution cells; h if None.
        size: rows and columns of a view; those of the grid if None.
    """
    half = [n * h / 2 for n in shape[::-1]]
    rows, columns = size or shape[1:]
    return {
        "type": "scene",
        "integrator": {"type": "emission_absorption", "gamma": gamma, "quadrature": quadrature, "step": step or h},
        "sensor": {
            "type": "camera_views",
            "view_count": view_count,
            "spacing": h,
            "distance": view_distance(shape, h),
            "film": {
                "type": "hdrfilm",
                "width": columns,
                "height": rows * view_count,
                "pixel_format": "luminance",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
            # One sample at the centre of each pixel: the image is free of noise.
            "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
        },
        "smoke": {
            "type": "cube",
            "to_world": mi.ScalarTransform4f().scale(half),
            "bsdf": {"type": "null"},
            "interior": medium_description(shape, h),
        },
    }
