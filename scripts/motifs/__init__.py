"""Sixty-four families of motifs that a smoke artist may ask for by name, drawn at random with torch.

canvas      the coordinates, random numbers and noise that the families draw with
geometric, textile, nature, mineral, fluid, fractal   the families
shading     what makes smoke of them
"""

from __future__ import annotations

import torch
from torch import Tensor

from motifs import fluid, fractal, geometric, mineral, nature, textile
from motifs.canvas import Canvas, Family
from motifs.shading import shade

FAMILIES: tuple[Family, ...] = (
    # Air, fire and water
    fluid.cloud,
    fluid.plume,
    fluid.fire,
    fluid.wisps,
    fluid.mushroom,
    fluid.waves,
    fluid.ripples,
    fluid.caustics,
    fluid.bubbles,
    fluid.drips,
    fluid.lightning,
    # Ruler and compasses
    geometric.square,
    geometric.spiral,
    geometric.checks,
    geometric.stripes,
    geometric.dots,
    geometric.rings,
    geometric.stars,
    geometric.zigzag,
    geometric.triangles,
    geometric.diamonds,
    geometric.honeycomb,
    geometric.bricks,
    geometric.maze,
    geometric.crosses,
    geometric.sunburst,
    geometric.mandala,
    geometric.contours,
    geometric.gears,
    # What hands make of thread
    textile.net,
    textile.lace,
    textile.knit,
    textile.weave,
    textile.ribbon,
    textile.braid,
    textile.chain,
    # What grows
    nature.flower,
    nature.leaves,
    nature.fur,
    nature.feathers,
    nature.scales,
    nature.cells,
    nature.branches,
    nature.wood,
    nature.grass,
    nature.eyes,
    nature.hearts,
    nature.shells,
    nature.labyrinth,
    nature.leopard,
    nature.cobweb,
    nature.brush_strokes,
    # Stone
    mineral.marble,
    mineral.cracks,
    mineral.voronoi,
    mineral.crystals,
    mineral.pebbles,
    mineral.craters,
    mineral.mountains,
    # The same at every scale
    fractal.fern,
    fractal.dragon,
    fractal.julia,
    fractal.sierpinski,
    fractal.snowflakes,
)
"""All families; the place in this list is the class of the network that is trained on them."""


def draw(kind: Family, count: int, size: int, seed: int, shaded: bool = True) -> Tensor:
    """Pictures of one family, (count, 3, size, size), RGB in 0 to 1; other seeds give other pictures.

    Without `shaded` they are as drawn, grey, before light, silhouettes and grain make smoke of them.
    """
    generator = torch.Generator().manual_seed(seed)
    canvas = Canvas(count, size, generator, kind)
    pictures = kind.paint(canvas)
    return shade(pictures, canvas) if shaded else pictures.clamp(0.0, 1.0)[:, None].expand(-1, 3, -1, -1)
