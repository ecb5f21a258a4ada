"""Motifs of thread, rope and metal links: what is knotted, knitted, woven, plaited or chained."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from motifs.canvas import Canvas, cell_coordinates, family, polar, rotate, smoothstep
from motifs.geometric import hexagonal_cells, inside, odd, wrapped


@family("fishing net", "netting", "mesh", span=(2.2, 4.5))
def net(canvas: Canvas) -> Tensor:
    """Thin ropes that sag between the knots of a slack fishing net."""
    slack = canvas.uniform(0.05, 0.15)
    x = canvas.x + slack * canvas.noise(0.9 * canvas.x, 0.9 * canvas.y, 0)
    y = canvas.y + slack * canvas.noise(0.9 * canvas.x, 0.9 * canvas.y, 1)
    a, b = x + y, x - y
    sag = canvas.uniform(0.06, 0.12) * ((math.pi * a).sin() ** 2 + (math.pi * b).sin() ** 2)
    a, b = (_distance_to_whole(c, canvas) for c in (a + sag, b - sag))
    rope = inside(canvas.uniform(0.035, 0.11) - a.minimum(b), canvas)
    return rope.maximum(inside(canvas.uniform(0.12, 0.19) - torch.hypot(a, b), canvas))


def _distance_to_whole(field: Tensor, canvas: Canvas) -> Tensor:
    """Distance in units from the nearest line on which a smooth field is a whole number."""
    slope_y, slope_x = torch.gradient(field, dim=(1, 2))
    return wrapped(field).abs() * canvas.pixel / (torch.hypot(slope_x, slope_y) + 1e-3)


@family("lacework", "doily", "crochet", span=(1.2, 2.0))
def lace(canvas: Canvas) -> Tensor:
    """Scalloped rosettes with eyelets on a fine mesh of threads."""
    u, v, _, _ = hexagonal_cells(canvas.x, canvas.y)
    radius, angle = polar(u, v)
    petals = canvas.integer(6, 8)
    turn = wrapped(angle * petals / (2.0 * math.pi))
    rosette = canvas.uniform(0.36, 0.42) + 0.05 * (2.0 * math.pi * turn).cos() - radius
    along, across = radius - 0.25, turn * 2.0 * math.pi * radius / petals
    eyelets = (0.065 - torch.hypot(0.7 * along, across)).maximum(canvas.uniform(0.05, 0.09) - radius)
    mesh_u, mesh_v, _, _ = hexagonal_cells(*(canvas.uniform(5.5, 7.0) * c for c in (canvas.x, canvas.y)))
    threads = 0.7 * smoothstep(0.36, 0.5, torch.hypot(mesh_u, mesh_v))
    return torch.where(rosette > -0.05, inside(rosette, canvas) * (1.0 - inside(eyelets, canvas)), threads)


@family("knitting", "knitted", "knitwear", "wool", span=(2.5, 4.8))
def knit(canvas: Canvas) -> Tensor:
    """Columns of V-shaped stitches of thick wool."""
    u, _, i, _ = cell_coordinates(canvas.x, canvas.y)
    rows, slope = canvas.uniform(1.3, 1.8), canvas.uniform(0.8, 1.3)
    along = 4.0 * (u.abs() - 0.25)
    across = 2.0 * wrapped(rows * (canvas.y - slope * u.abs()) + canvas.random(i, 0 * i) * 0.1)
    stitch = smoothstep(0.0, 0.7, 1.0 - along**4 - across**2)
    return stitch * (0.85 + 0.15 * (2.0 * math.pi * (across + 0.8 * along)).sin())


@family("basket weave", "basket", "wicker", "woven", span=(2.0, 4.2))
def weave(canvas: Canvas) -> Tensor:
    """Basketwork: bundles of strands that pass over and under each other at right angles."""
    u, v, i, j = cell_coordinates(canvas.x, canvas.y)
    level = odd(i + j) > 0.5
    along, across = torch.where(level, u, v), torch.where(level, v, u)
    strand = 2.0 * wrapped(canvas.integer(2, 3) * (across + 0.5) + 0.5)
    arch = smoothstep(0.56, canvas.uniform(0.1, 0.35), along.abs())
    return (1.0 - strand**4) * (0.25 + 0.75 * arch)


@family("ribbons", "streamers", "sash", "bands", span=(2.0, 3.8))
def ribbon(canvas: Canvas) -> Tensor:
    """Wide bands that flow across each other, twisting so that front and back take turns."""
    picture = torch.zeros_like(canvas.x)
    for place in (-1.6, 0.8, -0.8, 1.6, 0.0):
        x, y = rotate(canvas.x, canvas.y, canvas.uniform(-0.5, 0.5))
        bend, wave = canvas.uniform(0.15, 0.35), canvas.uniform(1.0, 2.2)
        phase = wave * x + canvas.uniform(0.0, 2.0 * math.pi)
        centre, slope = place + bend * phase.sin(), wave * bend * phase.cos()
        twist = canvas.uniform(0.8, 1.5) * x + canvas.uniform(0.0, 2.0 * math.pi)
        across = (y - centre).abs() / torch.sqrt(1.0 + slope * slope)
        half_width = canvas.uniform(0.28, 0.38) * (0.06 + 0.94 * twist.cos().abs())
        side = torch.where(twist.cos() > 0.0, 0.85 + 0.15 * twist.sin(), 0.5 + 0.2 * twist.sin())
        picture = picture * (1.0 - inside(half_width + 0.06 - across, canvas))
        picture = picture + side * inside(half_width - across, canvas)
    return picture.clamp(0.0, 1.0)


@family("braids", "plait", "braided hair", "pigtail", span=(1.5, 3.0))
def braid(canvas: Canvas) -> Tensor:
    """Plaits of three thick strands, side by side."""
    u, _, i, _ = cell_coordinates(canvas.x, canvas.y)
    pace, sway, half_width = canvas.uniform(3.5, 5.0), 0.24, 0.2
    progress = canvas.sign() * pace * canvas.y + 2.0 * math.pi * canvas.random(i, 0 * i)
    top, picture = torch.full_like(u, -2.0), torch.zeros_like(u)
    for strand in range(3):
        phase = progress + 2.0 * math.pi * strand / 3.0
        across = (u - sway * phase.sin()) / torch.sqrt(1.0 + (sway * pace * phase.cos()) ** 2) / half_width
        depth = (2.0 * phase).sin()
        above = (across.abs() < 1.0) & (depth > top)
        hairs = 0.85 + 0.15 * (8.0 * across).cos()
        picture = torch.where(above, (1.0 - across**4) * hairs * (0.8 + 0.2 * depth), picture)
        top = torch.where(above, depth, top)
    return picture


@family("chains", "chain links", "shackles", span=(2.0, 3.6))
def chain(canvas: Canvas) -> Tensor:
    """Rows of oval links, each passing through the next."""
    pitch = canvas.uniform(1.05, 1.2)
    row = (canvas.y / pitch).floor()
    x, v = canvas.x + canvas.random(row, 0 * row), canvas.y - pitch * (row + 0.5)
    wire, height = canvas.uniform(0.085, 0.11), canvas.uniform(0.34, 0.41)
    length = 0.5 + 2.9 * wire

    def link(u: Tensor, height: Tensor) -> Tensor:
        """Distance inward from the surface of an oval link around u = 0."""
        core = torch.hypot((u.abs() - (length - wire - height).clamp(min=0.0)).clamp(min=0.0), v)
        return wire - (core - height).abs()

    first = link(2.0 * wrapped(0.5 * x), height)
    second = link(2.0 * wrapped(0.5 * x + 0.5), height * canvas.uniform(0.7, 1.0))
    gap = inside(torch.where(v > 0.0, first, second) + 0.05, canvas)
    first, second = (smoothstep(-canvas.pixel, 0.6 * wire, depth) for depth in (first, second))
    upper, lower = torch.where(v > 0.0, first, second), torch.where(v > 0.0, second, first)
    return upper.maximum(lower * (1.0 - gap))
