"""Motifs of stone and earth: veins, cracks, crystals, pebbles, craters and mountains."""

from __future__ import annotations

import torch
from torch import Tensor

from motifs.canvas import Canvas, family, polar, smoothstep
from motifs.nature import place


@family("marbled", "veined", "veins", "onyx", span=(1.5, 3.5))
def marble(canvas: Canvas) -> Tensor:
    """Polished stone with cloudy tones and sharp wandering veins, thick and thin."""
    x, y = 0.7 * canvas.x, 1.4 * canvas.y
    drift = canvas.fractal_noise(x, y, 4, 1)
    phase = 3.0 * y + canvas.uniform(1.5, 2.5) * drift
    thick = torch.exp(-canvas.uniform(3.0, 5.0) * phase.sin().abs())
    thin = torch.exp(-12.0 * canvas.fractal_noise(1.4 * x + 0.6 * drift, 1.4 * y, 3, 2).abs())
    cloud = 0.22 + 0.15 * canvas.noise(x + 5.0, y + 0.5 * drift, 3)
    return (cloud + thick + 0.5 * thin).clamp(0.0, 1.0)


@family("cracked", "crack", "dry mud", "dried earth", "craquelure", "fissures", span=(2.0, 4.5))
def cracks(canvas: Canvas) -> Tensor:
    """Plates of dried mud parted by crooked dark cracks, wide ones and hair-thin ones."""
    crooked_x, crooked_y = (0.16 * canvas.fractal_noise(2.5 * canvas.x, 2.5 * canvas.y, 2, k) for k in (0, 1))
    x, y = canvas.x + crooked_x, canvas.y + crooked_y
    nearest, second, _, _, number = canvas.nearest_points(x, y, 0.9)
    width = canvas.uniform(0.06, 0.11) * (1.0 + 0.5 * canvas.noise(1.5 * x, 1.5 * y, 2))
    wide = smoothstep(0.5 * width, width + 0.04, second - nearest)
    # Hair-thin ones run across the plates, where a noise that each plate shifts anew changes its sign.
    fine = smoothstep(0.0, 0.07, canvas.noise(1.3 * x + 31.0 * number, 1.3 * y, 3).abs())
    return (wide * (0.5 + 0.5 * fine) * (0.75 + 0.25 * number)).clamp(0.0, 1.0)


@family("polygons", "low poly", "stained glass", "shattered", span=(2.5, 6.0))
def voronoi(canvas: Canvas) -> Tensor:
    """Straight-sided polygons, each of one flat tone from black to white."""
    nearest, second, _, _, number = canvas.nearest_points(canvas.x, canvas.y, 0.95)
    seam = smoothstep(0.0, 0.05, second - nearest)
    return number * torch.where(canvas.uniform(0.0, 1.0) < 0.4, seam, 1.0)


@family("crystal", "shards", "quartz", "gems", "facets", "ice crystals", span=(1.6, 3.5))
def crystals(canvas: Canvas) -> Tensor:
    """Long pointed crystals across one another, each of three lengthwise facets and slanting tips."""
    ridge = canvas.uniform(0.2, 0.5)

    def outline(u: Tensor, v: Tensor, number: Tensor) -> Tensor:
        width = 0.14 + 0.1 * number
        return (width - v.abs()).minimum(0.5 * (0.85 - u.abs() - 1.2 * v.abs()))

    edge, u, v, number = place(canvas, canvas.x, canvas.y, outline, canvas.uniform(-3.1, 3.1), 1.3)
    width = 0.14 + 0.1 * number
    tip = u.abs() > 0.85 - 1.2 * width - 0.5 * (v - 0.3 * width).abs()
    side = torch.where(v > ridge * width, 0.2, torch.where(v > -0.6 * width, 0.9, 0.5))
    tips = torch.where(v > 0.0, 0.45, 1.0)
    return smoothstep(0.0, 0.03, edge) * torch.where(tip, tips, side)


@family("pebble", "stones", "rocks", "gravel", "cobblestones", span=(2.5, 5.5))
def pebbles(canvas: Canvas) -> Tensor:
    """Rounded stones packed together, each a dome that is lit from one side."""
    stretch = canvas.uniform(0.7, 1.0)
    x, y = canvas.x * stretch, canvas.y / stretch
    nearest, second, dx, dy, number = canvas.nearest_points(x, y, 0.75)
    edge = (second - nearest - 0.05).minimum(1.3 * (0.6 - nearest)).clamp(min=0.0)
    dome = torch.sqrt(1.0 - (1.0 - (edge / 0.35).clamp(max=1.0)) ** 2 + 1e-6)
    light = (0.75 + 1.1 * (0.7 * dx + 0.7 * dy)).clamp(0.1, 1.2)
    return dome * light * (0.5 + 0.5 * number) * smoothstep(0.0, 0.08, edge)


@family("crater", "moon", "lunar", "impact craters", span=(1.8, 4.5))
def craters(canvas: Canvas) -> Tensor:
    """Round pits of several sizes with raised rims, lit from one side so that half of each lies in shadow."""
    shine = 0.05 * canvas.fractal_noise(3.0 * canvas.x, 3.0 * canvas.y, 3)
    for octave, strength in ((0, 1.0), (1, 0.6)):
        scale = 2.2**octave
        _, _, dx, dy, number = canvas.nearest_points(scale * canvas.x, scale * canvas.y, 0.6, octave)
        radius, angle = polar(dx, dy)
        r = radius / (0.25 + 0.2 * number)
        slope = r * smoothstep(1.1, 0.9, r) - smoothstep(0.9, 1.1, r) * torch.exp(-5.0 * (r - 1.0).clamp(min=0.0))
        shine = shine + strength * slope * (angle - canvas.uniform(-0.2, 0.2)).cos()
    return (0.45 + 0.55 * shine).clamp(0.0, 1.0)


@family("mountain", "peaks", "ridges", "alps", "hills", span=(1.8, 4.0), tilt=0.25)
def mountains(canvas: Canvas) -> Tensor:
    """Ranges of jagged peaks one behind another, snow on the tops, mist at the foot."""
    rows, picture = 1.4 * canvas.y, torch.zeros_like(canvas.x)

    def crest(x: Tensor, level: Tensor) -> Tensor:
        peaks = 1.0 - 1.5 * canvas.noise(0.9 * x + 0.3 * level, 2.3 * level, 0).abs()
        jags = canvas.noise(4.0 * x, 2.3 * level, 1) + 0.5 * canvas.noise(9.0 * x, 2.3 * level, 2)
        return level + 1.3 * peaks + 0.13 * jags

    for near in range(1, -3, -1):
        level = rows.floor() + near
        top = crest(canvas.x, level)
        depth = top - rows
        # A flank is bright where the crest above it rises to the right.
        sunny = smoothstep(-0.05, 0.05, crest(canvas.x + 0.15 + 0.2 * depth.clamp(-1.0, 1.0), level) - top)
        snow = smoothstep(0.4, 0.25, depth + 0.15 * canvas.noise(4.0 * canvas.x, 4.0 * canvas.y, 3))
        flank = (0.12 + 0.33 * sunny) * (1.0 - snow) + (0.55 + 0.45 * sunny) * snow
        mist = smoothstep(0.8, 1.8, depth)
        picture = torch.lerp(picture, flank + (0.45 - flank) * mist, smoothstep(0.0, 0.05, depth))
    return picture
