"""Motifs from nature: plants, animals and what they make, and the dabs of a painter."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from motifs.canvas import Canvas, cell_coordinates, family, polar, rotate, smoothstep


def place(
    canvas: Canvas,
    x: Tensor,
    y: Tensor,
    outline: Callable[[Tensor, Tensor, Tensor], Tensor],
    angle: Tensor | float = 0.0,
    turn: float = math.pi,
    jitter: float = 0.5,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Lay out one thing near the middle of each unit cell, those below and to the left covering the others.

    `outline(u, v, number)` is positive inside a thing, which reaches less than a unit from its middle; each is turned
    by `angle` and at random by up to `turn`. Returns, of the uppermost thing at each pixel, the outline (0 where there
    is none), the coordinates (u, v) in its own frame, and its random number in 0 to 1.
    """
    cell_x, cell_y, i, j = cell_coordinates(x, y)
    edge, u, v, number = (torch.zeros_like(x) for _ in range(4))
    for dj in (1, 0, -1):
        for di in (1, 0, -1):
            column, row = i + di, j + dj
            dx = cell_x - di - jitter * (canvas.random(column, row) - 0.5)
            dy = cell_y - dj - jitter * (canvas.random(column, row, 1) - 0.5)
            dx, dy = rotate(dx, dy, angle + turn * (2.0 * canvas.random(column, row, 2) - 1.0))
            its_number = canvas.random(column, row, 3)
            its_edge = outline(dx, dy, its_number)
            inside = its_edge > 0.0
            edge, u, v = (torch.where(inside, *pair) for pair in ((its_edge, edge), (dx, u), (dy, v)))
            number = torch.where(inside, its_number, number)
    return edge, u, v, number


@family("flowers", "blossom", "petals", "floral", "daisy", span=(1.8, 4.5))
def flower(canvas: Canvas) -> Tensor:
    """Blossoms of five to eight rounded petals around a bright centre, scattered on the ground."""
    petals, roundness = canvas.integer(5, 8), canvas.uniform(0.4, 0.9)

    def outline(u: Tensor, v: Tensor, number: Tensor) -> Tensor:
        radius, angle = polar(u, v)
        lobe = (0.5 * petals * angle).cos().abs().clamp(min=1e-3) ** roundness
        return (0.44 + 0.14 * number) * (0.4 + 0.6 * lobe) - radius

    edge, u, v, _ = place(canvas, canvas.x, canvas.y, outline)
    radius, angle = polar(u, v)
    seam = radius * (0.5 * petals * angle).cos().abs() * 2.0 / petals
    petal = smoothstep(0.0, 0.05, edge) * smoothstep(0.005, 0.035, seam) * (0.45 + 1.1 * radius).clamp(max=1.0)
    heart = canvas.uniform(0.1, 0.14)
    centre = smoothstep(heart, heart - 0.05, radius) * (edge > 0.0)
    return petal * smoothstep(heart + 0.02, heart + 0.07, radius) + centre


@family("leaf", "foliage", "leafy", "ivy", span=(1.8, 4.5))
def leaves(canvas: Canvas) -> Tensor:
    """Pointed leaves lying over one another, each with a midrib and slanting veins."""
    width, veins = canvas.uniform(0.28, 0.4), canvas.uniform(3.5, 5.0)

    def outline(u: Tensor, v: Tensor, number: Tensor) -> Tensor:
        s = u / (0.65 + 0.2 * number)
        return width * (1.0 - s * s) * (1.0 - 0.4 * s) - v.abs()

    edge, u, v, number = place(canvas, canvas.x, canvas.y, outline)
    midrib = smoothstep(0.015, 0.05, v.abs())
    vein = smoothstep(0.1, 0.35, (math.pi * veins * (u - 0.8 * v.abs())).sin().abs())
    blade = (0.65 + 0.35 * number) * (0.45 + 0.55 * vein) * torch.where(v > 0.0, 1.0, 0.75)
    return smoothstep(0.0, 0.06, edge) * midrib * blade


@family("fluffy", "hair", "furry", "hairy", "pelt", span=(2.0, 4.5))
def fur(canvas: Canvas) -> Tensor:
    """Tufts of short curved strands, combed roughly one way, tip over root."""
    flow = -0.5 * math.pi + 0.6 * canvas.noise(0.4 * canvas.x, 0.4 * canvas.y)
    curl, strands = canvas.sign() * canvas.uniform(0.2, 0.6), canvas.uniform(4.0, 6.0)

    def outline(u: Tensor, v: Tensor, number: Tensor) -> Tensor:
        v = v + curl * u * u
        tip = 0.55 + 0.3 * (2.0 * math.pi * strands * v + 6.0 * number).cos()
        return (0.45 * (tip - u)).minimum(0.3 - 0.18 * u - v.abs()).minimum(u + 0.8)

    x, y = 1.6 * canvas.x, 1.6 * canvas.y
    edge, u, v, number = place(canvas, x, y, outline, flow, 0.35)
    strand = canvas.noise(u + 20.0 * number, 2.5 * strands * (v + curl * u * u) + 9.0 * number, 1)
    return smoothstep(0.0, 0.05, edge) * smoothstep(-0.9, 0.7, strand + 1.2 * u)


@family("feather", "plumage", "quill", "wings", span=(1.4, 3.0))
def feathers(canvas: Canvas) -> Tensor:
    """Long feathers, each a bright shaft between two vanes of fine slanting barbs with a few splits."""
    barbs, width = canvas.uniform(6.0, 9.0), canvas.uniform(0.2, 0.28)

    def outline(u: Tensor, v: Tensor, number: Tensor) -> Tensor:
        v = v + (0.5 * number - 0.25) * u * u
        s = ((u + 0.8) / 1.6).clamp(0.0, 1.0)
        barb = u - 0.8 * v.abs()
        split = 0.25 * smoothstep(0.75, 1.0, (5.0 * barb + 9.0 * number + torch.where(v > 0.0, 2.0, 0.0)).sin())
        vane = width * (4.5 * s.clamp(min=1e-3) ** 0.7 * (1.0 - s)).clamp(min=0.0, max=1.0) * (1.0 - split)
        return vane.maximum(0.03 * (u > -0.9) * (u < 0.8)) - v.abs()

    edge, u, v, number = place(canvas, canvas.x, canvas.y, outline, canvas.uniform(-3.1, 3.1), 0.9)
    v = (v + (0.5 * number - 0.25) * u * u).abs()
    barb = 0.55 + 0.45 * (2.0 * math.pi * barbs * (u - 0.8 * v)).sin()
    shaft = smoothstep(0.035, 0.015, v)
    vane = smoothstep(0.0, 0.03, edge) * smoothstep(0.03, 0.06, v) * barb * (0.7 + 0.3 * number)
    return vane.maximum(shaft * (edge > 0.0))


@family("scale", "scaly", "reptile", "mermaid", "roof tiles", span=(2.5, 6.0), tilt=0.8)
def scales(canvas: Canvas) -> Tensor:
    """Rows of round overlapping scales, each bright at its free edge and dark under the next."""
    stretch, ridge = canvas.uniform(0.8, 1.15), canvas.uniform(0.0, 1.0) > 0.5
    x, y = canvas.x, canvas.y * stretch
    edge, u, v, number = place(
        canvas, x + y, y - x, lambda u, v, number: 0.74 - torch.sqrt(u * u + v * v + 1e-9), 0.25 * math.pi, 0.0, 0.0
    )
    tone = (0.55 + 0.45 * number) * smoothstep(0.55, -0.75, v)
    keel = 1.0 - 0.6 * ridge * smoothstep(0.09, 0.02, u.abs())
    return (1.25 * tone * keel).clamp(max=1.0) * smoothstep(0.0, 0.1, edge)


@family("cell", "tissue", "biological", "amoeba", "organic", span=(2.0, 4.5))
def cells(canvas: Canvas) -> Tensor:
    """Living cells side by side: a bright membrane, dim grainy insides and a bright nucleus."""
    x, y = (c + 0.08 * canvas.noise(2.0 * c, 2.0 * d) for c, d in ((canvas.x, canvas.y), (canvas.y, canvas.x)))
    nearest, second, dx, dy, number = canvas.nearest_points(x, y, 0.7)
    edge = (second - nearest).minimum(1.6 * (0.62 - nearest))
    membrane = smoothstep(0.03, 0.08, edge) * smoothstep(0.22, 0.15, edge)
    grain = 0.28 + 0.12 * canvas.noise(9.0 * x, 9.0 * y, 1)
    radius, _ = polar(dx + 0.12 * (number - 0.5), dy + 0.1 * (number - 0.5))
    size = canvas.uniform(0.13, 0.18)
    nucleus = smoothstep(size, size - 0.05, radius) * (1.0 - 0.7 * smoothstep(0.07, 0.03, radius))
    inside = smoothstep(0.1, 0.2, edge) * grain * smoothstep(size, size + 0.05, radius)
    return (membrane + inside + nucleus).clamp(0.0, 1.0)


@family("branch", "tree", "trees", "twigs", "bare tree", span=(1.5, 2.6), tilt=0.5)
def branches(canvas: Canvas) -> Tensor:
    """Bare trees that fork again and again into thinner twigs."""
    count, trunks = canvas.count, 3

    def spread(low: float, high: float, columns: int) -> Tensor:
        return low + (high - low) * torch.rand(count, columns, generator=canvas.generator)

    along, across = ((torch.arange(k) + 0.5) / k for k in (16, 4))
    x = torch.linspace(-1.1, 1.1, trunks) + spread(-0.25, 0.25, trunks)
    y = spread(-1.4, -0.9, trunks)
    angle, length, width = spread(1.4, 1.75, trunks), spread(0.45, 0.6, trunks), spread(0.1, 0.15, trunks)
    fork = canvas.uniform(0.35, 0.6)[:, :, 0]
    parts = []
    for _ in range(6):
        cos, sin = angle.cos(), angle.sin()
        s, t = length[:, :, None, None] * along[:, None], width[:, :, None, None] * (across - 0.5)
        c, d = cos[:, :, None, None], sin[:, :, None, None]
        weight = (length * width)[:, :, None, None] / canvas.pixel[:, :, :, None] ** 2 / 64.0
        place_x, place_y = x[:, :, None, None] + c * s - d * t, y[:, :, None, None] + d * s + c * t
        parts.append([p.flatten(1) for p in torch.broadcast_tensors(place_x, place_y, weight)])
        x, y = (p.repeat(1, 2) for p in (x + length * cos, y + length * sin))
        columns = x.shape[1]
        side = torch.where(torch.arange(columns) < columns // 2, 1.0, -1.0)
        angle = angle.repeat(1, 2) + side * fork * spread(0.4, 1.4, columns)
        length, width = length.repeat(1, 2) * spread(0.6, 0.95, columns), width.repeat(1, 2) * 0.68
    amount = canvas.splat(*(torch.cat(p, dim=1) for p in zip(*parts, strict=True)), radius=0.5)
    return (1.3 * amount).clamp(max=1.0)


@family("wooden", "wood grain", "timber", "planks", span=(1.8, 4.0))
def wood(canvas: Canvas) -> Tensor:
    """Long lines of grain that part around the rings of knots."""
    x, y = 0.45 * canvas.x, canvas.y
    nearest, _, dx, dy, number = canvas.nearest_points(x, 0.7 * y, 0.8)
    knot = (0.2 + 0.5 * number) * torch.exp(-((4.5 * dx) ** 2 + (3.5 * dy) ** 2))
    rings = canvas.uniform(3.0, 4.5) * (y + 0.3 * canvas.noise(0.7 * x, 0.8 * y) + 2.2 * knot)
    grain = rings - rings.floor()
    lines = smoothstep(0.0, 0.75, grain) * smoothstep(1.0, 0.88, grain)
    fibre = 0.85 + 0.2 * canvas.noise(1.5 * x, 14.0 * y, 1)
    return (lines * fibre * smoothstep(0.03, 0.08, nearest)).clamp(0.0, 1.0)


@family("lawn", "meadow", "reeds", "blades of grass", "straw", span=(1.6, 3.5), tilt=0.25)
def grass(canvas: Canvas) -> Tensor:
    """Upright blades that taper and lean to either side, dark at the root."""
    lean = canvas.uniform(-0.3, 0.3)

    def outline(u: Tensor, v: Tensor, number: Tensor) -> Tensor:
        t = 0.5 * (v + 0.9)
        bend = u - (1.6 * (number - 0.5) + lean) * t * t
        return (0.3 * (1.0 - t)).minimum(t) - bend.abs()

    picture = torch.zeros(())
    for layer in range(2):
        x, y = 3.5 * canvas.x + 7.4 * layer, 1.1 * canvas.y - 5.3 * layer
        edge, _, v, number = place(canvas, x, y, outline, 0.0, 0.0, 0.8)
        blade = (0.6 + 0.4 * number) * smoothstep(-1.0, 0.4, v)
        picture = torch.where(edge > 0.0, smoothstep(0.0, 0.1, edge) * blade, picture)
    return picture


@family("eye", "eyeballs", "gaze", "pupils", span=(1.5, 3.5), tilt=0.4)
def eyes(canvas: Canvas) -> Tensor:
    """Open eyes: an almond of white with a round iris, a dark pupil, a glint and a crease above."""
    height = canvas.uniform(0.28, 0.4)

    def outline(u: Tensor, v: Tensor, number: Tensor) -> Tensor:
        return height * (1.0 - (u / 0.58) ** 2) - v.abs() + 0.1

    edge, u, v, _ = place(canvas, canvas.x, canvas.y, outline, 0.0, 0.2, 0.15)
    iris, look = canvas.uniform(0.2, 0.25), canvas.uniform(-0.1, 0.1)
    radius, angle = polar(u - look, v)
    streaks = 0.5 + 0.2 * (14.0 * angle).sin()
    ball = torch.where(radius < iris, streaks * smoothstep(iris, iris - 0.05, radius), 1.0)
    ball = ball * smoothstep(iris, iris + 0.03, radius).maximum(smoothstep(iris, iris - 0.03, radius))
    pupil = smoothstep(0.08, 0.11, radius)
    glint = smoothstep(0.06, 0.03, polar(u - look - 0.07, v - 0.07)[0])
    lid = smoothstep(0.0, 0.03, edge) * smoothstep(0.07, 0.04, edge)
    return (smoothstep(0.1, 0.14, edge) * (ball * pupil).maximum(glint)).maximum(0.8 * lid)


@family("heart", "love", "valentine", span=(2.0, 4.5), tilt=0.5)
def hearts(canvas: Canvas) -> Tensor:
    """Hearts, filled or hollow, scattered upright."""
    cleft = canvas.uniform(0.65, 0.85)

    def outline(u: Tensor, v: Tensor, number: Tensor) -> Tensor:
        size = 0.3 + 0.1 * number
        lifted = v + 0.1 - cleft * torch.sqrt(u.abs() * size + 1e-6) * (1.0 - 0.1 * cleft)
        return size - torch.sqrt(u * u + lifted * lifted + 1e-9)

    edge, _, _, number = place(canvas, canvas.x, canvas.y, outline, 0.0, 0.35, 0.25)
    hollow = ((7.0 * number).frac() < 0.3) * smoothstep(0.1, 0.14, edge)
    return smoothstep(0.0, 0.05, edge) * (1.0 - hollow)


@family("shell", "scallop", "seashell", "clam", span=(1.6, 4.0))
def shells(canvas: Canvas) -> Tensor:
    """Scallop shells: fans of ribs spread from a hinge, with a wavy rim and a few growth lines."""
    ribs, opening = canvas.integer(7, 11), canvas.uniform(0.95, 1.2)

    def outline(u: Tensor, v: Tensor, number: Tensor) -> Tensor:
        radius, angle = polar(v + 0.45, u)
        s = (angle / opening).clamp(-1.0, 1.0)
        rim = (0.85 + 0.15 * number) * (1.0 - 0.25 * s * s) * (1.0 + 0.06 * (math.pi * ribs * s).cos())
        fan = (rim - radius).minimum(0.7 * radius * (opening - angle.abs()))
        ears = (0.2 - u.abs()).minimum(0.05 - (v + 0.42).abs())
        return fan.maximum(ears)

    edge, u, v, _ = place(canvas, canvas.x, canvas.y, outline)
    radius, angle = polar(v + 0.45, u)
    rib = 0.5 + 0.5 * (math.pi * ribs * angle / opening).cos()
    growth = 0.8 + 0.2 * (22.0 * radius).cos()
    return smoothstep(0.0, 0.05, edge) * growth * (0.1 + 0.9 * rib.maximum(smoothstep(0.2, 0.08, radius)))


@family("reaction diffusion", "turing", "brain coral", "coral", "fingerprint", span=(3.0, 6.0))
def labyrinth(canvas: Canvas) -> Tensor:
    """Winding worm-like bands of equal width that fork and end, without any direction."""
    total = torch.zeros(())
    for wave in range(20):
        angle, phase = math.pi * wave / 20 + canvas.uniform(0.0, 0.3), canvas.uniform(0.0, 2.0 * math.pi)
        total = total + (9.0 * rotate(canvas.x, canvas.y, angle)[0] + phase).cos()
    level = canvas.uniform(-0.8, 0.8)
    return smoothstep(level - 0.7, level + 0.7, total)


@family("leopard spots", "jaguar", "cheetah", "rosettes", "animal print", span=(2.5, 5.5))
def leopard(canvas: Canvas) -> Tensor:
    """A bright coat with dark rosettes: broken rings around a dim middle."""
    x, y = canvas.x + 0.1 * canvas.noise(3.0 * canvas.x, 3.0 * canvas.y, 1), canvas.y
    nearest, second, dx, dy, number = canvas.nearest_points(x, y, 0.5)
    radius, angle = polar(dx, dy)
    size = (0.3 + 0.1 * number) * (1.0 + 0.15 * (2.0 * angle + 6.0 * number).sin())
    gaps = smoothstep(-0.75, -0.35, (canvas.integer(2, 4) * angle + 9.0 * number).sin())
    ring = smoothstep(0.13, 0.07, (radius - size + 0.07).abs()) * gaps * smoothstep(0.02, 0.08, second - nearest)
    middle = 0.4 * smoothstep(size, size - 0.1, radius)
    return (1.0 - middle) * (1.0 - ring)


@family("spider web", "spiderweb", "web", "spider", span=(1.2, 2.4))
def cobweb(canvas: Canvas) -> Tensor:
    """Threads out of one hub, joined by rows of threads that sag towards it."""
    radius, angle = polar(canvas.x, canvas.y)
    first, second = angle + canvas.uniform(0.0, 6.3), 2.0 * angle + canvas.uniform(0.0, 6.3)
    turn, stretch = angle + 0.35 * first.sin() + 0.2 * second.sin(), 1.0 + 0.35 * first.cos() + 0.4 * second.cos()
    spokes, gap = canvas.integer(9, 14), canvas.uniform(0.13, 0.2)
    sector = spokes * (turn / (2.0 * math.pi) + 0.5)
    t = sector - sector.floor() - 0.5
    level = radius * (1.0 + canvas.uniform(0.15, 0.3) * (1.0 - 4.0 * t * t)) / gap
    level = level + 0.5 * canvas.random(sector.floor() % spokes, torch.zeros_like(t))
    to_ring = gap * (level - level.floor() - 0.5).abs()
    to_spoke = (0.5 - t.abs()) * 2.0 * math.pi / spokes * radius / stretch
    thread = canvas.pixel * canvas.uniform(0.7, 1.2)
    return smoothstep(thread + canvas.pixel, 0.5 * thread, to_ring.minimum(to_spoke))


@family("brush", "painted", "brushwork", "van gogh", "impasto", span=(2.0, 4.5))
def brush_strokes(canvas: Canvas) -> Tensor:
    """Short thick dabs of a bristly brush, laid over one another along a winding flow."""
    flow = 2.5 * canvas.noise(0.3 * canvas.x, 0.3 * canvas.y)
    width = canvas.uniform(0.17, 0.24)

    def outline(u: Tensor, v: Tensor, number: Tensor) -> Tensor:
        ends = 0.7 + 0.08 * (40.0 * v + 9.0 * number).sin() - u.abs()
        return (0.6 * ends).minimum(width - v.abs())

    picture = torch.zeros(())
    for layer in range(2):
        x, y = 1.4 * canvas.x + 7.4 * layer, 1.4 * canvas.y - 5.3 * layer
        edge, u, v, number = place(canvas, x, y, outline, flow, 0.25, 0.5)
        bristles = 0.8 + 0.3 * canvas.noise(u + 20.0 * number, 16.0 * v + 9.0 * number, 1)
        dab = smoothstep(0.0, 0.06, edge) * bristles * (0.35 + 0.65 * number)
        picture = torch.where(edge > 0.0, dab, picture)
    return picture.clamp(0.0, 1.0)
