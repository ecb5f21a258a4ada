"""Geometric motifs: what can be drawn with ruler and compasses."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from motifs.canvas import Canvas, cell_coordinates, family, polar, rotate, smoothstep


def inside(edge: Tensor, canvas: Canvas) -> Tensor:
    """1 where the distance `edge` from an outline, in units, is positive, 0 where negative, soft over two pixels."""
    return smoothstep(-canvas.pixel, canvas.pixel, edge)


def wrapped(x: Tensor) -> Tensor:
    """Distance from the nearest whole number, with its sign, -0.5 to 0.5."""
    return x - (x + 0.5).floor()


def odd(i: Tensor) -> Tensor:
    """1.0 where the whole number is odd, 0.0 where it is even."""
    return 2.0 * (0.5 * i - (0.5 * i).floor())


def hexagonal_cells(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The hexagonal cell, one unit wide, that each pixel is in: coordinates from its middle, column and row."""
    u, v, i, j = cell_coordinates(x, y / math.sqrt(3.0))
    shifted_u, shifted_v, shifted_i, shifted_j = cell_coordinates(x + 0.5, y / math.sqrt(3.0) + 0.5)
    closer = u * u + 3.0 * v * v < shifted_u * shifted_u + 3.0 * shifted_v * shifted_v
    v, shifted_v = math.sqrt(3.0) * v, math.sqrt(3.0) * shifted_v
    pairs = (u, shifted_u), (v, shifted_v), (i, shifted_i), (2.0 * j, 2.0 * shifted_j + 1.0)
    u, v, i, j = (torch.where(closer, here, there) for here, there in pairs)
    return u, v, i, j


@family("squares", "box", span=(2.0, 5.0), tilt=0.6)
def square(canvas: Canvas) -> Tensor:
    """Framed squares side by side, some filled."""
    u, v, i, j = cell_coordinates(canvas.x, canvas.y)
    u, v = rotate(u, v, 0.5 * (canvas.random(i, j) - 0.5))
    edge = 0.45 - u.abs().maximum(v.abs())
    frame = smoothstep(-0.03, 0.03, edge) * smoothstep(0.17, 0.09, edge)
    return frame.maximum(smoothstep(0.19, 0.25, edge) * (canvas.random(i, j, 3) > 0.5))


@family("spirals", "whorl", span=(1.0, 4.0))
def spiral(canvas: Canvas) -> Tensor:
    """Whorls of either handedness, each filling its own patch of the plane."""
    nearest, second, dx, dy, number = canvas.nearest_points(canvas.x, canvas.y, 0.6)
    radius, angle = polar(dx, dy)
    hand = (number > 0.5) * 2.0 - 1.0
    turns = canvas.uniform(1.6, 4.5)
    phase = 2.0 * math.pi * radius * turns + hand * angle + 6.28 * number
    ribbon = smoothstep(-0.6, 0.6, phase.sin())
    return ribbon * smoothstep(0.0, 0.06, second - nearest)


@family("checkerboard", "chessboard", "checkered", "gingham", span=(3.0, 7.0))
def checks(canvas: Canvas) -> Tensor:
    """A chessboard, or a gingham cloth: light, half-light and dark fields in rows and columns."""
    stretch = canvas.uniform(-0.25, 0.25).exp()
    columns, rows = (
        2.0 * inside(0.5 - 2.0 * wrapped(0.5 * c).abs(), canvas) - 1.0 for c in (canvas.x * stretch, canvas.y / stretch)
    )
    gingham = canvas.uniform(0.0, 1.0) < 0.25
    return torch.where(gingham, 0.5 + 0.25 * (columns + rows), 0.5 + 0.5 * columns * rows)


@family("striped", "bars", "pinstripes", span=(2.5, 6.0))
def stripes(canvas: Canvas) -> Tensor:
    """Straight parallel bands, each of its own width."""
    stripe = canvas.x.floor()
    width = 0.22 + canvas.uniform(-0.05, 0.05) + canvas.uniform(0.0, 0.2) * (canvas.random(stripe, 0 * stripe) - 0.5)
    return inside(width - (canvas.x - stripe - 0.5).abs(), canvas)


@family("polka dots", "dotted", "discs", span=(2.2, 5.5))
def dots(canvas: Canvas) -> Tensor:
    """Filled round dots in staggered rows."""
    u, v, i, j = hexagonal_cells(canvas.x, canvas.y)
    radius = canvas.uniform(0.28, 0.42) * (1.0 - canvas.uniform(0.0, 0.35) * canvas.random(i, j))
    return inside(radius - torch.hypot(u, v), canvas)


@family("concentric circles", "circles", "bullseye", "targets", span=(1.5, 3.4))
def rings(canvas: Canvas) -> Tensor:
    """Round targets side by side: concentric circles around a dot or a hole."""
    u, v, i, j = hexagonal_cells(canvas.x, canvas.y)
    radius = torch.hypot(u, v)
    outer = 0.49 - 0.1 * canvas.random(i, j)
    pitch = 0.46 / (canvas.integer(3, 5) * 0.5 + 0.5)
    band = canvas.uniform(0.22, 0.3) * pitch
    nearest = pitch * wrapped((radius - outer + band) / pitch).abs()
    return inside(band - nearest, canvas) * inside(outer - radius, canvas)


@family("star", "pentagram", "starry", span=(1.6, 3.4))
def stars(canvas: Canvas) -> Tensor:
    """Pointed stars, turned at random, some of them hollow."""
    u, v, i, j = hexagonal_cells(canvas.x, canvas.y)
    radius, angle = polar(u, v)
    half_sector = math.pi / canvas.integer(5, 6)
    angle = 2.0 * half_sector * wrapped(angle / (2.0 * half_sector) + canvas.random(i, j)).abs()
    tip, notch = 0.55 - 0.1 * canvas.random(i, j, 1), canvas.uniform(0.2, 0.26)
    notch_x, notch_y = notch * half_sector.cos(), notch * half_sector.sin()
    side = torch.hypot(tip - notch_x, notch_y)
    edge = ((tip - radius * angle.cos()) * notch_y - radius * angle.sin() * (tip - notch_x)) / side
    hollow = (canvas.random(i, j, 2) < 0.3) * inside(edge - 0.08, canvas)
    return inside(edge, canvas) - hollow


@family("chevron", "chevrons", "herringbone", span=(2.5, 5.5))
def zigzag(canvas: Canvas) -> Tensor:
    """Parallel bands that turn sharply to and fro."""
    height = canvas.uniform(0.5, 1.1)
    pitch = canvas.uniform(0.5, 0.8)
    phase = (canvas.y + 2.0 * height * wrapped(canvas.x).abs()) / pitch
    return inside(pitch * (canvas.uniform(0.2, 0.3) - wrapped(phase).abs()), canvas)


@family("triangle", "triangular", span=(1.8, 4.2))
def triangles(canvas: Canvas) -> Tensor:
    """Equilateral triangles in rows, point up, some of them with a triangular hole."""
    column, row = canvas.x - canvas.y / math.sqrt(3.0), 2.0 / math.sqrt(3.0) * canvas.y
    u, v = column - column.floor(), row - row.floor()
    edge = math.sqrt(0.75) * u.minimum(v).minimum(1.0 - u - v) - canvas.uniform(0.02, 0.05)
    hollow = canvas.random(column.floor(), row.floor()) < canvas.uniform(0.0, 0.8)
    return inside(edge, canvas) - hollow * inside(edge - canvas.uniform(0.07, 0.12), canvas)


@family("diamond", "lozenges", "rhombs", "argyle", "harlequin", span=(1.8, 4.0))
def diamonds(canvas: Canvas) -> Tensor:
    """Tall lozenges, corner to corner, filled or framed."""
    slope = canvas.uniform(0.45, 0.65)
    u, v, i, j = cell_coordinates(canvas.x + slope * canvas.y, canvas.x - slope * canvas.y)
    edge = (0.5 - u.abs().maximum(v.abs())) / torch.sqrt(1.0 + slope * slope)
    lozenge = inside(edge, canvas) * (1.0 - odd(i + j))
    hole = inside(edge - 0.12, canvas) - inside(edge - 0.24, canvas)
    framed = (canvas.uniform(0.0, 1.0) < 0.5) * (1.0 - odd(i + j))
    thread = 0.6 * (canvas.uniform(0.0, 1.0) < 0.4) * odd(i + j)
    return lozenge - framed * hole + thread * inside(0.05 - u.abs().minimum(v.abs()), canvas)


@family("hexagons", "beehive", "hexagonal", span=(2.5, 5.5))
def honeycomb(canvas: Canvas) -> Tensor:
    """Walls of a comb of hexagons, some of its cells half full."""
    u, v, i, j = hexagonal_cells(canvas.x, canvas.y)
    edge = 0.5 - u.abs().maximum(0.5 * u.abs() + math.sqrt(0.75) * v.abs())
    wall = canvas.uniform(0.06, 0.11)
    honey = canvas.uniform(0.2, 0.6) * (canvas.random(i, j) < canvas.uniform(0.0, 0.5))
    return inside(wall - edge, canvas).maximum(honey * inside(edge - wall - 0.06, canvas))


@family("brick wall", "brickwork", "masonry", span=(2.0, 4.0), tilt=0.4)
def bricks(canvas: Canvas) -> Tensor:
    """A wall of oblong bricks, each row shifted by half a brick, with dark joints."""
    height = canvas.uniform(0.38, 0.5)
    row = (canvas.y / height).floor()
    u, v, i, j = cell_coordinates(canvas.x + 0.5 * odd(row), canvas.y / height)
    joint = canvas.uniform(0.035, 0.06)
    edge = (0.5 - u.abs()).minimum(height * (0.5 - v.abs())) - joint
    return inside(edge, canvas) * (1.0 - canvas.uniform(0.1, 0.6) * canvas.random(i, j))


@family("mazes", "garden maze", "corridors", span=(4.5, 8.5))
def maze(canvas: Canvas) -> Tensor:
    """Walls of a maze: each corner of a square grid is joined to a neighbour that is drawn by lot."""
    u, v, i, j = cell_coordinates(canvas.x, canvas.y)
    distance = torch.full_like(u, 1.0)
    for quarter, (di, dj) in enumerate(((1, 0), (0, 1), (-1, 0), (0, -1))):
        here, there = (4.0 * canvas.random(i + a, j + b) for a, b in ((0, 0), (di, dj)))
        wall = (here.floor() == quarter) | (there.floor() == (quarter + 2) % 4)
        along, across = di * u + dj * v, (di * v - dj * u).abs()
        distance = torch.where(wall, distance.minimum(across.maximum(-along)), distance)
    return inside(canvas.uniform(0.18, 0.25) - distance, canvas)


@family("cross", "plus signs", "pluses", span=(1.8, 3.8))
def crosses(canvas: Canvas) -> Tensor:
    """Crosses with four equal arms, in staggered rows."""
    u, v, i, j = hexagonal_cells(canvas.x, canvas.y)
    u, v = rotate(u, v, canvas.uniform(0.0, 0.5) * (canvas.random(i, j) - 0.5))
    arm, length = canvas.uniform(0.09, 0.14), canvas.uniform(0.33, 0.41)
    return inside((length - u.abs().maximum(v.abs())).minimum(arm - u.abs().minimum(v.abs())), canvas)


@family("sun rays", "sunbeams", "starburst", "sun", span=(1.6, 3.2))
def sunburst(canvas: Canvas) -> Tensor:
    """A disc from which straight rays spread in all directions."""
    radius, angle = polar(canvas.x, canvas.y)
    count, disc = canvas.integer(5, 10) * 2.0, canvas.uniform(0.15, 0.35)
    turn = angle * count / (2.0 * math.pi)
    edge = (canvas.uniform(0.2, 0.3) - wrapped(turn).abs()) * 2.0 * math.pi * radius / count
    reach = torch.where(odd((turn + 0.5).floor()) > 0.5, canvas.uniform(0.7, 2.5), 9.0)
    rays = edge.minimum(radius - disc - canvas.uniform(-0.02, 0.12)).minimum(reach - radius)
    return inside(rays.maximum(disc - radius), canvas)


@family("rosette", "mandalas", "kaleidoscope", span=(1.5, 2.4))
def mandala(canvas: Canvas) -> Tensor:
    """Rings of petals, beads and points around one middle, all of the same symmetry."""
    radius, angle = polar(canvas.x, canvas.y)
    pitch = canvas.uniform(0.22, 0.28)
    ring = (radius / pitch).floor()
    v = radius / pitch - ring - 0.5
    count = canvas.integer(3, 5) * 2.0 * (1.0 + (ring > 2))
    u = wrapped(angle * count / (2.0 * math.pi) + 0.5 * odd(ring))
    arc = u.abs() * 2.0 * math.pi * (ring + 0.5) / count
    petal, bead, point = 0.4 - u.abs() - 1.6 * v * v, 0.33 - torch.hypot(arc, v), 0.45 * (0.5 - v) - u.abs()
    kind = canvas.random(ring, 0 * ring)
    shape = torch.where(kind < 0.4, petal, torch.where(kind < 0.7, bead, point))
    shape = torch.where(ring == 0, 0.25 - v, shape)
    line = v.abs() - 0.5 + canvas.uniform(0.04, 0.1)
    return inside(pitch * shape.maximum(line), canvas)


@family("contour lines", "topographic map", "isolines", "elevation map", span=(1.5, 3.5))
def contours(canvas: Canvas) -> Tensor:
    """The lines of equal height of a map, on ground that is the lighter the higher it lies."""
    height = canvas.uniform(2.0, 3.5) * canvas.fractal_noise(0.8 * canvas.x, 0.8 * canvas.y, 2)
    slope_y, slope_x = torch.gradient(height, dim=(1, 2))
    pixels = wrapped(height).abs() / torch.sqrt(slope_x**2 + slope_y**2 + 0.002)
    ground = canvas.uniform(0.0, 0.08) * ((height + 3.0).floor().clamp(0.0, 5.0))
    return ground.maximum(smoothstep(1.4, 0.3, pixels))


@family("gear", "cogs", "cogwheels", "clockwork", span=(1.4, 2.6))
def gears(canvas: Canvas) -> Tensor:
    """Toothed wheels side by side, each with a round hole for its axle."""
    u, v, i, j = hexagonal_cells(canvas.x, canvas.y)
    radius, angle = polar(u, v)
    teeth, root, tip = canvas.integer(7, 10), canvas.uniform(0.32, 0.36), 0.46
    turn = wrapped(angle * teeth / (2.0 * math.pi) + canvas.random(i, j)).abs()
    tooth = (canvas.uniform(0.2, 0.27) - turn) * 2.0 * math.pi * radius / teeth
    wheel = (root - radius).maximum(tooth.minimum(tip - radius))
    axle = 0.09 + 0.12 * canvas.random(i, j, 1)
    return inside(wheel.minimum(radius - axle), canvas)
