"""Draw the style pictures that the package ships: spirals, net, flames and cells.

    python scripts/draw_styles.py [FOLDER]

Each is a grey 512 x 512 PNG with the full range from black to white and motifs of about 1/8 to 1/20 of the
picture, the size that survives on smoke images of 64 x 96 pixels. Everything is drawn from formulas and fixed
seeds: the same pictures come out on every machine.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

SIZE = 512
OVERSAMPLING = 2
STYLES_FOLDER = Path(__file__).resolve().parents[1] / "tnst_mi" / "data" / "styles"


def grid() -> tuple[np.ndarray, np.ndarray]:
    """Return x to the right and y downwards, both in [0, 1), at the centres of the oversampled pixels."""
    n = SIZE * OVERSAMPLING
    centres = (np.arange(n) + 0.5) / n
    return np.meshgrid(centres, centres, indexing="xy")


def ramp(low: float, high: float, x: np.ndarray) -> np.ndarray:
    """Rise smoothly from 0 at low to 1 at high (or fall, where low > high)."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def noise(x: np.ndarray, y: np.ndarray, seed: int) -> np.ndarray:
    """Perlin's gradient noise: smooth, about -0.7 to 0.7, features of unit size."""
    angles = 2.0 * np.pi * np.random.default_rng(seed).random((64, 64))
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    u, v = x - column, y - row
    fade_u, fade_v = (t**3 * (t * (6.0 * t - 15.0) + 10.0) for t in (u, v))

    def corner(i: int, j: int) -> np.ndarray:
        angle = angles[(row + j) % 64, (column + i) % 64]
        return np.cos(angle) * (u - i) + np.sin(angle) * (v - j)

    upper = corner(0, 0) + fade_u * (corner(1, 0) - corner(0, 0))
    lower = corner(0, 1) + fade_u * (corner(1, 1) - corner(0, 1))
    return upper + fade_v * (lower - upper)


def scattered_points(spacing: float, seed: int) -> np.ndarray:
    """Scatter (n, 2) points over the picture and a margin of one spacing, none closer than the spacing."""
    generator = np.random.default_rng(seed)
    points = np.empty((0, 2))
    for dart in generator.uniform(-spacing, 1.0 + spacing, (int(60.0 / spacing**2), 2)):
        if points.size == 0 or np.hypot(*(points - dart).T).min() >= spacing:
            points = np.append(points, dart[None], axis=0)
    return points


def window(left: float, right: float, top: float, bottom: float) -> tuple[slice, slice]:
    """Return the rows and columns of the oversampled picture that a rectangle touches."""
    n = SIZE * OVERSAMPLING
    edges = np.clip(np.array([top, bottom, left, right]) * n, 0, n).astype(int)
    return slice(edges[0], edges[1] + 1), slice(edges[2], edges[3] + 1)


def spirals() -> np.ndarray:
    """Whorls of either handedness and several sizes, each filling its own patch of the plane."""
    x, y = grid()
    generator = np.random.default_rng(2)
    nearest, second, picture = np.full(x.shape, 1.0), np.full(x.shape, 1.0), np.zeros(x.shape)
    for centre_x, centre_y in scattered_points(0.15, seed=11):
        size = generator.uniform(0.75, 1.3)
        hand, turn = generator.choice([-1.0, 1.0]), generator.uniform(0.0, 2.0 * np.pi)
        part = window(centre_x - 0.25, centre_x + 0.25, centre_y - 0.25, centre_y + 0.25)
        dx, dy = x[part] - centre_x, y[part] - centre_y
        radius = np.hypot(dx, dy)
        phase = 2.0 * np.pi * radius / (0.052 * size) + hand * np.arctan2(dy, dx) + turn
        ribbon = ramp(-0.75, 0.75, np.sin(phase + 0.45 * np.sin(phase)))
        distance = radius / size
        inside = distance < nearest[part]
        second[part] = np.minimum(second[part], np.maximum(nearest[part], distance))
        nearest[part] = np.minimum(nearest[part], distance)
        picture[part] = np.where(inside, ribbon * ramp(0.16, 0.05, distance) ** 0.35, picture[part])
    return picture * ramp(0.0, 0.02, second - nearest)


def net() -> np.ndarray:
    """A sagging net of twisted ropes, each over the next and under the one after, swollen to knots there."""
    x, y = grid()
    x, y = (t + 0.07 * noise(3.0 * x + 9.0, 3.0 * y, seed) for t, seed in ((x, 5), (y, 6)))
    spacing = 0.13
    along, across = (x + y) / spacing / np.sqrt(2.0), (x - y) / spacing / np.sqrt(2.0)
    parity = np.where((np.round(along) + np.round(across)) % 2 == 0, 1.0, -1.0)

    def rope(side: np.ndarray, position: np.ndarray, over: np.ndarray) -> np.ndarray:
        from_crossing = np.abs(position - np.round(position))
        distance = (side - np.round(side)) / (0.14 + 0.08 * ramp(0.3, 0.0, from_crossing))
        profile = np.clip(1.0 - distance**2, 0.0, 1.0) ** 0.6
        strands = 0.5 + 0.5 * np.cos(2.0 * np.pi * (4.0 * position + 0.3 * distance))
        height = 0.72 + 0.28 * over * np.cos(np.pi * from_crossing)
        return profile * (0.4 + 0.6 * np.sqrt(strands)) * height

    first, other = rope(along, across, parity), rope(across, along, -parity)
    over, under = np.where(parity > 0.0, (first, other), (other, first))
    return np.where(over > 0.0, over, under)


def flames() -> np.ndarray:
    """Tongues of fire licking upwards, one before the other: a bright rim, a darker heart, black gaps."""
    x, y = grid()
    x = x + 0.03 * noise(4.0 * x, 4.0 * y, 21) + 0.01 * noise(12.0 * x, 8.0 * y, 22)
    generator = np.random.default_rng(23)
    roots = scattered_points(0.075, seed=24) * (1.0, 1.2) + (0.0, 0.1)
    picture = np.zeros(x.shape)
    for root_x, root_y in roots[np.argsort(roots[:, 1])]:
        height, half_width = generator.uniform(0.22, 0.34), generator.uniform(0.045, 0.075)
        lean, hook = (
            generator.uniform(-0.06, 0.06),
            generator.choice([-1.0, 1.0]) * generator.uniform(0.03, 0.06),
        )
        part = window(root_x - 0.25, root_x + 0.25, root_y - height, root_y)
        s = (root_y - y[part]) / height
        middle = root_x + lean * s + hook * np.sin(2.0 * np.pi * (0.1 + 0.9 * s)) * s
        width = half_width * np.sqrt(np.clip(s, 0.0, 1.0) + 0.03) * 1.9 * np.clip(1.0 - s, 0.0, 1.0) ** 0.9 + 1e-9
        depth = 1.0 - np.abs(x[part] - middle) / width
        rim = ramp(0.12, 0.4, depth) * (1.0 - 0.9 * ramp(0.45, 0.85, depth))
        tip = ramp(0.5, 0.95, s) * ramp(0.12, 0.5, depth)
        cover = (depth > 0.0) & (s > 0.0)
        picture[part] = np.where(cover, np.maximum(rim, tip) * ramp(0.0, 0.25, s), picture[part])
    return picture


def cells() -> np.ndarray:
    """Living tissue: domed cells lit from the upper left, dark membranes between them, a nucleus in each."""
    x, y = grid()
    warped_x, warped_y = (t + 0.014 * noise(6.0 * x, 6.0 * y, seed) for t, seed in ((x, 31), (y, 32)))
    nearest, second, light = np.full(x.shape, 1.0), np.full(x.shape, 1.0), np.zeros(x.shape)
    for centre_x, centre_y in scattered_points(0.092, seed=33):
        part = window(centre_x - 0.2, centre_x + 0.2, centre_y - 0.2, centre_y + 0.2)
        dx, dy = warped_x[part] - centre_x, warped_y[part] - centre_y
        distance = np.hypot(dx, dy)
        inside = distance < nearest[part]
        second[part] = np.minimum(second[part], np.maximum(nearest[part], distance))
        nearest[part] = np.minimum(nearest[part], distance)
        light[part] = np.where(inside, 0.75 - 3.5 * (dx + dy), light[part])
    body = ramp(0.005, 0.04, second - nearest)
    nucleus = ramp(0.026, 0.012, nearest)
    return body * np.clip(light, 0.25, 1.0) * (1.0 - 0.85 * nucleus)


STYLES: dict[str, Callable[[], np.ndarray]] = {
    "spirals": spirals,
    "net": net,
    "flames": flames,
    "cells": cells,
}


def draw(name: str) -> Image.Image:
    """Draw one style: oversampled, averaged down, stretched to the full 8-bit range."""
    fine = STYLES[name]()
    pixels = fine.reshape(SIZE, OVERSAMPLING, SIZE, OVERSAMPLING).mean((1, 3))
    pixels = (pixels - pixels.min()) / (pixels.max() - pixels.min())
    return Image.fromarray(np.uint8(np.round(255.0 * pixels)))


def main() -> None:
    """Draw all styles into the folder given on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=STYLES_FOLDER, help="default: the package's own")
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    for name in STYLES:
        draw(name).save(folder / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
