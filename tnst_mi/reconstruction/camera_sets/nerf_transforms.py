"""Cameras of a NeRF: `transforms.json` as instant-ngp, nerfstudio, COLMAP's converters and Blender's exporters have it.

Its matrices go from the camera to the scene, and its cameras look along −z with y up, as ours do. The format has no
specification; the keys are those of instant-ngp's `scripts/colmap2nerf.py` and of the NeRF authors' Blender sets.
"""

from __future__ import annotations

import json
import math
import reprlib
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.errors import InputError, naming
from tnst_mi.io.cameras.scene_camera import SceneCamera, rigid
from tnst_mi.reconstruction.camera_sets.posed_view import CameraSet, PosedView

#: Longest file in bytes: tens of thousands of views.
_LONGEST = 1 << 25

_DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")

#: Extensions that the names of pictures may lack, as in the NeRF authors' sets.
_EXTENSIONS = (".png", ".exr", ".jpg")


def read_transforms(path: Path) -> CameraSet:
    """Read a file of a NeRF.

    Raises:
        InputError: it is too large, holds something else, or its lenses distort.
        ValueError: it is no JSON.
        OSError: it cannot be read.
    """
    if (size := path.stat().st_size) > _LONGEST:
        raise InputError(f"{path}: {size} bytes, expected a transforms.json of at most {_LONGEST}")
    with naming(path):
        values = json.loads(path.read_bytes().decode("utf-8-sig"))
        frames = values.get("frames") if isinstance(values, dict) else None
        if not isinstance(frames, list) or not frames or not all(isinstance(frame, dict) for frame in frames):
            raise InputError('expected the transforms.json of a NeRF, with a list "frames" of views')
        shared = {key: value for key, value in values.items() if key != "frames"}
        views = [_view(number, shared | frame, path.parent) for number, frame in enumerate(frames)]
        if len({view.name.casefold() for view in views}) < len(views):
            views = [PosedView(f"{number:04d}_{v.name}", v.image, v.camera, v.mask) for number, v in enumerate(views)]
    return CameraSet(path, "z", views, remarks=("its scene is taken with z up, as NeRFs have it",))


def _view(number: int, table: Mapping[str, Any], folder: Path) -> PosedView:
    name = table.get("file_path")
    with naming(Path(f"frame {number} ({reprlib.repr(name)})")):
        image, mask = _file("file_path", name, folder), table.get("mask_path")
        if image.suffix.lower() not in _EXTENSIONS and not image.is_file():
            image = next((found for e in _EXTENSIONS if (found := Path(f"{image}{e}")).is_file()), image)
        if distorted := [key for key in _DISTORTION if table.get(key)]:
            raise InputError(
                f"{distorted[0]} = {reprlib.repr(table[distorted[0]])}: the lens distorts, expected pictures without; "
                "undistort them first (colmap image_undistorter)"
            )
        try:
            matrix = rigid(np.array(table.get("transform_matrix"), np.float64).reshape(4, 4))
        except (TypeError, ValueError):
            raise InputError("transform_matrix: expected 4 rows of 4 numbers") from None
        camera = partial(_camera, matrix, dict(table))
        camera((1, 1))
        return PosedView(image.stem, image, camera, None if mask is None else _file("mask_path", mask, folder))


def _file(key: str, value: Any, folder: Path) -> Path:
    if not isinstance(value, str) or not value or "\0" in value:
        raise InputError(f"{key} = {reprlib.repr(value)}: expected the name of a file")
    return folder / value


def _camera(matrix: np.ndarray, table: Mapping[str, Any], size: tuple[int, int]) -> SceneCamera:
    """The camera of a view whose picture has (width, height) pixels; lengths in the file are in pixels of `w` × `h`."""
    width, height = (_number(table, key, 1, 1e6, default) for key, default in zip(("w", "h"), size, strict=True))
    if "fl_x" in table or "fl_y" in table:
        fl_y = _number(table, "fl_y" if "fl_y" in table else "fl_x", 1e-3, 1e9)
        fl_x = _number(table, "fl_x" if "fl_x" in table else "fl_y", 1e-3, 1e9)
    elif "camera_angle_x" in table:
        fl_x = fl_y = width / (2 * math.tan(_number(table, "camera_angle_x", 1e-3, 3.1) / 2))
    else:
        raise InputError("expected fl_x (and fl_y), in pixels, or camera_angle_x")
    cx, cy = (_number(table, key, -1e6, 1e6, n / 2) for key, n in (("cx", width), ("cy", height)))
    field = math.degrees(2 * math.atan(height / (2 * fl_y)))
    # Pixels that are not square make a picture of another aspect. Rows are counted downwards.
    shift = (cx - width / 2) * (fl_y / fl_x) / height, (height / 2 - cy) / height
    return SceneCamera(matrix, True, field, width / height * (fl_y / fl_x), shift)


def _number(table: Mapping[str, Any], key: str, low: float, high: float, default: float | None = None) -> float:
    value = table.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise InputError(f"{key} = {reprlib.repr(value)}: expected a number from {low:g} to {high:g}")
    return float(value)
