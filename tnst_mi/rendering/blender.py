"""Pictures of a look by Blender's Cycles: the smoke, fire, lights and camera of the studio, in another renderer.

`data/blender_studio.py` runs inside Blender and builds the scene; it gets the smoke as a VDB file and all else from the
files of the look.
"""

from __future__ import annotations

import json
import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from tnst_mi.fields.grid import Shape
from tnst_mi.frame import Frame
from tnst_mi.geometry.placement import Placement
from tnst_mi.io.pictures.exr import read_linear
from tnst_mi.io.pictures.png import srgb
from tnst_mi.io.sequence import save_frame
from tnst_mi.machine.blender import require_blender, run_in_blender
from tnst_mi.rendering.albedo import albedo_of
from tnst_mi.rendering.cameras.views import View
from tnst_mi.rendering.fire import Fire
from tnst_mi.rendering.looks import extinction, look_file
from tnst_mi.rendering.smoke_colour import colours_of
from tnst_mi.rendering.studio_camera import field_of_view, ground_height, stand
from tnst_mi.resources import DATA, scene_file

_SCRIPT = DATA / "blender_studio.py"

#: Paths per pixel with which time is measured.
_FEW = (1, 4)

#: More of them hardly add light; Mitsuba goes on to 128.
_BOUNCES = 48


@dataclass(frozen=True)
class BlenderPainter:
    """Pictures (height, width, 3) of frames in the studio of a look, by Blender.

    Args:
        shape: (D, H, W) of all frames.
        views: all views that will be rendered, in degrees.
        look: "thin", "medium" or "thick".
        size: (width, height) in pixels.
        samples: paths per pixel.
        fire: what burns in the frames, if anything.
        colour: the name of the grid that colours them, if any.

    Raises:
        InputError: Blender is not installed.
    """

    shape: Shape
    views: Sequence[View]
    look: str
    size: tuple[int, int]
    samples: int
    seed: int
    fire: Fire | None
    colour: str | None = None

    def __post_init__(self) -> None:
        """Look for Blender."""
        require_blender()

    def paint(self, frame: Frame, view: View, number: int) -> np.ndarray:
        """Radiance; 1 is white.

        Raises:
            RuntimeError: Blender fails.
        """
        return self._rendered(frame, view, [self.samples], number)[0]

    def shown(self, image: np.ndarray) -> np.ndarray:
        """The image after the sRGB curve."""
        return srgb(image)

    def seconds(self, frame: Frame, view: View) -> float:
        """Measured with few and with some more paths per pixel: to start and to load takes Blender time as well."""
        start = time.perf_counter()
        _, (few, more) = self._rendered(frame, view, _FEW, 0)
        each = max(more - few, 0.0) / (_FEW[1] - _FEW[0])
        return time.perf_counter() - start - more + each * (self.samples - _FEW[0])

    def _rendered(
        self, frame: Frame, view: View, samples: Sequence[int], number: int
    ) -> tuple[np.ndarray, list[float]]:
        """A picture with the last of some numbers of paths per pixel, and the seconds that Cycles took for each."""
        with tempfile.TemporaryDirectory(prefix="tnst_mi-") as name:
            folder = Path(name)
            self._write(folder / "smoke.vdb", frame)
            settings = {
                **self._scene(view),
                "volume": str(folder / "smoke.vdb"),
                "out": str(folder / "picture.exr"),
                "samples": list(samples),
                "seed": (self.seed + number) % 2**31,
            }
            (folder / "settings.json").write_text(json.dumps(settings), "utf-8")
            lines: list[str] = []
            code = run_in_blender(_SCRIPT, [str(folder / "settings.json")], lines.append)
            seconds = [float(line.split()[1]) for line in lines if line.startswith("seconds ")]
            if code or len(seconds) != len(samples):
                told = next((line for line in reversed(lines) if line.strip()), "it said nothing")
                raise RuntimeError(f"Blender ended with code {code}: {told}")
            return read_linear(folder / "picture.exr", math.prod(self.size)), seconds

    def _write(self, file: Path, frame: Frame) -> None:
        """Write the smoke, emission and colour of a frame, its longest edge as 1 and its centre as the origin."""
        d, h, w = self.shape
        cell = 1 / max(self.shape)
        # Cycles takes the place of a voxel, which is its centre, as that of its lowest corner.
        corner = tuple(-n / 2 * cell for n in (w, d, h))
        grids = {} if self.fire is None else {"emission_color": self.fire.emission(frame)}
        if self.colour is not None and self.colour in frame.grids:
            grids["Cd"] = albedo_of(colours_of(frame.grids, self.colour, frame.name), 1.0)
        save_frame(
            file, Frame(frame.density, placement=Placement(cell, (corner[0], corner[1], corner[2])), grids=grids)
        )

    def _scene(self, view: View) -> dict[str, Any]:
        """The settings that come from the files of the look and from the view."""
        studio, look = (
            ElementTree.parse(file).getroot() for file in (scene_file("looks/studio.xml"), look_file(self.look))
        )
        lamps = [_lamp(_found(studio, f"shape[@id='{name}']")) for name in ("key", "rim")]
        azimuth, elevation, distance = stand(view, self.shape)
        return {
            "azimuth": azimuth,
            "elevation": elevation,
            "distance": distance,
            "field_of_view": field_of_view(self.shape, self.views, self.size),
            "size": self.size,
            "bounces": _BOUNCES,
            "extinction": extinction(self.look),
            "albedo": float(_found(look, "default[@name='albedo']").attrib["value"]),
            "lamps": lamps,
            "floor": ground_height(self.shape),
            "reflectance": _numbers(_found(studio, "shape[@id='ground']/bsdf/rgb").attrib["value"]),
            "sky": str(scene_file("looks/sky.exr").resolve()),
        }


def _lamp(shape: ElementTree.Element) -> dict[str, Any]:
    """A rectangular light of the studio, z up."""
    scale, place = _found(shape, "transform/scale"), _found(shape, "transform/lookat")
    x, y, z = _numbers(place.attrib["origin"])
    return {
        "scale": [float(scale.attrib[axis]) for axis in "xy"],
        "origin": [x, -z, y],
        "radiance": _numbers(_found(shape, "emitter/rgb").attrib["value"]),
    }


def _found(root: ElementTree.Element, path: str) -> ElementTree.Element:
    element = root.find(path)
    assert element is not None, path
    return element


def _numbers(text: str) -> list[float]:
    return [float(part) for part in text.split(",")]
