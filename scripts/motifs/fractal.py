"""Fractals: iterated function systems, Julia sets, and what grows by the same rule at every scale."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from motifs.canvas import Canvas, cell_coordinates, family, polar, smoothstep

_POINTS = 3000


def _attractor(maps: tuple[tuple[float, ...], ...], steps: int = 40) -> tuple[Tensor, Tensor]:
    """Points of the attractor of affine maps (x, y) → (a x + b y + e, c x + d y + f), chosen by their probability.

    Each map is (a, b, c, d, e, f, probability).
    """
    generator = torch.Generator().manual_seed(0)
    table = torch.tensor(maps)
    x, y = torch.zeros(_POINTS), torch.zeros(_POINTS)
    for _ in range(steps):
        a, b, c, d, e, f, _ = table[torch.multinomial(table[:, 6], _POINTS, True, generator=generator)].T
        x, y = a * x + b * y + e, c * x + d * y + f
    return x, y


_FERN = _attractor(
    (
        (0.0, 0.0, 0.0, 0.16, 0.0, 0.0, 0.02),
        (0.85, 0.04, -0.04, 0.85, 0.0, 1.6, 0.78),
        (0.2, -0.26, 0.23, 0.22, 0.0, 1.6, 0.1),
        (-0.15, 0.28, 0.26, 0.24, 0.0, 0.44, 0.1),
    )
)
_DRAGON = _attractor(((0.5, -0.5, 0.5, 0.5, 0.0, 0.0, 0.5), (-0.5, -0.5, 0.5, -0.5, 1.0, 0.0, 0.5)))


def _scattered(canvas: Canvas, x: Tensor, y: Tensor, copies: int, spread: float) -> Tensor:
    """Copies of a set of points, turned, sized and placed at random; what `splat` makes of them."""
    n, generator = canvas.count, canvas.generator
    picture = torch.zeros(n, canvas.size, canvas.size)
    for _ in range(copies):
        angle, centre_x, centre_y, scale = torch.rand(4, n, 1, generator=generator)
        cos, sin = torch.cos(2.0 * math.pi * angle), torch.sin(2.0 * math.pi * angle)
        scale = 0.8 + 0.5 * scale
        centre_x, centre_y = spread * (2.0 * centre_x - 1.0), spread * (2.0 * centre_y - 1.0)
        part = canvas.splat(centre_x + scale * (cos * x - sin * y), centre_y + scale * (sin * x + cos * y), radius=0.7)
        level = 4.0 * part.sum((1, 2), keepdim=True) / (part > 0.3).sum((1, 2), keepdim=True).clamp(min=1)
        picture = picture.maximum((part / level.clamp(min=1e-3)).clamp(0.0, 0.5) * 2.0)
    return picture


@family("ferns", "frond", span=(1.2, 2.6))
def fern(canvas: Canvas) -> Tensor:
    """Fern fronds: leaflets along a bent stem, each a small frond itself."""
    x, y = _FERN
    return _scattered(canvas, 0.17 * x, 0.17 * (y - 5.0), copies=5, spread=0.8)


@family("dragon curve", "twindragon", span=(1.2, 2.4))
def dragon(canvas: Canvas) -> Tensor:
    """Dragon curves: islands of right-angled coast, alike at every scale."""
    x, y = _DRAGON
    return _scattered(canvas, 0.9 * (x - 0.4), 0.9 * (y - 0.3), copies=4, spread=0.75)


@family("julia set", "fractal", span=(1.6, 2.8))
def julia(canvas: Canvas) -> Tensor:
    """Julia sets of z² + c for constants near the boundary of the Mandelbrot set."""
    angle = canvas.uniform(0.0, 2.0 * math.pi)
    # Just outside the main cardioid: connected, or barely dust, and always intricate.
    radius = canvas.uniform(1.02, 1.08)
    c_x = radius * (0.5 * torch.cos(angle) - 0.25 * torch.cos(2.0 * angle))
    c_y = radius * (0.5 * torch.sin(angle) - 0.25 * torch.sin(2.0 * angle))
    z_x, z_y = canvas.x, canvas.y
    level = torch.zeros_like(z_x)
    for _ in range(28):
        z_x, z_y = z_x * z_x - z_y * z_y + c_x, 2.0 * z_x * z_y + c_y
        squared = z_x * z_x + z_y * z_y
        level = level + torch.sigmoid(4.0 - squared)
        z_x, z_y = z_x.clamp(-9.0, 9.0), z_y.clamp(-9.0, 9.0)
    return (0.5 - 0.5 * torch.cos(0.55 * level)).clamp(0.0, 1.0)


@family("sierpinski triangle", "gasket", span=(1.2, 2.6))
def sierpinski(canvas: Canvas) -> Tensor:
    """Sierpinski's gasket: triangles in triangles, down to the pixel."""
    v = canvas.y * 2.0 / math.sqrt(3.0)
    u = canvas.x - 0.5 * v
    u, v = u - u.floor(), v - v.floor()
    picture = torch.ones_like(u)
    # The other half of each parallelogram holds an inverted gasket every other time.
    flipped = u + v > 1.0
    u, v = torch.where(flipped, 1.0 - u, u), torch.where(flipped, 1.0 - v, v)
    for level in range(4):
        a, b, c = u, v, 1.0 - u - v
        margin = (0.5 - torch.maximum(torch.maximum(a, b), c)) / 2.0**level
        picture = picture * smoothstep(0.4 * canvas.pixel, -0.4 * canvas.pixel, margin)
        u, v = 2.0 * u - (u >= 0.5).float(), 2.0 * v - (v >= 0.5).float()
    return picture * torch.where(flipped, 0.0, 1.0)


@family("snowflake", "ice", "frost", span=(1.6, 3.6))
def snowflakes(canvas: Canvas) -> Tensor:
    """Six-armed snowflakes with side branches, no two alike."""
    u, v, i, j = cell_coordinates(canvas.x + 0.5 * canvas.y.floor(), canvas.y)
    size = 0.8 + 0.25 * canvas.random(i, j)
    radius, angle = polar(u / size, v / size)
    sector = (angle + math.pi * canvas.random(i, j, 1)) / (math.pi / 3.0)
    angle = (sector - sector.round()).abs() * (math.pi / 3.0)
    along, across = radius * angle.cos(), radius * angle.sin()
    width = 0.028 + 0.5 * canvas.pixel
    arm = smoothstep(width, 0.3 * width, across) * (along < 0.47)
    picture = arm
    for branch in range(3):
        root = 0.08 + 0.13 * branch + 0.06 * canvas.random(i, j, 2 + branch)
        length = (0.14 + 0.14 * canvas.random(i, j, 6 + branch)) * (1.0 - 0.2 * branch)
        # Side branches leave the arm at 60 degrees.
        reach = 0.5 * (along - root) + 0.866 * across
        distance = (0.866 * (along - root) - 0.5 * across).abs()
        line = smoothstep(width, 0.3 * width, distance) * (reach > 0.0) * (reach < length)
        picture = picture.maximum(line)
    hub = smoothstep(0.02, 0.0, (radius - 0.09).abs() - 0.012)
    return picture.maximum(hub)
