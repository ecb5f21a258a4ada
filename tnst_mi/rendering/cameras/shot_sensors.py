"""The camera of a shot as Mitsuba's own sensors, for path tracing; `sensor` is for images of many viewpoints."""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np

from tnst_mi.fields.kernels import opaque
from tnst_mi.rendering.cameras.camera import Camera

#: How far from the camera rays start. Mitsuba's own 0.01 is a few cells of the studio, whose longest edge is 1.
NEAR = 1e-4

#: Where rays end. The studio's ground ends at 200.
_FAR = 1e6

#: Mitsuba's sensors look along +z with x to the left, a shot's camera along −z with x to the right.
_AXES = np.diag([-1.0, 1.0, -1.0, 1.0])


class ShotSensors:
    """A perspective and an orthographic sensor that are placed as the cameras of a shot, without compiling anew.

    Args:
        size: (width, height) of their pictures in pixels, in the proportions of the cameras.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self._proportion = size[0] / size[1]
        film = {
            "type": "hdrfilm",
            "width": size[0],
            "height": size[1],
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        }
        self._perspective, self._orthographic = (
            mi.load_dict(
                {"type": kind, "near_clip": NEAR, "far_clip": _FAR, "film": film, "sampler": {"type": "independent"}}
            )
            for kind in ("perspective", "orthographic")
        )

    def placed(self, camera: Camera) -> mi.Sensor:
        """The sensor of a camera that stands in Mitsuba's world; the next call may place it elsewhere."""
        to_world = np.array(camera.to_world)
        if camera.perspective:
            sensor, parameters = self._perspective, mi.traverse(self._perspective)
            slope = math.tan(math.radians(camera.field) / 2)
            parameters["x_fov"] = opaque(2 * math.degrees(math.atan(slope * self._proportion)))
            # From the optical axis to the middle of the picture, to the right and down, in parts of width and height.
            parameters["principal_point_offset_x"] = opaque(-camera.shift[0] / self._proportion)
            parameters["principal_point_offset_y"] = opaque(camera.shift[1])
            place = to_world @ _AXES
        else:
            sensor, parameters = self._orthographic, mi.traverse(self._orthographic)
            right, up, _ = camera.axes
            to_world[:3, 3] -= camera.field * (camera.shift[0] * right + camera.shift[1] * up)
            # The picture is 2 wide before it is scaled.
            half = camera.field * self._proportion / 2
            place = to_world @ _AXES @ np.diag([half, half, 1.0, 1.0])
        parameters["to_world"] = mi.Transform4f(place)
        parameters.update()
        return sensor
