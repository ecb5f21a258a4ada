"""The public `render`: a density from views or a camera."""

from __future__ import annotations

import math
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.choices import QUADRATURES
from tnst_mi.errors import InputError
from tnst_mi.fields.arrays import any_array_kind
from tnst_mi.fields.grid import Shape
from tnst_mi.fields.kernels import require_indexable
from tnst_mi.rendering.cameras.camera import Camera, Viewpoint
from tnst_mi.rendering.cameras.views import View, common_size
from tnst_mi.rendering.coloured_renderer import ColouredRenderer
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer


@any_array_kind("density", "colour", from_0_to_1=["colour"])
def render(
    density: mi.TensorXf,
    view: View | Sequence[View] = (0.0, 0.0),
    gamma: float = 0.1,
    quadrature: str = "paper",
    h: float = 1.0,
    fit: bool = False,
    camera: Camera | None = None,
    size: tuple[int, int] | None = None,
    colour: mi.TensorXf | None = None,
) -> mi.TensorXf:
    """Render a density as emitting and absorbing smoke (paper Eq. 11).

    Emission is the density d, extinction γ d. The view (0, 0) looks along −z from +z with x to the right and y up;
    positive azimuth moves the camera towards +x, positive elevation moves it up. The rotation is rigid, about the
    centre of the grid. The image has the rows and columns of the grid, as in the paper: from other views, what lies
    beyond them is cut off. Of a grid of 48×16×12 cells, an image from the side shows a quarter. `fit` makes room.

    Views are orthographic. With a distance they are in perspective: the eye looks at the grid's centre from there, and
    pixels are h apart in the plane through it, so that the image of a distant eye is the orthographic one. A `camera`
    may be anywhere, in the smoke too, of which it sees what is in front of it.

    Args:
        density: (D, H, W), finite and ≥ 0 (not checked); 0 outside the grid.
        view: (azimuth, elevation) in degrees or (azimuth, elevation, distance), the distance in full-resolution cells,
            > 0, or a sequence of V of these.
        gamma: γ > 0, extinction per unit of density and full-resolution cell.
        quadrature: "paper" (inclusive sum), "exact", "transmittance" (= γ · exact) or "integrated_transmittance" (the
            transmittance integrated over the grid's box: empty space is bright, smoke dark).
        h: size of a cell in full-resolution cells, > 0; also the pixel spacing and the step. In perspective, the step
            is along the optical axis.
        fit: take the smallest image that shows all of the grid in every view, instead of (H, W).
        camera: what to render from instead of a view; lengths are in full-resolution cells, and the world's origin is
            the grid's centre.
        size: rows and columns of the image; (H, W) if None, and of a camera H and what its aspect makes of that.
        colour: (D, H, W, 3) of what the smoke emits, linear RGB, finite and usually in [0, 1]; uint8 and uint16
            count as parts of 255 and 65535. The outermost cells repeat outside the grid. Extinction stays the same in
            all channels. None for a grey image.

    Returns:
        Image (H, W), or (V, H, W) for a sequence of views, row 0 at the top, in the array kind of the input. "exact"
        and "paper" are in density × cells, below 1/γ; "transmittance" is in [0, 1); "integrated_transmittance" is in
        cells, up to the length of the ray inside the box. With a colour, (H, W, 3) or (V, H, W, 3): each sample's share
        of the grey image times its colour, so that white gives the grey image in each channel, to the bit.
        Differentiable with respect to the density and the colour.

    Raises:
        InputError: the shape or range of an argument is not as stated, or an array is too large to be indexed.

    Example:
        >>> import torch
        >>> import tnst_mi
        >>> density = torch.full((4, 2, 3), 0.5, requires_grad=True)
        >>> image = tnst_mi.render(density, quadrature="exact")  # everywhere (1 − exp(−0.1 · 4 · 0.5)) / 0.1
        >>> image.shape, round(image[0, 0].item(), 3)
        (torch.Size([2, 3]), 1.813)
        >>> image.sum().backward()
        >>> density.grad.shape
        torch.Size([4, 2, 3])
        >>> tnst_mi.render(density, view=[(0, 0), (30, 10)]).shape
        torch.Size([2, 2, 3])
        >>> tnst_mi.render(density, view=(90, 0), fit=True).shape
        torch.Size([2, 5])
        >>> tnst_mi.render(density, view=(20, 5, 40)).shape  # in perspective, from 40 cells away
        torch.Size([2, 3])
        >>> orange = torch.tensor([1.0, 0.5, 0.0]).expand(4, 2, 3, 3)
        >>> tnst_mi.render(density, quadrature="exact", colour=orange)[0, 0].tolist() == [
        ...     image[0, 0].item(), image[0, 0].item() / 2, 0.0]
        True
    """
    viewpoints, several = _viewpoints(view, camera)
    if len(density.shape) != 3 or 0 in density.shape:
        raise InputError(f"render: density of shape {tuple(density.shape)} given, expected (D, H, W), none of them 0")
    if colour is not None and tuple(colour.shape) != (*density.shape, 3):
        raise InputError(
            f"render: colour of shape {tuple(colour.shape)} given, expected {(*density.shape, 3)}: a red, a "
            "green and a blue part for every cell of the density"
        )
    if colour is not None:
        _require_colours(colour)
    if quadrature not in QUADRATURES:
        raise InputError(f"render: quadrature {quadrature!r} is unknown, expected one of {', '.join(QUADRATURES)}")
    for name, number in (("gamma", gamma), ("h", h)):
        if isinstance(number, str) or not 0 < number < math.inf:
            raise InputError(f"render: {name} {number!r} given, expected a finite number > 0")
    channels = 1 if colour is None else 3
    require_indexable(channels * math.prod(density.shape), "render: a density or its colour")
    size = _image_size(tuple(density.shape), viewpoints, float(h), fit, size)
    require_indexable(channels * len(viewpoints) * math.prod(size), "render: images")
    arguments = tuple(density.shape), float(gamma), quadrature, float(h)
    if colour is None:
        images = EmissionAbsorptionRenderer(*arguments, size=size).render(density, viewpoints)
    else:
        images = ColouredRenderer(*arguments, size=size).render_colour(density, colour, viewpoints)
    return images if several else mi.TensorXf(images.array, tuple(images.shape)[1:])


def _require_colours(colour: mi.TensorXf) -> None:
    """Check that all are finite; those outside of [0, 1] occur where colours are optimised."""
    values = dr.detach(colour.array)
    bad = ~dr.isfinite(values)
    if dr.any(bad):
        indices = dr.compress(bad)
        place = tuple(int(n) for n in np.unravel_index(indices[0], tuple(colour.shape)))
        raise InputError(
            f"render: colour has {len(indices)} NaN or infinite values (the first at {place}), expected finite ones, "
            "usually from 0 to 1"
        )


def _viewpoints(view: View | Sequence[View], camera: Camera | None) -> tuple[list[Viewpoint], bool]:
    """What to render from, and whether that is a sequence of views."""
    if camera is not None:
        if not isinstance(camera, Camera) or tuple(view) != (0.0, 0.0):
            raise InputError(f"render: view {view!r} and camera {camera!r} given, expected either, a tnst_mi.Camera")
        return [camera], False
    several = len(view) == 0 or np.ndim(view[0]) > 0
    views: list[Viewpoint] = []
    for one in view if several else [view]:
        numbers = np.asarray(one, np.float64)
        if numbers.shape not in ((2,), (3,)) or not np.isfinite(numbers).all() or min(numbers[2:], default=1) <= 0:
            break
        azimuth, elevation, *distance = numbers.tolist()
        views.append((azimuth, elevation, distance[0]) if distance else (azimuth, elevation))
    if not views or (several and len(views) < len(view)):
        raise InputError(
            f"render: view {view!r} given, expected (azimuth, elevation) in degrees, (azimuth, elevation, distance) "
            "with a distance above 0, or a list of these"
        )
    return views, several


def _image_size(
    shape: Shape, viewpoints: Sequence[Viewpoint], h: float, fit: bool, size: tuple[int, int] | None
) -> tuple[int, int]:
    """Rows and columns of the images."""
    cameras = [viewpoint for viewpoint in viewpoints if isinstance(viewpoint, Camera)]
    if fit and (cameras or size is not None):
        raise InputError("render: fit chooses the size for views; give it without a camera and without a size")
    if size is not None:
        if len(size) != 2 or not all(isinstance(n, int | np.integer) and n > 0 for n in size):
            raise InputError(f"render: size {size!r} given, expected two integers above 0, rows and columns")
        return int(size[0]), int(size[1])
    if cameras:
        return shape[1], max(1, round(shape[1] * cameras[0].aspect))
    views = [viewpoint for viewpoint in viewpoints if not isinstance(viewpoint, Camera)]
    return common_size(shape, views, h) if fit else shape[1:]
