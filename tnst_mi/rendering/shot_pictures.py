"""Grey pictures of frames in the framing of their shot, by the emission–absorption integrator."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Shape
from tnst_mi.frame import Frame
from tnst_mi.rendering.cameras.camera import Camera
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer


class ShotPainter:
    """Pictures with one exposure: 1 / the largest value of any frame.

    Args:
        frames: all frames that will be rendered.
        cameras: of each frame, in the renderer's world.
        gamma: extinction γ for density 1, per cell.
        quadrature: of the integral along a ray.
        size: rows and columns of the pictures, see `shot_size`.
    """

    def __init__(
        self, frames: Sequence[Frame], cameras: Sequence[Camera], gamma: float, quadrature: str, size: tuple[int, int]
    ) -> None:
        self.gamma, self.quadrature, self.exposure, self._size = gamma, quadrature, 1.0, size
        brightest = max(
            float(self.paint(frame.density, camera).max()) for frame, camera in zip(frames, cameras, strict=True)
        )
        if brightest > 0.0:
            self.exposure = 1.0 / brightest

    def paint(self, density: np.ndarray, camera: Camera) -> np.ndarray:
        """The exposed image (rows, columns) of a density (D, H, W)."""
        renderer = EmissionAbsorptionRenderer(density.shape, self.gamma, self.quadrature, 1.0, size=self._size)
        return self.exposure * renderer.render(mi.TensorXf(density), [camera]).numpy()[0]


def shot_size(cameras: Sequence[Camera], shape: Shape, wanted: tuple[int, int] | None) -> tuple[int, int]:
    """Rows and columns of the pictures of a shot.

    Args:
        cameras: of its frames.
        shape: (D, H, W) of the grid, whose rows they have unless a size is wanted.
        wanted: rows and columns, or None.

    Raises:
        InputError: that would not be the proportions of the cameras, or these change within the shot.
    """
    aspect = cameras[0].aspect
    if any(abs(camera.aspect / aspect - 1) > 1e-3 for camera in cameras):
        raise InputError("camera: its proportions change within the shot, expected one width over height")
    if wanted is None:
        return shape[1], max(2, round(shape[1] * aspect))
    rows, columns = wanted
    # Half a pixel by rounding the width, and what a few digits of the proportions leave open.
    if abs(columns - rows * aspect) > 0.5 + 1e-3 * columns:
        raise InputError(
            f"--resolution {columns}x{rows}: the camera's pictures are {aspect:.4g} times as wide as high, such as "
            f"{max(2, round(rows * aspect))}x{rows}"
        )
    return rows, columns
