"""Beauty renders: smoke lit in the studio of `scenes/looks`, with multiple scattering, by Mitsuba's path tracers.

A look is a Mitsuba XML scene; the smoke, its position and the picture size are its parameters. World units: the longest
edge of the grid is 1 and its centre is the origin, so that one set of lights fits grids of any size. Camera, lights and
sky turn together with the azimuth, as if the smoke stood on a turntable: every view is lit from the same side.
"""

from __future__ import annotations

import functools
import math
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
from tnst_mi.machine.backend import on_gpu
from tnst_mi.machine.optix import require_optix
from tnst_mi.rendering.cameras.views import View, camera_frame
from tnst_mi.rendering.fire_light import FireLight
from tnst_mi.rendering.looks import look_file

_DENSITY = "smoke.interior_medium.sigma_t.data"
_CAMERA = "camera.to_world"
_ZOOM = "camera.x_fov"

#: Majorant of the density, relative to the largest density. Derivatives of `prbvolpath` need the slack.
_SLACK = 1.1

#: What turns the seed of the lights' paths into that of the fire's.
_OTHER_STREAM = 0x5BD1E995

#: Margin around the grid's box in the picture, as a factor.
_MARGIN = 1.05

#: Distance of the ground below the grid, so that no ray starts on both.
GROUND_GAP = 2e-3


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
    """The scene of a look, loaded once and rendered with any of its frames and views.

    Args:
        look: "thin", "medium" or "thick".
        integrator: "volpath" or "prbvolpath".
        smoke: what the frames have in common.
        views: all views that will be rendered, (azimuth, elevation) in degrees; one zoom shows the whole grid in each.
        size: (width, height) of the pictures in pixels.
        burns: whether frames have an emission, see `tnst_mi.rendering.fire`; then `smoke.occupied` contains it.

    Raises:
        InputError: a view is from below the ground, or a GPU lacks OptiX.
    """

    def __init__(
        self,
        look: str,
        integrator: str,
        smoke: Smoke,
        views: Sequence[View],
        size: tuple[int, int],
        burns: bool = False,
    ) -> None:
        require_optix("render --look")
        self.smoke, self.size = smoke, size
        edges = np.array(smoke.shape[::-1]) / max(smoke.shape)
        low, high = self._box(edges)
        self._fire = FireLight(low.tolist(), high.tolist()) if burns else None
        self._load(look, integrator, edges, low, high)
        self.parameters = mi.traverse(self.scene)
        #: Transforms of the camera, and of all that turns with it, for the view (0, 0).
        self._front = {
            key: mi.ScalarTransform4f(np.array(self.parameters[key].matrix).reshape(4, 4))
            for key in self.parameters.keys()
            if key.endswith(".to_world")
        }
        distance = float(self._front[_CAMERA].translation()[2])
        lowest = math.degrees(math.asin(-edges[1] / 2 / distance))
        for azimuth, elevation, *_ in views:
            if distance * math.sin(math.radians(elevation)) <= -edges[1] / 2:
                raise InputError(
                    f"view {azimuth:g},{elevation:g}: the camera would be below the ground; "
                    f"expected an elevation above {lowest:.1f}"
                )
        self.parameters[_ZOOM] = dr.opaque(mi.Float, horizontal_field_of_view(edges, views, distance, size))

    def _box(self, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The lowest and the highest corner (x, y, z) of the occupied cells of a grid of the given edges."""
        low, high = (
            np.array([getattr(cells, end) for cells in reversed(self.smoke.occupied)]) / max(self.smoke.shape)
            - edges / 2
            for end in ("start", "stop")
        )
        return low, high

    def _load(self, look: str, integrator: str, edges: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
        """Load the look's scene around a grid of the given edges (x, y, z), smoke in it between two corners."""
        with tempfile.TemporaryDirectory(prefix="tnst_mi-") as folder:
            volume = Path(folder) / "empty.vol"
            mi.VolumeGrid(np.zeros((2, 2, 2, 1), np.float32)).write(str(volume))
            self.scene = mi.load_file(
                str(look_file(look)),
                integrator=integrator,
                columns=self.size[0],
                rows=self.size[1],
                floor=-edges[1] / 2 - GROUND_GAP,
                volume=str(volume),
                largest=_SLACK * self.smoke.largest or 1.0,
                **dict(zip(("width", "height", "depth"), (high - low).tolist(), strict=True)),
                **dict(zip("xyz", ((low + high) / 2).tolist(), strict=True)),
            )

    def show(self, density: np.ndarray, view: View, emission: np.ndarray | None = None) -> None:
        """Set the density (D, H, W) and the emission (D, H, W, 3) of a frame, and turn the camera to a view."""
        if self._fire is not None and emission is not None:
            self._fire.set(emission[self.smoke.occupied])
        part = np.ascontiguousarray(density[self.smoke.occupied], np.float32)
        self.parameters[_DENSITY] = mi.TensorXf(part[..., None])
        azimuth, elevation, *_ = view
        turned = mi.ScalarTransform4f().rotate([0, 1, 0], azimuth)
        raised = turned @ mi.ScalarTransform4f().rotate([1, 0, 0], -elevation)
        for key, front in self._front.items():
            placed = mi.Transform4f(((raised if key == _CAMERA else turned) @ front).matrix)
            # Lamps would have their place in the generated code, and each view would be compiled.
            dr.make_opaque(placed)
            self.parameters[key] = placed
        self.parameters.update()

    def render(
        self,
        density: np.ndarray,
        view: View,
        samples: int = 64,
        seed: int | Sequence[int] = 0,
        emission: np.ndarray | None = None,
    ) -> np.ndarray:
        """Render a density from a view.

        Args:
            density: (D, H, W), one of the frames.
            view: (azimuth, elevation) in degrees, one of the views.
            samples: paths per pixel; the noise falls with their square root.
            seed: the same seed gives the same bits on the same machine and variant.
            emission: of the frame (D, H, W, 3), linear RGB radiance per longest edge of the grid, if any frame burns.

        Returns:
            Linear radiance (height, width, 3), row 0 at the top; the lights are set so that 1 is white.
        """
        self.show(density, view, emission)
        total = dr.zeros(mi.TensorXf, (self.size[1], self.size[0], 3))
        # One path per pixel and launch: more would be summed in the order in which threads arrive.
        for pass_seed in np.random.SeedSequence(seed).generate_state(samples).tolist():
            total += mi.render(self.scene, spp=1, seed=pass_seed)
            if self._fire is not None:
                # Another stream than that of the lights' paths.
                total += self._fire.render(self.scene, pass_seed ^ _OTHER_STREAM)
            dr.eval(total)
        return (total / samples).numpy()


def horizontal_field_of_view(edges: np.ndarray, views: Sequence[View], distance: float, size: tuple[int, int]) -> float:
    """The angle in degrees at which pictures of the given size show a whole box, plus a margin, in every view.

    The box has edges (x, y, z) and is centred on the origin, at which the camera looks from the given distance.
    """
    signs = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3), axis=-1).reshape(-1, 3)
    widest = 0.0
    for view in views:
        x, y, towards = (signs * edges @ axis for axis in camera_frame(*view))
        slope = np.maximum(abs(x), abs(y) * size[0] / size[1]) / (distance - towards)
        widest = max(widest, float(slope.max()))
    return 2 * math.degrees(math.atan(_MARGIN * widest))


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
