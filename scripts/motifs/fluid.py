"""Motifs of air, fire and water."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from motifs.canvas import Canvas, cell_coordinates, family, polar, smoothstep


@family("clouds", "cumulus", span=(2.0, 4.5), tilt=0.4)
def cloud(canvas: Canvas) -> Tensor:
    """Cumulus clouds in the sky: heaped round puffs on puffs, bright above and dark at a flat base."""
    x, y = canvas.x, 1.25 * canvas.y

    def amount(y: Tensor) -> Tensor:
        heap = 0.9 * canvas.noise(0.9 * x, 0.9 * y, 0)
        for octave, channel in ((1.0, 1), (2.2, 2), (4.5, 3)):
            # The folds of |noise| are the furrows between puffs.
            heap = heap + (0.45 - canvas.noise(1.6 * octave * x, 1.6 * octave * y, channel).abs()) * 0.8 / octave**1.3
        return heap

    heap, above = amount(y), amount(y + 0.16)
    light = (0.62 + 0.75 * (heap - above)).clamp(0.1, 1.0)
    return smoothstep(-0.35, -0.1, heap) * light


@family("volcano", "volcanic plume", "eruption", span=(1.0, 2.2), tilt=0.3)
def plume(canvas: Canvas) -> Tensor:
    """Eruptions: columns of boiling puffs that rise from a vent and widen to a cloud."""
    level = (0.62 * canvas.y).floor()
    u, v, i, j = cell_coordinates(canvas.x / 1.15 + 0.5 * level, 0.62 * canvas.y)
    height = v + 0.5
    sway = 0.1 * canvas.noise(3.0 * height + 9.0 * canvas.random(i, j), 2.0 * i, 0) * height
    half_width = 0.07 + 0.3 * height**1.3 + 0.12 * smoothstep(0.5, 0.75, height)
    # Puffs grow with height as the column does: their lattice is one of log(height).
    along = 5.0 * torch.log(height + 0.2) + 7.0 * j
    nearest, _, dx, dy, number = canvas.nearest_points(1.6 * (u + sway) / half_width + 13.0 * i, along, 0.9)
    puff = (1.0 - 0.8 * nearest + 0.5 * dy - 0.35 * dx).clamp(0.08, 1.0) * (0.75 + 0.25 * number)
    across = (u + sway).abs() / half_width + 0.45 * (nearest - 0.4)
    top = 0.47 - 0.5 * u * u - 0.1 * nearest
    return puff * smoothstep(1.0, 0.85, across) * smoothstep(top, top - 0.05, v)


@family("flame", "flames", span=(1.2, 3.2), tilt=0.35)
def fire(canvas: Canvas) -> Tensor:
    """Rows of flames licking upwards, one before the other: pointed tongues, bright at the rim."""
    picture = torch.zeros_like(canvas.x)
    width = canvas.uniform(0.5, 0.75)
    for row in range(3):
        y = canvas.y / 1.2 + row / 3.0
        level = y.floor()
        v = y - level
        x = (
            canvas.x / width
            + 0.37 * row
            + 0.5 * level
            + 0.3 * v * canvas.noise(0.8 * canvas.x, 2.0 * v + 3.1 * level, row)
        )
        u, _, i, _ = cell_coordinates(x, y)
        number = canvas.random(i, level, row)
        s = (v / (0.6 + 0.4 * number)).clamp(max=1.0)
        bend = torch.sin(2.0 * math.pi * (0.8 * s + number)) * 0.16 * s
        half = 0.52 * torch.sqrt(2.2 * s + 0.05) * (1.0 - s) ** 0.9 + 1e-3
        depth = 1.0 - (u - bend).abs() / half
        heart = smoothstep(0.35, 0.75, depth) * smoothstep(0.85, 0.5, s)
        picture = torch.lerp(picture, (1.0 - 0.9 * heart) * smoothstep(-0.05, 0.2, s), smoothstep(0.0, 0.2, depth))
    return picture


@family("incense", "veils", span=(1.5, 3.5))
def wisps(canvas: Canvas) -> Tensor:
    """Thin veils of smoke, folded and drawn out, that fade to one side."""
    x, y = canvas.x, canvas.y
    warp_x, warp_y = canvas.noise(0.5 * x, 0.5 * y, 0), canvas.noise(0.5 * x + 9.0, 0.5 * y, 1)
    picture = torch.zeros_like(x)
    for veil in range(3):
        along = 0.9 * (y + 0.7 * warp_y) + 2.1 * veil
        fold = canvas.noise(0.35 * (x + warp_x) + 4.0 * veil, 0.35 * along, 2) * 2.2 + 0.4 * (x + 0.6 * warp_x)
        phase = fold + 0.33 * veil
        phase = phase - phase.floor()
        edge = torch.exp(-5.0 * phase) * smoothstep(0.0, 0.05, phase)
        picture = picture + edge * (0.75 + 0.3 * canvas.noise(0.8 * x, 0.8 * y + 5.0 * veil, 3))
    return picture.clamp(0.0, 1.0)


@family("mushrooms", "mushroom cloud", "rayleigh taylor", span=(1.8, 4.0), tilt=0.4)
def mushroom(canvas: Canvas) -> Tensor:
    """Mushroom caps on stems, their rims rolled in."""
    v = canvas.y / 1.15
    u, v, i, j = cell_coordinates(canvas.x + 0.5 * v.floor(), v)
    number = canvas.random(i, j)
    u, v = u + 0.12 * (number - 0.5), v * (1.0 + 0.25 * (canvas.random(i, j, 1) - 0.5)) - 0.02
    cap_x, cap_y = u / 0.42, (v - 0.08) / 0.36
    dome = smoothstep(0.06, -0.06, torch.sqrt(cap_x**2 + cap_y**2) - 1.0) * smoothstep(-0.03, 0.05, v - 0.04)
    radius, angle = polar(u.abs() - 0.28, v - 0.04)
    roll = smoothstep(0.15, 0.11, radius) * (0.45 + 0.55 * torch.sin(angle + 55.0 * radius))
    stem_width = 0.07 + 0.06 * (v - 0.05) ** 2 / 0.2
    stem = smoothstep(0.03, -0.02, u.abs() - stem_width) * (v < 0.08)
    shading = (0.75 + 0.35 * cap_y - 0.25 * cap_x).clamp(0.2, 1.0)
    return torch.maximum(torch.maximum(dome * shading, roll), 0.6 * stem)


@family("wave", "sea", "ocean", span=(1.8, 4.0), tilt=0.3)
def waves(canvas: Canvas) -> Tensor:
    """The sea as in a woodcut: rows of pointed crests with foam, each before the one behind it."""
    picture = torch.zeros_like(canvas.x)
    rows = 2.2 * canvas.y
    for near in range(2, -3, -1):
        level = rows.floor() + near
        number = canvas.random(level, level)
        phase = canvas.x + 0.5 * level + 0.4 * number + 0.12 * canvas.noise(0.8 * canvas.x, level, 0)
        lean = phase + 0.1 * torch.sin(2.0 * math.pi * phase)
        # A cusp where the cosine of half the phase vanishes: the crest of a trochoid.
        crest = 1.0 - 1.6 * torch.sin(math.pi * lean).abs().sqrt()
        depth = level + 0.8 * crest - rows + 1.1
        foam = smoothstep(0.3, 0.16, depth)
        furrows = 0.5 + 0.5 * torch.cos(2.0 * math.pi * 2.2 * depth)
        body = torch.maximum(foam, (0.1 + 0.55 * furrows) * smoothstep(2.0, 0.5, depth))
        picture = torch.lerp(picture, body, smoothstep(0.0, 0.08, depth))
    return picture


@family("interference", "ripple", span=(1.6, 3.6))
def ripples(canvas: Canvas) -> Tensor:
    """Rings on water from several drops, passing through one another."""
    height = torch.zeros_like(canvas.x)
    wavelength = canvas.uniform(0.16, 0.26)
    for _ in range(3):
        radius, _ = polar(canvas.x - canvas.uniform(-1.5, 1.5), canvas.y - canvas.uniform(-1.5, 1.5))
        height = height + torch.sin(2.0 * math.pi * radius / wavelength) / (0.6 + 0.4 * radius)
    return smoothstep(-1.6, 1.6, height)


@family("caustic", "pool", "water light", span=(2.0, 4.5))
def caustics(canvas: Canvas) -> Tensor:
    """Light on the floor of a pool: a web of bright curved filaments, thick where they meet."""
    light = torch.zeros_like(canvas.x)
    x, y = canvas.x, canvas.y
    x = x + 0.28 * canvas.noise(1.6 * y, 1.6 * x, 0)
    y = y + 0.28 * canvas.noise(1.6 * x + 3.0, 1.6 * y, 1)
    for layer, scale in enumerate((1.1, 1.7)):
        nearest, second, *_ = canvas.nearest_points(scale * x, scale * y, 0.9, channel=3 * layer)
        light = light + torch.exp(-9.0 * (second - nearest)) * (1.0 - 0.35 * layer)
    return light.clamp(0.0, 1.0)


@family("bubble", "foam", "soap", span=(2.0, 4.5))
def bubbles(canvas: Canvas) -> Tensor:
    """Clear round bubbles of several sizes: a bright rim and a glint."""
    picture = torch.zeros_like(canvas.x)
    for layer, scale in enumerate((2.0, 1.1)):
        nearest, _, dx, dy, number = canvas.nearest_points(scale * canvas.x, scale * canvas.y, 0.7, channel=4 * layer)
        size = 0.3 + 0.17 * number
        r = nearest / size
        soft = 2.0 * scale * canvas.pixel / size
        cover = smoothstep(1.0 + soft, 1.0, r)
        rim = r.clamp(max=1.0) ** 5
        glint = smoothstep(0.24, 0.12, torch.sqrt((dx / size + 0.4) ** 2 + (dy / size - 0.4) ** 2))
        picture = torch.lerp(picture, torch.maximum(rim, glint), cover)
    return picture


@family("drip", "slime", "dripping", span=(2.0, 4.5), tilt=0.3)
def drips(canvas: Canvas) -> Tensor:
    """Paint that runs down from above in strands of different lengths, each with a heavy drop at its end."""
    picture = torch.zeros_like(canvas.x)
    for row in range(2):
        x, y = 1.9 * canvas.x + 0.5 * row, 0.6 * canvas.y + 0.5 * row
        level = y.floor()
        u, _, i, _ = cell_coordinates(x, y)
        v = y - level
        end = 0.1 + 0.62 * canvas.random(i, level, row)
        width = 0.1 + 0.1 * canvas.random(i, level, row + 2)
        rim = smoothstep(0.8, 1.0, v - 0.12 * u.abs())
        strand = smoothstep(0.04, -0.04, u.abs() - width - 0.5 * rim) * (v > end)
        drop_v = (v - end) * 3.4
        drop_v = torch.where(drop_v > 0.0, 0.5 * drop_v, drop_v)
        radius, _ = polar(u, drop_v)
        drop = smoothstep(0.06, -0.06, radius - width - 0.13)
        shine = 0.4 * smoothstep(0.12, 0.03, (u + 0.4 * width).abs())
        picture = torch.lerp(picture, 0.35 + 0.25 * row + shine, strand.maximum(drop))
    return picture


@family("bolt", "thunderbolt", span=(1.4, 2.8), tilt=0.5)
def lightning(canvas: Canvas) -> Tensor:
    """Jagged bolts from above that throw thin side branches."""
    n, generator = canvas.count, canvas.generator
    along = torch.linspace(0.0, 1.0, 500)
    picture = torch.zeros_like(canvas.x)
    for bolt in range(3):
        # The path of a bolt is a sum of random polylines, each twice as fine and half as wide as the last.
        path = torch.zeros(n, 500)
        for level in range(1, 6):
            kinks = torch.randn(n, 1, 2**level + 1, generator=generator)
            path = path + F.interpolate(kinks, size=500, mode="linear", align_corners=True)[:, 0] * 0.6**level
        path = 0.3 * path
        x, y = 0.9 * (bolt - 1) + path, 2.2 - 4.4 * along.expand(n, -1)
        picture = picture + canvas.splat(x, y, 2.0, radius=0.8)
        for _ in range(3):
            start = torch.randint(100, 400, (n, 1), generator=generator)
            slope = torch.rand(n, 1, generator=generator) * 1.6 - 0.8
            branch_x = x.gather(1, start) + slope * along + 0.5 * (path - path[:, :1])
            picture = picture + canvas.splat(
                branch_x, y.gather(1, start) - 0.9 * along, 0.6 * (1.0 - along), radius=0.5
            )
    return (picture / (0.4 * picture.amax((1, 2), keepdim=True) + 1e-6)).clamp(0.0, 1.0)
