"""Pictures of views as linear values, averaged over as many pixels as a cell covers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.io.grids.npz import read_arrays
from tnst_mi.io.pictures.exr import read_linear
from tnst_mi.io.pictures.radiance import read_radiance
from tnst_mi.io.pictures.srgb import LUMINANCE, linear_of
from tnst_mi.losses.pictures import decoded_by_pillow
from tnst_mi.machine.gate import opening, silenced
from tnst_mi.rendering.cameras.camera import Camera

#: Pixels of a picture at most.
_MOST_PIXELS = 1 << 26

#: Pixels to either side of one, whose mean says which colour it has.
_AROUND = 2

#: The share of the largest luminance below which pixels count more and more as grey, since noise decides their colour.
_FAINT = 0.02

#: The standard deviation of normal numbers is their median magnitude times this.
_NORMAL = 1.4826


@dataclass(frozen=True, eq=False)
class Photograph:
    """A picture with the camera that took it.

    Attributes:
        name: of its view.
        camera: in the renderer's world, full-resolution cells about the grid's centre.
        values: (rows, columns) float32, linear, row 0 at the top.
        weights: likewise, from 0, where a pixel does not count, to 1.
        background: likewise, what is seen without smoke; None if one value stands for it.
        held_out: whether it judges the result instead of being used.
        colours: (rows, columns, 3), linear RGB, of which `values` are the strengths; None if one channel was taken.
        background_colours: likewise, of the background.
    """

    name: str
    camera: Camera
    values: np.ndarray
    weights: np.ndarray
    background: np.ndarray | None
    held_out: bool
    colours: np.ndarray | None = None
    background_colours: np.ndarray | None = None

    def in_units_of(self, peak: float) -> Photograph:
        """The same with values in parts of a peak."""
        values, background, colours, behind = (
            None if image is None else image / np.float32(peak)
            for image in (self.values, self.background, self.colours, self.background_colours)
        )
        assert values is not None
        return replace(self, values=values, background=background, colours=colours, background_colours=behind)

    def averaged(self, cell: float) -> Photograph:
        """The same with pixels about as large as a cell at the grid's centre, never with more than it has."""
        rows, columns = self.values.shape
        height = image_height(self.camera)
        wanted = (
            max(1, min(rows, round(height / cell))),
            max(1, min(columns, round(self.camera.aspect * height / cell))),
        )
        if wanted == (rows, columns):
            return self
        down, across = area_matrix(rows, wanted[0]), area_matrix(columns, wanted[1]).T
        weights = down @ self.weights @ across

        def mean(image: np.ndarray | None) -> np.ndarray | None:
            if image is None:
                return None
            if image.ndim == 3:
                return np.stack([one for plane in np.moveaxis(image, 2, 0) if (one := mean(plane)) is not None], axis=2)
            total = down @ (image * self.weights) @ across
            return np.divide(total, weights, out=np.zeros_like(total), where=weights > 0)

        colours, behind = mean(self.colours), mean(self.background_colours)
        values = mean(self.values) if colours is None else strength(colours, weights)
        background = mean(self.background) if behind is None else strength(behind, weights)
        assert values is not None
        return replace(
            self, values=values, weights=weights, background=background, colours=colours, background_colours=behind
        )


def image_height(camera: Camera) -> float:
    """The height of a camera's picture where the grid's centre is, in cells."""
    if not camera.perspective:
        return camera.field
    distance = max(1.0, float(camera.position @ camera.axes[2]))
    return 2 * distance * float(np.tan(np.radians(camera.field) / 2))


def area_matrix(n_from: int, n_to: int) -> np.ndarray:
    """Means over the pixels of a coarser row, (n_to, n_from) float32, each as much as it lies inside.

    Example:
        >>> area_matrix(3, 2).round(3).tolist()
        [[0.667, 0.333, 0.0], [0.0, 0.333, 0.667]]
    """
    edges = np.arange(n_to + 1) * (n_from / n_to)
    low, high = edges[:-1, None], edges[1:, None]
    pixel = np.arange(n_from)[None, :]
    overlap = np.clip(np.minimum(high, pixel + 1) - np.maximum(low, pixel), 0, None)
    return (overlap / overlap.sum(axis=1, keepdims=True)).astype(np.float32)


def strength(colours: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The strongest channel of each pixel of a picture (rows, columns, 3), as (rows, columns).

    Smoke of one colour, of which the strongest channel is 1, shows in that channel what white smoke would show. Noise
    makes the strongest of three channels too bright wherever there is nothing. So which one that is, and by how much,
    is taken from means over the neighbourhood, and the strength is the pixel's luminance times that of its surroundings
    over theirs: it has the noise of the luminance, with a mean of 0. Grey pixels keep their value.

    Pixels whose weight (rows, columns) is 0 do not count: what they show changes no other.
    """
    counts = _box_means(weights[..., None])
    around = np.divide(_box_means(colours * weights[..., None]), counts, out=np.zeros_like(colours), where=counts > 0)
    luminance = around @ LUMINANCE
    floor = _FAINT * max(float((luminance * (weights > 0)).max()), 1e-30)
    ratio = (np.maximum(around.max(axis=2), 0) + floor) / (np.maximum(luminance, 0) + floor)
    return (colours @ LUMINANCE) * ratio


def _box_means(image: np.ndarray) -> np.ndarray:
    """Means over the square around each pixel of an image (rows, columns, channels); the border repeats outside."""
    for axis in (0, 1):
        margin = [(_AROUND, _AROUND) if n == axis else (0, 0) for n in range(3)]
        padded = np.pad(image, margin, "edge")
        image = np.lib.stride_tricks.sliding_window_view(padded, 2 * _AROUND + 1, axis).mean(-1)
    return image


def read_values(path: Path, channel: str, transfer: str, layer: int | None = None) -> np.ndarray:
    """One linear channel of a picture, (rows, columns) float32, or with "rgb" all of them, (rows, columns, 3).

    Args:
        path: the file.
        channel: "luminance", of what is seen before black, "rgb", "red", "green", "blue" or "alpha".
        transfer: "linear", "srgb", or "auto": EXR, HDR and npz are linear, other formats have the curve of sRGB.
        layer: which of the pictures of an npz file; None for files of one.

    Raises:
        InputError: it cannot be read, has no alpha, or values that are not finite.
    """
    with opening(path, "a picture"), silenced():
        pixels, linear = _decoded(path, layer)
    if not np.isfinite(pixels).all():
        raise InputError(f"{path}: {int((~np.isfinite(pixels)).sum())} values are not finite; mend the picture")
    planes = pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)
    alpha = planes[..., 3] if planes.shape[2] == 4 else None
    if channel == "alpha":
        if alpha is None:
            raise InputError(f"{path}: has no alpha, which channel = alpha asks for; take luminance")
        return np.ascontiguousarray(alpha)
    colours = planes[..., :3] if linear or transfer == "linear" else linear_of(planes[..., :3])
    if linear and transfer == "srgb":
        raise InputError(f"{path}: is linear, as EXR and HDR always are; leave out transfer = srgb")
    if alpha is not None:
        colours = colours * alpha[..., None]
    if channel == "rgb":
        return np.ascontiguousarray(colours)
    grey = colours @ LUMINANCE if channel == "luminance" else colours[..., ("red", "green", "blue").index(channel)]
    return np.ascontiguousarray(grey)


def read_weights(path: Path, size: tuple[int, int], layer: int | None = None) -> np.ndarray:
    """A mask as weights from 0 to 1, (rows, columns) float32: its alpha, or of an opaque one the mean of its colours.

    Args:
        path: the file.
        size: of the picture that it belongs to, (rows, columns).
        layer: which of the pictures of an npz file; None for files of one.

    Raises:
        InputError: it cannot be read, or has another size than (rows, columns).
    """
    with opening(path, "a mask"), silenced():
        pixels, _ = _decoded(path, layer)
    if pixels.ndim == 3:
        # Painting programs save masks in black and white with an alpha of 1 everywhere.
        cut_out = pixels.shape[2] == 4 and bool((pixels[..., 3] < 1).any())
        pixels = pixels[..., 3] if cut_out else pixels[..., :3].mean(axis=2)
    require_size(path, pixels, size)
    return np.clip(pixels, 0.0, 1.0).astype(np.float32)


def require_size(path: Path, image: np.ndarray, size: tuple[int, int]) -> None:
    """Check that a picture has the size (rows, columns) of the one that it belongs to.

    Raises:
        InputError: it does not.
    """
    if image.shape != size:
        found, wanted = (f"{columns} × {rows}" for rows, columns in (image.shape, size))
        raise InputError(f"{path}: has {found} pixels, and the picture that it belongs to {wanted}; expected the same")


def estimated_noise(photographs: Sequence[Photograph]) -> float:
    """The standard deviation of the pixels' noise, by the median magnitude of the finest diagonal details.

    Few details are a picture's own (Donoho and Johnstone 1994, with Haar's wavelet) if much of it shows no smoke;
    where smoke is everywhere, its details count as noise. Noise that was cut off below black is underestimated.
    """
    found: list[np.ndarray] = [np.zeros(1, np.float32)]
    for photograph in photographs:
        rows, columns = (n // 2 * 2 for n in photograph.values.shape)
        places = [(slice(row, rows, 2), slice(column, columns, 2)) for row in (0, 1) for column in (0, 1)]
        a, b, c, d = (photograph.values[place] for place in places)
        counts = np.logical_and.reduce([photograph.weights[place] > 0 for place in places])
        found.append((np.abs(a - b - c + d) / 2)[counts])
    return _NORMAL * float(np.median(np.concatenate(found)))


def _decoded(path: Path, layer: int | None) -> tuple[np.ndarray, bool]:
    """The pixels in parts of full scale, (H, W), (H, W, 3) or (H, W, 4), and whether they are linear."""
    if path.suffix.lower() == ".npz":
        return _layer(path, layer), True
    if layer is not None:
        raise InputError(f"{path}: is one picture, and layer = {layer} is of .npz files with several; leave it out")
    with path.open("rb") as file:
        start = file.read(64)
    if path.suffix.lower() == ".exr":
        return read_linear(path, _MOST_PIXELS), True
    if path.suffix.lower() == ".hdr":
        return read_radiance(path, _MOST_PIXELS), True
    pixels, full_scale = decoded_by_pillow(path, start)
    return pixels.astype(np.float32) / full_scale, False


def _layer(path: Path, layer: int | None) -> np.ndarray:
    """One of the grey pictures of an npz file of the ScalarFlow data set: `data` (V, rows, columns, 1), row 0 below."""
    data = read_arrays(path, ["data"]).get("data")
    if data is None or data.ndim != 4 or data.shape[3] != 1 or math.prod(data.shape[1:]) > _MOST_PIXELS:
        found = "none" if data is None else f"one of shape {data.shape}"
        raise InputError(f"{path}: has {found}, expected an array data of grey pictures, (views, rows, columns, 1)")
    if layer is None or layer >= len(data):
        raise InputError(f"{path}: holds {len(data)} pictures, say which is the view's by layer, from 0")
    return np.ascontiguousarray(data[layer, ::-1, :, 0], np.float32)
