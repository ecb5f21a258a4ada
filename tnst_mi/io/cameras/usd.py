"""Cameras in stages of USD (.usd, .usda, .usdc, .usdz), by Pixar's library, which the extra tnst_mi[usd] installs.

Places are taken in metres, as the stage says how long its unit is; what they are attached to, and their time samples,
are USD's own: between samples it interpolates. Time codes are the numbers of frames.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.errors import InputError, naming
from tnst_mi.io.cameras.scene_camera import SceneCamera, rigid
from tnst_mi.machine.gate import decoding, silenced
from tnst_mi.machine.terminal import quoted, some_of

#: Largest stage in bytes. Cameras take little of it, but scenes come with them.
_LONGEST = 1 << 30


@dataclass(frozen=True, eq=False)
class StageCameras:
    """A camera of a stage.

    Attributes:
        path: of the file.
        stage: opened.
        prim: the camera.
        span: the first and the last time code at which something about it is said, or None if it never changes.
    """

    path: Path
    stage: Any
    prim: Any
    span: tuple[float, float] | None

    def at(self, number: int | float | None, up: str) -> SceneCamera:
        """The camera of a frame, in a scene with `up`, "y" or "z", upwards.

        Raises:
            InputError: the frame lies outside the camera's time samples, or it is damaged.
        """
        if self.span is not None and number is None:
            raise InputError(f"{self.path}: its camera moves, and the smoke's frames have no numbers")
        if self.span is not None and number is not None and not self.span[0] <= number <= self.span[1]:
            first, last = self.span
            near = first if number < first else last
            raise InputError(
                f"{self.path}: has no camera for frame {number}; it goes from {first:g} to {last:g}, "
                f"of which {near:g} is the nearest"
            )
        with decoding(self.path, "a stage of USD"), silenced():
            return self._evaluated(number, up)

    def _evaluated(self, number: int | float | None, up: str) -> SceneCamera:
        usd, geometry = _module("Usd"), _module("UsdGeom")
        time = usd.TimeCode.EarliestTime() if self.span is None or number is None else usd.TimeCode(float(number))
        camera = geometry.Camera(self.prim).GetCamera(time)
        with naming(self.path):
            # USD's matrices are applied to rows.
            to_scene = rigid(np.array(camera.transform, np.float64).T)
            # Millimetres, or tenths of a scene's unit: of the same scale as the focal length.
            width, height = camera.horizontalAperture, camera.verticalAperture
            offsets = camera.horizontalApertureOffset, camera.verticalApertureOffset
            perspective = camera.projection == type(camera).Perspective
            numbers = (width, height, *offsets, camera.focalLength)
            if not (all(map(math.isfinite, numbers)) and min(width, height, camera.focalLength) > 0):
                raise InputError(
                    f"camera {self.prim.GetPath()}: apertures {width:g} and {height:g}, focal length "
                    f"{camera.focalLength:g}, expected numbers above 0"
                )
            if perspective:
                field = math.degrees(2 * math.atan(height / (2 * camera.focalLength)))
            else:
                field = height * type(camera).APERTURE_UNIT
        metres = float(geometry.GetStageMetersPerUnit(self.stage))
        shift = -offsets[0] / height, -offsets[1] / height
        stage_up = str(geometry.GetStageUpAxis(self.stage)).lower()
        return SceneCamera(to_scene, perspective, field, width / height, shift).scaled(metres).turned(stage_up, up)


def read_stage(path: Path, name: str | None) -> StageCameras:
    """Open a stage, and find its camera.

    Args:
        path: the file.
        name: the path of the camera's prim, or the prim's name; None for the only camera.

    Raises:
        InputError: USD is not installed, or there is no such camera, or there are several and none is named.
    """
    try:
        usd, geometry = _module("Usd"), _module("UsdGeom")
    except ImportError:
        raise InputError(
            f"{path}: cameras in USD need Pixar's library: pip install 'tnst_mi[usd]' (or usd-core)"
        ) from None
    if (size := path.stat().st_size) > _LONGEST:
        raise InputError(f"{path}: {size} bytes, expected a stage of at most {_LONGEST}; export the camera alone")
    with decoding(path, "a stage of USD"), silenced():
        # Payloads hold geometry, which can be large.
        stage = usd.Stage.Open(str(path), usd.Stage.LoadNone)
        cameras = {str(prim.GetPath()): prim for prim in stage.Traverse() if prim.IsA(geometry.Camera)}
    prim = cameras[_chosen(path, list(cameras), name)]
    with decoding(path, "a stage of USD"), silenced():
        times = _time_samples(geometry, prim)
    return StageCameras(path, stage, prim, (min(times), max(times)) if len(times) > 1 else None)


def _module(name: str) -> Any:
    return importlib.import_module(f"pxr.{name}")


def _chosen(path: Path, cameras: list[str], name: str | None) -> str:
    if not cameras:
        raise InputError(f"{path}: has no camera in it")
    found = [camera for camera in cameras if name is None or name in (camera, camera.rpartition("/")[2])]
    if len(found) == 1:
        return found[0]
    missing = "" if name is None or found else f"has no camera {quoted(name)}, but "
    raise InputError(f"{path}: {missing}has {some_of(found or cameras)}; name one: {path.name}#{cameras[0]}")


def _time_samples(geometry: Any, prim: Any) -> list[float]:
    """The time codes at which a camera, or what it is attached to, has samples."""
    times: set[float] = set()
    for attribute in prim.GetAttributes():
        times.update(attribute.GetTimeSamples())
    while prim.IsValid():
        if prim.IsA(geometry.Xformable):
            times.update(geometry.Xformable(prim).GetTimeSamples())
        prim = prim.GetParent()
    return sorted(times)
