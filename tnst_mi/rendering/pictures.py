"""The pictures of `tnst-mi render`: which frame from which view, and the two ways to render them."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.bounds import hull
from tnst_mi.frame import Frame
from tnst_mi.io.pictures.png import srgb
from tnst_mi.rendering.cameras.camera import Camera, Viewpoint
from tnst_mi.rendering.cameras.views import View, common_size, text_of
from tnst_mi.rendering.fire import Fire
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer
from tnst_mi.rendering.smoke_colour import colours_of
from tnst_mi.rendering.studio import Smoke, Studio, find_denoiser

#: Rows of a video of a small grid, at least.
LEAST_HEIGHT = 384

Attributes = dict[str, float | str | View]

_Seen = TypeVar("_Seen", bound=Viewpoint, covariant=True)


@dataclass(frozen=True)
class Shot(Generic[_Seen]):
    """One picture to render: the frame's index in its sequence, from where, and the suffix that identifies its file."""

    frame: int
    viewpoint: _Seen
    suffix: str


def shots_of_views(frames: int, views: Sequence[View]) -> list[Shot[View]]:
    """Every view of every frame."""
    return [Shot(frame, view, f"view_{text_of(view, '_')}") for frame in range(frames) for view in views]


def shots_of_cameras(cameras: Sequence[Camera]) -> list[Shot[Camera]]:
    """Every frame through its own camera."""
    return [Shot(frame, camera, "camera") for frame, camera in enumerate(cameras)]


def enlarged(columns: int, rows: int) -> tuple[int, int]:
    """(width, height) of pictures of a grid, enlarged by an integer factor to at least `LEAST_HEIGHT` rows."""
    factor = max(1, -(-LEAST_HEIGHT // rows))
    return factor * columns, factor * rows


def shots_of_turn(frames: int, start: View, count: int) -> list[Shot[View]]:
    """A full turn of the azimuth in `count` steps, ending one step before the start so that the video loops.

    A sequence plays once during the turn, evenly: picture i shows frame ⌊i frames / count⌋. With as many pictures as
    frames, each frame is shown once.
    """
    digits = len(str(count - 1))
    return [
        Shot(i * frames // count, (start[0] + 360.0 * i / count, start[1]), f"turntable_{i:0{digits}d}")
        for i in range(count)
    ]


class Painter(Protocol):
    """Interface of the two ways to render pictures."""

    def paint(self, frame: Frame, viewpoint: Viewpoint, number: int) -> np.ndarray:
        """Linear values of picture `number`, (H, W) or (H, W, 3)."""
        ...

    def shown(self, image: np.ndarray) -> np.ndarray:
        """The values as displayed by an 8-bit picture, in [0, 1]."""
        ...

    def attributes(self) -> Attributes:
        """Entries common to the EXR headers of all pictures."""
        ...

    def seconds(self, frame: Frame, viewpoint: Viewpoint) -> float:
        """What a picture will take, from a part of one that is painted for it once all is compiled."""
        ...


class EmissionAbsorptionPainter:
    """Grey pictures by the emission–absorption integrator, with one exposure: 1 / the largest value in the first view.

    Args:
        frames: all frames that will be rendered.
        views: all views that will be rendered, in degrees.
        gamma: extinction γ for density 1, per cell.
        quadrature: of the integral along a ray.
        fit: make room for all of the grid in every view; otherwise pictures show its rows and columns.
        size: (width, height) in pixels, at least one per cell; None for one per cell. What is shown is centred.

    Raises:
        InputError: the size is too small.
    """

    def __init__(
        self,
        frames: Sequence[Frame],
        views: Sequence[View],
        gamma: float,
        quadrature: str,
        fit: bool = False,
        size: tuple[int, int] | None = None,
    ) -> None:
        self.gamma, self.quadrature, self.exposure = gamma, quadrature, 1.0
        shape = frames[0].density.shape
        rows, columns = common_size(shape, views) if fit else shape[1:]
        width, height = size or (columns, rows)
        self._size, self._pixel = (height, width), max(rows / height, columns / width)
        if self._pixel > 1.0:
            raise InputError(
                f"--resolution {width}x{height}: expected at least {columns}x{rows}, one pixel for each cell; without "
                "noise, smaller pictures are as good as those that are reduced"
            )
        brightest = max(float(self.paint(frame, views[0], 0).max()) for frame in frames)
        if brightest > 0.0:
            self.exposure = 1.0 / brightest

    def paint(self, frame: Frame, viewpoint: Viewpoint, number: int) -> np.ndarray:
        """The exposed image (rows, columns)."""
        density = frame.density
        renderer = EmissionAbsorptionRenderer(
            density.shape, self.gamma, self.quadrature, 1.0, size=self._size, pixel=self._pixel
        )
        return self.exposure * renderer.render(mi.TensorXf(density), [viewpoint]).numpy()[0]

    def shown(self, image: np.ndarray) -> np.ndarray:
        """The image without any tone curve, as the network sees it."""
        return image

    def attributes(self) -> Attributes:
        """γ, quadrature and exposure."""
        return {"gamma": self.gamma, "quadrature": self.quadrature, "exposure": self.exposure}

    def seconds(self, frame: Frame, viewpoint: Viewpoint) -> float:
        """A whole picture; one has been painted for the exposure, so that all is compiled."""
        start = time.perf_counter()
        self.paint(frame, viewpoint, 0)
        return time.perf_counter() - start


class PathTracedPainter:
    """Pictures (height, width, 3) of the smoke in the studio of a look; the noise differs from picture to picture.

    Args:
        frames: all frames that will be rendered.
        viewpoints: all that will be rendered, see `Studio`.
        look: "thin", "medium" or "thick".
        integrator: "volpath" or "prbvolpath".
        size: (width, height) in pixels.
        samples: paths per pixel.
        seed: not negative.
        denoise: denoise with OptiX where available; `denoised` records whether it is.
        fire: what burns in the frames, if anything.
        colour: the name of the grid that colours them, if any.

    Raises:
        InputError: frames differ in shape, or a view is from below the ground or from too near.
    """

    def __init__(
        self,
        frames: Iterable[Frame],
        viewpoints: Sequence[Viewpoint],
        look: str,
        integrator: str,
        size: tuple[int, int],
        samples: int,
        seed: int,
        denoise: bool,
        fire: Fire | None = None,
        colour: str | None = None,
    ) -> None:
        self.look, self.integrator, self.samples, self.seed, self.fire = look, integrator, samples, seed, fire
        self.colour = colour
        smoke = Smoke.of(frame.density for frame in frames)
        if fire is not None:
            smoke = replace(smoke, occupied=hull([smoke.occupied, fire.occupied]))
        self.studio = Studio(look, integrator, smoke, viewpoints, size, fire is not None, colour is not None)
        self.denoiser = find_denoiser(size) if denoise else None
        self.denoised = self.denoiser is not None

    def paint(self, frame: Frame, viewpoint: Viewpoint, number: int) -> np.ndarray:
        """Radiance; 1 is white."""
        image = self._rendered(frame, viewpoint, self.samples, (self.seed, number))
        return image if self.denoiser is None else self.denoiser(image)

    def seconds(self, frame: Frame, viewpoint: Viewpoint) -> float:
        """Measured with one path per pixel."""
        self._rendered(frame, viewpoint, 1, 0)
        start = time.perf_counter()
        self._rendered(frame, viewpoint, 1, 0)
        return self.samples * (time.perf_counter() - start)

    def _rendered(self, frame: Frame, viewpoint: Viewpoint, samples: int, seed: int | tuple[int, int]) -> np.ndarray:
        emission = None if self.fire is None else self.fire.emission(frame)
        colour = None
        if self.colour is not None and self.colour in frame.grids:
            colour = colours_of(frame.grids, self.colour, frame.name)
        return self.studio.render(frame.density, viewpoint, samples, seed, emission, colour)

    def shown(self, image: np.ndarray) -> np.ndarray:
        """The image after the sRGB curve."""
        return srgb(image)

    def attributes(self) -> Attributes:
        """Look, integrator, paths per pixel, seed, and whether the picture was denoised."""
        return {
            "look": self.look,
            "integrator": self.integrator,
            "samples_per_pixel": float(self.samples),
            "seed": str(self.seed),
            "denoised": "yes" if self.denoised else "no",
            "fire": "none" if self.fire is None else self.fire.grid,
            "colour": self.colour or "none",
        }
