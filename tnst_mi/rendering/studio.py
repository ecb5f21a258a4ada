"""Beauty renders: smoke lit in the studio of `scenes/looks`, with multiple scattering, by Mitsuba's path tracers.

A look is a Mitsuba XML scene; the smoke, its position and the picture size are its parameters. World units: the longest
edge of the grid is 1 and its centre is the origin, so that one set of lights fits grids of any size. Camera, lights and
sky turn together with the azimuth, as if the smoke stood on a turntable: every view is lit from the same side, and so
is every frame of a shot, whose camera may stand anywhere above the ground and outside the smoke.
"""

from __future__ import annotations

import functools
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.bounds import Region, hull, smoke_box
from tnst_mi.fields.grid import Shape
from tnst_mi.fields.kernels import opaque
from tnst_mi.machine.backend import on_gpu
from tnst_mi.machine.garbage import collection_paused
from tnst_mi.machine.optix import require_optix
from tnst_mi.rendering.albedo import ALBEDO, albedo_of, load_coloured
from tnst_mi.rendering.cameras.camera import Camera, Viewpoint
from tnst_mi.rendering.cameras.shot_sensors import ShotSensors
from tnst_mi.rendering.fire_light import FireLight
from tnst_mi.rendering.looks import camera_distance, look_file
from tnst_mi.rendering.studio_camera import field_of_view, ground_height, require_place, stand

_DENSITY = "smoke.interior_medium.sigma_t.data"
_CAMERA = "camera.to_world"
_ZOOM = "camera.x_fov"

#: Majorant of the density, relative to the largest density. Derivatives of `prbvolpath` need the slack.
_SLACK = 1.1

#: What turns the seed of the lights' paths into that of the fire's.
_OTHER_STREAM = 0x5BD1E995


@dataclass(frozen=True)
class Smoke:
    """What all frames of a sequence have in common.

    Attributes:
        shape: (D, H, W) of their grids.
        largest: the largest density.
        occupied: the box that contains all smoke and one cell around it, or the whole grid if there is none; path
            tracing is slow inside it and fast elsewhere.
    """

    shape: Shape
    largest: float
    occupied: Region

    @classmethod
    def of(cls, densities: Iterable[np.ndarray]) -> Smoke:
        """Scan densities (D, H, W), one at a time.

        Raises:
            InputError: there are none, or their shapes differ.
        """
        shape, largest, boxes = None, 0.0, []
        for density in densities:
            if shape is not None and density.shape != shape:
                raise InputError(f"render: a frame of shape {density.shape} after ones of {shape}, expected one shape")
            shape = density.shape
            largest = max(largest, float(density.max()))
            box = smoke_box(density, 1)
            boxes += [] if box is None else [box]
        if shape is None:
            raise InputError("render: no frames given, expected one or more")
        d, h, w = shape
        return cls((d, h, w), largest, hull(boxes) if boxes else (slice(0, d), slice(0, h), slice(0, w)))


class Studio:
    """The scene of a look, loaded once and rendered with any of its frames from any of its viewpoints.

    Args:
        look: "thin", "medium" or "thick".
        integrator: "volpath" or "prbvolpath".
        smoke: what the frames have in common.
        viewpoints: all that will be rendered: views in degrees, with their distance in cells or from the studio's own,
            and cameras of shots. One zoom shows the whole grid in each view; cameras of shots have their own framing.
        size: (width, height) of the pictures in pixels.
        burns: whether frames have an emission, see `tnst_mi.rendering.fire`; then `smoke.occupied` contains it.
        coloured: whether frames have a colour, by which the albedo of the look is multiplied.

    Attributes:
        sensor: the one with which the viewpoint is rendered that was shown last.

    Raises:
        InputError: a view is from below the ground or from too near, or a GPU lacks OptiX.
    """

    def __init__(
        self,
        look: str,
        integrator: str,
        smoke: Smoke,
        viewpoints: Sequence[Viewpoint],
        size: tuple[int, int],
        burns: bool = False,
        coloured: bool = False,
    ) -> None:
        require_optix("render --look")
        self.smoke, self.size = smoke, size
        self._low, self._high = self._box()
        self._fire = FireLight(self._low.tolist(), self._high.tolist()) if burns else None
        #: Albedo of white smoke, where smoke has a colour.
        self._white: float | None = None
        self._load(look, integrator, coloured)
        self.parameters = mi.traverse(self.scene)
        #: Transforms of the camera, and of all that turns with it, for the view (0, 0).
        self._front = {
            key: mi.ScalarTransform4f(np.array(self.parameters[key].matrix).reshape(4, 4))
            for key in self.parameters.keys()
            if key.endswith(".to_world")
        }
        self._view_sensor = self.sensor = self.scene.sensors()[0]
        self._shot_sensors = ShotSensors(size)
        if views := [viewpoint for viewpoint in viewpoints if not isinstance(viewpoint, Camera)]:
            self.parameters[_ZOOM] = opaque(field_of_view(smoke.shape, views, size))

    def _box(self) -> tuple[np.ndarray, np.ndarray]:
        """The lowest and the highest corner (x, y, z) of the occupied cells."""
        sizes = np.array(self.smoke.shape[::-1])
        low, high = (
            (np.array([getattr(cells, end) for cells in reversed(self.smoke.occupied)]) - sizes / 2) / sizes.max()
            for end in ("start", "stop")
        )
        return low, high

    def _load(self, look: str, integrator: str, coloured: bool) -> None:
        """Load the look's scene around the box of the smoke."""
        with tempfile.TemporaryDirectory(prefix="tnst_mi-") as folder:
            volume = Path(folder) / "empty.vol"
            mi.VolumeGrid(np.zeros((2, 2, 2, 1), np.float32)).write(str(volume))
            parameters = {
                "integrator": integrator,
                "columns": self.size[0],
                "rows": self.size[1],
                "floor": ground_height(self.smoke.shape),
                "volume": str(volume),
                "largest": _SLACK * self.smoke.largest or 1.0,
                **dict(zip(("width", "height", "depth"), (self._high - self._low).tolist(), strict=True)),
                **dict(zip("xyz", ((self._low + self._high) / 2).tolist(), strict=True)),
            }
            if coloured:
                self.scene, self._white = load_coloured(look_file(look), **parameters)
            else:
                self.scene = mi.load_file(str(look_file(look)), **parameters)

    def require_place(self, camera: Camera) -> None:
        """Check that a shot's camera, in cells about the centre of the grid, can stand in the studio.

        Raises:
            InputError: it is below the ground or inside the box of the smoke.
        """
        require_place(self._in_studio(camera), self._low, self._high, ground_height(self.smoke.shape))

    def _in_studio(self, camera: Camera) -> Camera:
        cell = 1 / max(self.smoke.shape)
        return camera.moved(np.diag([cell, cell, cell, 1.0]))

    def show(
        self,
        density: np.ndarray,
        viewpoint: Viewpoint,
        emission: np.ndarray | None = None,
        colour: np.ndarray | None = None,
    ) -> None:
        """Set the density, emission and colour of a frame, see `render`, and move the camera to a viewpoint.

        Raises:
            InputError: it is a shot's camera that cannot stand in the studio.
        """
        if isinstance(viewpoint, Camera):
            self.require_place(viewpoint)
            self.sensor = self._shot_sensors.placed(self._in_studio(viewpoint))
            self._turn(viewpoint.centred_view[0])
        else:
            self.sensor = self._view_sensor
            azimuth, elevation, distance = stand(viewpoint, self.smoke.shape)
            raised = self._turn(azimuth) @ mi.ScalarTransform4f().rotate([1, 0, 0], -elevation)
            back = mi.ScalarTransform4f().translate([0, 0, distance - camera_distance()])
            self._place(_CAMERA, raised @ back @ self._front[_CAMERA])
        if self._fire is not None and emission is not None:
            self._fire.set(emission[self.smoke.occupied])
        # By itself, so that nothing which follows from the places is left to be computed with the pixels, where it is
        # rounded otherwise than for a picture whose places are those of the one before.
        self.parameters.update()
        part = np.ascontiguousarray(density[self.smoke.occupied], np.float32)
        self.parameters[_DENSITY] = mi.TensorXf(part[..., None])
        if self._white is not None:
            tint = np.ones((1, 1, 1, 3), np.float32) if colour is None else colour[self.smoke.occupied]
            self.parameters[ALBEDO] = mi.TensorXf(albedo_of(tint, self._white))
        self.parameters.update()

    def _turn(self, azimuth: float) -> mi.ScalarTransform4f:
        """Turn lights, sky and ground to an azimuth in degrees, and return that turn."""
        turned = mi.ScalarTransform4f().rotate([0, 1, 0], azimuth)
        for key, front in self._front.items():
            if key != _CAMERA:
                self._place(key, turned @ front)
        return turned

    def _place(self, key: str, transform: mi.ScalarTransform4f) -> None:
        placed = mi.Transform4f(transform.matrix)
        # Lamps would have their place in the generated code, and each view would be compiled.
        dr.make_opaque(placed)
        self.parameters[key] = placed

    def render(
        self,
        density: np.ndarray,
        viewpoint: Viewpoint,
        samples: int = 64,
        seed: int | Sequence[int] = 0,
        emission: np.ndarray | None = None,
        colour: np.ndarray | None = None,
    ) -> np.ndarray:
        """Render a density from a viewpoint.

        Args:
            density: (D, H, W), one of the frames.
            viewpoint: one of those of the studio.
            samples: paths per pixel; the noise falls with their square root.
            seed: the same seed gives the same bits on the same machine and variant.
            emission: of the frame (D, H, W, 3), linear RGB radiance per longest edge of the grid, if any frame burns.
            colour: of the frame (D, H, W, 3), linear RGB, if the studio is one of coloured smoke; white if None.

        Returns:
            Linear radiance (height, width, 3), row 0 at the top; the lights are set so that 1 is white.
        """
        self.show(density, viewpoint, emission, colour)
        total = dr.zeros(mi.TensorXf, (self.size[1], self.size[0], 3))
        # One path per pixel and launch: more would be summed in the order in which threads arrive.
        for pass_seed in np.random.SeedSequence(seed).generate_state(samples).tolist():
            with collection_paused():
                total += mi.render(self.scene, sensor=self.sensor, spp=1, seed=pass_seed)
                if self._fire is not None:
                    # Another stream than that of the lights' paths.
                    total += self._fire.render(self.scene, self.sensor, pass_seed ^ _OTHER_STREAM)
                dr.eval(total)
        return (total / samples).numpy()


class Denoiser:
    """Mitsuba's OptiX denoiser for pictures of one size, (width, height)."""

    def __init__(self, size: tuple[int, int]) -> None:
        self._denoise = mi.OptixDenoiser(input_size=list(size))

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """The denoised picture (height, width, 3)."""
        return np.array(self._denoise(mi.TensorXf(np.ascontiguousarray(image, np.float32))))


def find_denoiser(size: tuple[int, int]) -> Denoiser | None:
    """The denoiser, or None if the variant or the driver lacks OptiX, or the driver lacks the denoiser's weights."""
    if not on_gpu() or not hasattr(mi, "OptixDenoiser") or not _denoiser_answers():
        return None
    return Denoiser(size)


@functools.cache
def _denoiser_answers() -> bool:
    """Whether OptiX can create a denoiser, tried in a subprocess, since Mitsuba ends the process if it cannot."""
    attempt = f"import mitsuba as mi; mi.set_variant({mi.variant()!r}); mi.OptixDenoiser(input_size=[16, 16])"
    return subprocess.run([sys.executable, "-c", attempt], capture_output=True, check=False).returncode == 0
