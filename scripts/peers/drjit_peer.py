"""Transport and rendering in Dr.Jit, written the direct way: gathers, and derivatives by automatic differentiation.

The formulas are those of the package. The march along the rays is an evaluated loop, which Dr.Jit can differentiate in
reverse mode as it is.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.grid import Shape
from tnst_mi.rendering.cameras.views import camera_frame


def _cells(shape: Shape) -> mi.Vector3i:
    d, h, w = shape
    index = dr.arange(mi.Int32, d * h * w)
    return mi.Vector3i(index % w, (index // w) % h, index // (w * h))


def _read(values: mi.Float, shape: Shape, cell: mi.Vector3i) -> mi.Float:
    d, h, w = shape
    inside = (cell.x >= 0) & (cell.x < w) & (cell.y >= 0) & (cell.y < h) & (cell.z >= 0) & (cell.z < d)
    return dr.gather(mi.Float, values, (cell.z * h + cell.y) * w + cell.x, inside)


def _corners(values: mi.Float, shape: Shape, position: mi.Point3f) -> tuple[list[mi.Float], list[mi.Float]]:
    """The eight values around positions in cells, 0 outside, and their trilinear weights."""
    base = dr.floor(position)
    fraction, low = position - base, mi.Vector3i(base)
    corners, weights = [], []
    for corner in ((x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)):
        corners.append(_read(values, shape, low + mi.Vector3i(*corner)))
        parts = [fraction[axis] if upper else 1 - fraction[axis] for axis, upper in enumerate(corner)]
        weights.append(parts[0] * parts[1] * parts[2])
    return corners, weights


def _sample(values: mi.Float, shape: Shape, position: mi.Point3f) -> mi.Float:
    corners, weights = _corners(values, shape, position)
    return sum(w * c for w, c in zip(weights, corners, strict=True))


def velocity(phi: mi.Float, shape: Shape) -> mi.Vector3f:
    """∇Φ by central differences, one-sided at the ends."""
    cell, components = _cells(shape), []
    for axis, size in enumerate(shape[::-1]):
        ahead, behind = mi.Vector3i(cell), mi.Vector3i(cell)
        ahead[axis], behind[axis] = dr.minimum(cell[axis] + 1, size - 1), dr.maximum(cell[axis] - 1, 0)
        difference = _read(phi, shape, ahead) - _read(phi, shape, behind)
        components.append(difference / mi.Float(ahead[axis] - behind[axis]))
    return mi.Vector3f(*components)


def advect(density: mi.Float, motion: mi.Vector3f, shape: Shape) -> mi.Float:
    """MacCormack with reverting limiter, 0 outside."""
    here = mi.Point3f(_cells(shape))
    corners, weights = _corners(density, shape, here - motion)
    forward = sum(w * c for w, c in zip(weights, corners, strict=True))
    dr.eval(forward)
    corrected = forward + 0.5 * (density - _sample(forward, shape, here + motion))
    low = high = corners[0]
    for corner in corners[1:]:
        low, high = dr.minimum(low, corner), dr.maximum(high, corner)
    return dr.select((corrected >= low) & (corrected <= high), corrected, forward)


def render(density: mi.Float, shape: Shape, views: Sequence[tuple[float, float]], gamma: float) -> list[mi.Float]:
    """Inclusive sum along the depth of the grid's box, rotated for each view: one image (H · W) per view."""
    return [_render_view(density, shape, view, gamma) for view in views]


def _render_view(density: mi.Float, shape: Shape, view: tuple[float, float], gamma: float) -> mi.Float:
    d, h, w = shape
    right, up, towards = (mi.Vector3f(*axis.tolist()) for axis in camera_frame(*view))
    pixel = dr.arange(mi.Int32, h * w)
    x, y = mi.Float(pixel % w) - (w - 1) / 2, (h - 1) / 2 - mi.Float(pixel // w)
    start = mi.Point3f((w - 1) / 2, (h - 1) / 2, (d - 1) / 2) + x * right + y * up + 0.5 * (d - 1) * towards

    def visit(k: mi.Int32, thickness: mi.Float, radiance: mi.Float) -> tuple[mi.Int32, mi.Float, mi.Float]:
        value = _sample(density, shape, start - mi.Float(k) * towards)
        thickness = thickness + value
        return k + 1, thickness, radiance + value * dr.exp(-gamma * thickness)

    zero = dr.zeros(mi.Float, h * w)
    state = (dr.zeros(mi.Int32, h * w), zero, mi.Float(zero))
    return dr.while_loop(state, lambda k, *_: k < d, visit, mode="evaluated")[2]
