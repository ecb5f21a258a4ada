"""Making smoke of drawn motifs: light, contrast, silhouettes, blur, grain, tint, differently in each picture."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from motifs.canvas import Canvas, blur, polar, smoothstep


def shade(pictures: Tensor, canvas: Canvas) -> Tensor:
    """RGB pictures (N, 3, H, W) in 0 to 1 of painted amounts of smoke (N, H, W) in 0 to 1."""
    p = pictures.clamp(0.0, 1.0)
    p = torch.where(_chance(canvas, 0.15), 1.0 - p, p)
    p = p ** canvas.uniform(-0.4, 0.4).exp()
    p = torch.where(_chance(canvas, 0.4), _lit(p, canvas), p)
    p = p * (1.0 + canvas.uniform(0.0, 0.3) * _billows(canvas, 4)).clamp(0.2, 1.8)
    # What lies between the strokes is thin smoke as often as it is nothing.
    haze = canvas.uniform(-0.2, 0.3).clamp(min=0.0)
    p = haze + (1.0 - haze) * p.clamp(max=1.2)
    p = torch.where(_chance(canvas, 0.5), p * _silhouette(canvas), p)
    # A grid that carries smoke blurs it, by a pixel or so.
    p = torch.lerp(p, blur(p, 1.0), canvas.uniform(0.0, 1.0))
    p = p * canvas.uniform(0.5, 1.0)
    p = torch.where(_chance(canvas, 0.08), 1.0 - p, p)
    tint = 1.0 - 0.5 * torch.rand(canvas.count, 3, 1, 1, generator=canvas.generator)
    rgb = p[:, None] * torch.where(_chance(canvas, 0.25)[:, None], tint, 1.0)
    grain = canvas.uniform(-0.04, 0.08).clamp(min=0.0)[:, None]
    return (rgb + grain * torch.randn(rgb.shape, generator=canvas.generator)).clamp(0.0, 1.0)


def _chance(canvas: Canvas, probability: float) -> Tensor:
    """True for each picture with this probability, (N, 1, 1)."""
    return canvas.uniform(0.0, 1.0) < probability


def _lit(p: Tensor, canvas: Canvas) -> Tensor:
    """The amount of smoke as the height of a relief under an oblique light."""
    angle, strength = canvas.uniform(-math.pi, math.pi), canvas.uniform(0.8, 2.5)
    slope_x = torch.diff(p, dim=2, append=p[:, :, -1:])
    slope_y = torch.diff(p, dim=1, append=p[:, -1:, :])
    lambert = 0.65 + strength * (angle.cos() * slope_x + angle.sin() * slope_y)
    return lambert.clamp(0.0, 1.3) * (0.35 + 0.65 * p)


def _billows(canvas: Canvas, cells: int) -> Tensor:
    """Noise of unit deviation, about `cells` features across."""
    coarse = torch.randn(canvas.count, 1, cells + 1, cells + 1, generator=canvas.generator)
    return F.interpolate(coarse, size=(canvas.size, canvas.size), mode="bilinear", align_corners=True)[:, 0]


def _silhouette(canvas: Canvas) -> Tensor:
    """The opacity of a body of smoke with a ragged edge that covers a third of the picture or all but its corners."""
    centres = (torch.arange(canvas.size) + 0.5) / canvas.size - 0.5
    stretch = canvas.uniform(-0.25, 0.25).exp()
    x = (centres[None, None, :] + canvas.uniform(-0.1, 0.1)) * stretch
    y = (centres[None, :, None] + canvas.uniform(-0.1, 0.1)) / stretch
    radius, _ = polar(x, y)
    edge = canvas.uniform(0.3, 0.65) + 0.04 * (_billows(canvas, 5) + 0.5 * _billows(canvas, 11))
    return smoothstep(edge, edge - canvas.uniform(0.05, 0.25), radius)
