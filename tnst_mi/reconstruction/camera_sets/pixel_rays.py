"""Cameras by the rays of their pixels, in text files as those of the ScalarFlow data set (Eckert et al. 2019) are.

The first line has the width and the height of the pictures in pixels; each other one a pixel and its ray:

    x y start_y start_x direction_y direction_x direction_z

x counts to the right and y upwards, both from 0. A ray starts in the plane z = 0, and both vectors have their vertical
component first: the authors' cameras lie on their side. Lengths are in metres, y is up, and pixels without a ray are
left out. This is what the authors' own programs write and read (`process_image_stack.cpp`, `image.cpp` and `ray.cpp`
of github.com/tum-pbs/reconstructScalarFlows, read in November 2026), which have no other specification.

Our cameras are pinholes with square pixels: the one that is nearest to the rays stands in for them, without what the
lens distorts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.io.cameras.scene_camera import SceneCamera
from tnst_mi.machine.gate import opening

#: Longest file in bytes: five times that of a picture of 1080 × 1920 pixels.
_LONGEST = 1 << 30

#: Rays that are enough to find a pinhole.
_ENOUGH = 20_000

#: Directions are unit vectors, and starts are in metres: numbers beyond this, or lengths below its inverse, are damage.
_LARGEST = 1e6

#: Fewest rays that decide one.
_FEWEST = 12

#: How often rays that are far off are left out, and how many times the median error is far: the authors' rays are
#: extrapolated where the marker was not seen.
_ROUNDS, _FAR = 10, 4.0

#: The largest root mean square error of a pinhole, in parts of the width of the picture.
_PINHOLE = 0.02


@dataclass(frozen=True)
class RayCamera:
    """The pinhole that stands in for the rays of a camera.

    Attributes:
        camera: in the scene, or in its mirror image.
        turned: whether the scene is left-handed, so that the camera is in the one whose z points the other way.
        error: root mean square distance between pixels and where the pinhole sees their rays, in pixels.
    """

    camera: SceneCamera
    turned: bool
    error: float


def read_ray_camera(path: Path) -> RayCamera:
    """Read a file of rays.

    Raises:
        InputError: it cannot be read, or its rays are those of no pinhole.
    """
    with opening(path, "a file of rays"):
        width, height, rays = _read(path)
        return _nearest_pinhole(path, rays, (width, height))


def _nearest_pinhole(path: Path, rays: np.ndarray, size: tuple[int, int]) -> RayCamera:
    """The pinhole that stands in for rays (N, 7) of pictures of (width, height) pixels."""
    pixels, starts, directions = rays[:, :2] + 0.5, np.zeros((len(rays), 3)), rays[:, [5, 4, 6]]
    starts[:, :2] = rays[:, [3, 2]]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    kept = np.ones(len(rays), bool)
    for _ in range(_ROUNDS):
        pinhole = _Pinhole(pixels[kept], starts[kept], directions[kept], size)
        errors = pinhole.errors(pixels, directions)
        kept = errors <= _FAR * np.median(errors) + 1e-6
        if kept.sum() < _FEWEST:
            break
    error = float(np.sqrt(np.mean(errors[kept] ** 2)))
    if not error <= _PINHOLE * size[0]:
        raise InputError(
            f"{path}: its rays are {error:.3g} pixels (RMS) from those of any pinhole, expected at most "
            f"{_PINHOLE:.0%} of the width of {size[0]}; check that they are of one camera"
        )
    return RayCamera(pinhole.camera, pinhole.turned, error)


class _Pinhole:
    """The camera through whose pixels rays go, by their common point and the direct linear transformation."""

    def __init__(self, pixels: np.ndarray, starts: np.ndarray, directions: np.ndarray, size: tuple[int, int]) -> None:
        self._middle, self._unit = np.array(size) / 2, size[1] / 2
        # The point with the least squared distances from all rays.
        across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
        place = np.linalg.lstsq(across.sum(0), (across @ starts[:, :, None]).sum(0)[:, 0])[0]
        to_scene = self._homography(pixels, directions)
        # Of the camera's own axes, x is to the right, y up, and z backwards.
        axes, slopes = np.linalg.qr(to_scene)
        signs = np.sign(np.diag(slopes)) * np.array([1.0, 1.0, -1.0])
        axes, slopes = axes * signs, slopes * signs[:, None]
        self.turned = bool(np.linalg.det(axes) < 0)
        with np.errstate(divide="ignore", invalid="ignore"):  # of rays that are those of no camera
            slopes = slopes / -slopes[2, 2]
        #: Slope of a ray for each unit of pixels, and where the axis meets the picture.
        self._slope = math.sqrt(slopes[0, 0] * slopes[1, 1])
        self._axes = axes
        self._centre = -slopes[:2, 2] / np.diag(slopes)[:2]
        pose = np.eye(4)
        mirror = np.diag([1.0, 1.0, -1.0 if self.turned else 1.0])
        pose[:3, :3], pose[:3, 3] = mirror @ axes, mirror @ place
        field, aspect = 2 * math.degrees(math.atan(self._slope)), size[0] / size[1]
        shift = (float(self._centre[0]) / 2, float(self._centre[1]) / 2)
        self.camera = SceneCamera(pose, True, field, aspect, shift)

    def errors(self, pixels: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """How far pixels are from where the directions of their rays are seen, in pixels."""
        seen = directions @ self._axes
        with np.errstate(divide="ignore", invalid="ignore"):
            places = self._centre - seen[:, :2] / seen[:, 2:] / self._slope
        far = np.linalg.norm(places - self._scaled(pixels), axis=1) * self._unit
        return np.where((seen[:, 2] < 0) & np.isfinite(far), far, np.inf)

    def _scaled(self, pixels: np.ndarray) -> np.ndarray:
        """Pixels from the middle, in halves of the height."""
        return (pixels - self._middle) / self._unit

    def _homography(self, pixels: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """The matrix (3, 3) that makes the direction of a ray, up to its length, of (x, y, 1)."""
        places = np.concatenate([self._scaled(pixels), np.ones((len(pixels), 1))], axis=1)
        x, y, z = (directions[:, axis, None] * places for axis in range(3))
        none = np.zeros_like(places)
        # d × (H p) = 0, in the nine entries of H.
        rows = np.concatenate([np.hstack([none, -z, y]), np.hstack([z, none, -x]), np.hstack([-y, x, none])], axis=0)
        found = np.linalg.svd(rows.T @ rows)[2][-1].reshape(3, 3)
        forwards = ((places @ found.T) * directions).sum()
        return found * np.sign(forwards)


def _read(path: Path) -> tuple[int, int, np.ndarray]:
    """The size of the pictures, and rays (N, 7) spread evenly over the file, float64."""
    if (size := path.stat().st_size) > _LONGEST:
        raise InputError(f"{path}: {size} bytes, expected a file of rays of at most {_LONGEST}")
    with path.open("rb") as file:
        head = file.readline(64).split()
        if len(head) != 2 or not all(number.isdigit() and 0 < int(number) < 65536 for number in head):
            raise InputError(f"{path}: its first line is no width and height in pixels, such as 1080 1920")
        width, height = (int(number) for number in head)
        begun = file.tell()
        count = sum(1 for _ in file)
        file.seek(begun)
        every = max(1, count // _ENOUGH)
        rays = np.array([_ray(path, 2 + every * n, line) for n, line in enumerate(islice(file, 0, None, every))])
    if len(rays) < _FEWEST:
        raise InputError(f"{path}: has {len(rays)} rays, expected at least {_FEWEST}")
    if not ((rays[:, :2] >= 0).all() and (rays[:, 0] < width).all() and (rays[:, 1] < height).all()):
        raise InputError(f"{path}: has pixels beyond its {width} × {height}")
    return width, height, rays


def _ray(path: Path, number: int, line: bytes) -> list[float]:
    try:
        values = [float(word) for word in line[:1024].split()]
    except ValueError:
        values = []
    if len(values) != 7 or not all(map(math.isfinite, values)) or not any(values[4:]):
        raise InputError(f"{path}: line {number}: expected a pixel and its ray, seven numbers")
    if not 1 / _LARGEST <= math.hypot(*values[4:]) <= _LARGEST:
        raise InputError(
            f"{path}: line {number}: its direction is {math.hypot(*values[4:]):.3g} long, expected about 1"
        )
    if max(map(abs, values[2:4])) > _LARGEST:
        raise InputError(
            f"{path}: line {number}: its ray starts at {values[2]:.3g}, {values[3]:.3g}, expected metres from the scene"
        )
    return values
