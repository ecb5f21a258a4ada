"""Cameras in stages of USD (.usd, .usda, .usdc, .usdz), by Pixar's library, which the extra tnst_mi[usd] installs.

Places are taken in metres, as the stage says how long its unit is; what they are attached to, and their time samples,
are USD's own: between samples it interpolates. Time codes are the numbers of frames. The library runs in another
process (`usd_process`); what it finds is checked here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from tnst_mi.errors import InputError, naming
from tnst_mi.io.cameras.scene_camera import SceneCamera, rigid
from tnst_mi.io.cameras.usd_process import StageAnswer, StageCamera, StageSample, ask
from tnst_mi.machine.gate import decoding
from tnst_mi.machine.terminal import quoted, some_of

#: Largest stage in bytes. Cameras take little of it, but scenes come with them.
_LONGEST = 1 << 30

#: Apertures of orthographic cameras are in tenths of the scene's unit.
_APERTURE_UNIT = 0.1


@dataclass(frozen=True, eq=False)
class StageCameras:
    """A camera of a stage.

    Attributes:
        path: of the file.
        prim: the path of the camera in it.
        found: what is known of it; its samples become more with the frames that are asked for.
    """

    path: Path
    prim: str
    found: StageCamera

    def at(self, number: int | float | None, up: str) -> SceneCamera:
        """The camera of a frame, in a scene with `up`, "y" or "z", upwards.

        Raises:
            InputError: the frame lies outside the camera's time samples, or it is damaged.
        """
        span = self.found.span
        if span is not None and number is None:
            raise InputError(f"{self.path}: its camera moves, and the smoke's frames have no numbers")
        if span is not None and number is not None and not span[0] <= number <= span[1]:
            first, last = span
            near = first if number < first else last
            raise InputError(
                f"{self.path}: has no camera for frame {number}; it goes from {first:g} to {last:g}, "
                f"of which {near:g} is the nearest"
            )
        with decoding(self.path, "a stage of USD"):
            sample = self._sample(None if span is None or number is None else float(number))
            with naming(self.path):
                return self._camera(sample).turned(_up_axis(self.found.up), up)

    def _sample(self, frame: float | None) -> StageSample:
        """The camera at a frame; the library is asked again if it was not among those that came with another."""
        if frame not in self.found.samples:
            again = ask(self.path, self.prim, frame).camera
            if again is None or frame not in again.samples:
                raise InputError(f"{self.path}: has changed since it was opened; start again")
            self.found.samples.update(again.samples)
        return self.found.samples[frame]

    def _camera(self, sample: StageSample) -> SceneCamera:
        """The camera in metres, in the axes of the stage."""
        to_scene, metres = rigid(sample.matrix), self.found.metres
        (width, height), focal_length = sample.apertures, sample.focal_length
        numbers = (width, height, *sample.offsets, focal_length)
        if not (all(map(math.isfinite, numbers)) and min(width, height, focal_length) > 0):
            raise InputError(
                f"camera {self.prim}: apertures {width:g} and {height:g}, focal length {focal_length:g}, expected "
                "numbers above 0"
            )
        if not (math.isfinite(metres) and metres > 0):
            raise InputError(f"metersPerUnit = {metres:g}: expected a number above 0")
        if sample.perspective:
            field = math.degrees(2 * math.atan(height / (2 * focal_length)))
        else:
            field = height * _APERTURE_UNIT
        shift = -sample.offsets[0] / height, -sample.offsets[1] / height
        return SceneCamera(to_scene, sample.perspective, field, width / height, shift).scaled(metres)


def read_stage(path: Path, name: str | None) -> StageCameras:
    """Open a stage, and find its camera.

    Args:
        path: the file.
        name: the path of the camera's prim, or the prim's name; None for the only camera.

    Raises:
        InputError: USD is not installed, or there is no such camera, or there are several and none is named; or the
            stage takes too much time or memory.
        ValueError: it is damaged.
    """
    if (size := path.stat().st_size) > _LONGEST:
        raise InputError(f"{path}: {size} bytes, expected a stage of at most {_LONGEST}; export the camera alone")
    answer = ask(path, name, None)
    if answer.camera is None:
        raise InputError(_which(path, answer, name))
    return StageCameras(path, answer.matching[0], answer.camera)


def _which(path: Path, answer: StageAnswer, name: str | None) -> str:
    """Why none of the cameras was taken, in words."""
    if not answer.cameras:
        return f"{path}: has no camera in it"
    missing = "" if name is None or answer.matching else f"has no camera {quoted(name)}, but "
    found = some_of(answer.matching or answer.cameras)
    return f"{path}: {missing}has {found}; name one: {path.name}#{answer.cameras[0]}"


def _up_axis(stated: str) -> str:
    if stated not in ("Y", "Z"):
        raise InputError(f"upAxis = {quoted(stated)}: expected Y or Z")
    return stated.lower()
