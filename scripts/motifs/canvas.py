"""What the motif families draw with: a batch of pictures, their coordinates, random numbers and noise.

Everything is a torch tensor over a whole batch, (N, H, W) for a value at every pixel and (N, 1, 1) for a number
of each picture, so that hundreds of pictures a second can be drawn while a network is being trained on them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

_TABLE = 64
"""Period of the random lattice, in cells."""


@dataclass(frozen=True)
class Family:
    """A named kind of motif and how it is drawn."""

    names: tuple[str, ...]
    """What an artist may call it; the first is the family's own name."""
    paint: Callable[[Canvas], Tensor]
    """Draws its canvas: (N, H, W), 0 where there is no smoke to 1 where it is thickest."""
    span: tuple[float, float]
    """Least and greatest number of units that a picture is wide; a motif measures about one unit."""
    tilt: float
    """Greatest rotation to either side, in radians; small for what has an up and a down."""

    @property
    def name(self) -> str:
        """The family's own name."""
        return self.names[0]


def family(
    *synonyms: str, span: tuple[float, float] = (2.5, 6.0), tilt: float = math.pi
) -> Callable[[Callable[[Canvas], Tensor]], Family]:
    """Make a family of the function below, named as the function is, and by these synonyms."""

    def decorate(paint: Callable[[Canvas], Tensor]) -> Family:
        return Family((paint.__name__.rstrip("_").replace("_", " "), *synonyms), paint, span, tilt)

    return decorate


class Canvas:
    """A batch of N empty square pictures with coordinates in motif units.

    `x` points right and `y` up, (N, H, W), the origin near the middle of each picture; both are scaled, rotated,
    shifted and gently warped, differently in each picture. `span` (N, 1, 1) is the number of units across, and
    `pixel` (N, 1, 1) the size of a pixel in units, so `smoothstep` over a `pixel` or two gives a soft edge.
    """

    def __init__(self, count: int, size: int, generator: torch.Generator, kind: Family, warp: float = 0.12) -> None:
        """Pictures of `size` pixels for a family; `warp` is the greatest amplitude of the warp, in units."""
        self.count, self.size, self.generator = count, size, generator
        self._lattice = torch.rand(count, _TABLE * _TABLE, generator=generator)
        rough = torch.randn(count, 4, _TABLE, _TABLE, generator=generator)
        self._noise = rough + rough.roll(1, 2) + rough.roll(1, 3) + rough.roll((1, 1), (2, 3))
        low, high = (math.log(bound) for bound in kind.span)
        self.span = self.uniform(low, high).exp()
        self.pixel = self.span / size
        angle = self.uniform(-kind.tilt, kind.tilt)
        self._cos, self._sin = angle.cos(), angle.sin()
        self._shift = self.uniform(-0.5, 0.5), self.uniform(-0.5, 0.5)
        centres = (torch.arange(size) + 0.5) / size - 0.5
        across = (centres[None, None, :] * self.span).expand(count, size, size)
        upwards = (-centres[None, :, None] * self.span).expand(count, size, size)
        x = self._cos * across - self._sin * upwards + self._shift[0]
        y = self._sin * across + self._cos * upwards + self._shift[1]
        amplitude = warp * self.uniform(0.0, 1.0)
        self.x = x + amplitude * self.noise(0.7 * x + 11.3, 0.7 * y, 2)
        self.y = y + amplitude * self.noise(0.7 * x, 0.7 * y + 7.9, 3)

    # --- Random numbers ---

    def uniform(self, low: float, high: float) -> Tensor:
        """One number for each picture, (N, 1, 1), uniform between the bounds."""
        return low + (high - low) * torch.rand(self.count, 1, 1, generator=self.generator)

    def integer(self, low: int, high: int) -> Tensor:
        """One whole number for each picture, (N, 1, 1) as float, from `low` to `high` inclusive."""
        return self.uniform(low, high + 1).floor().clamp(max=high)

    def sign(self) -> Tensor:
        """-1 or 1 for each picture, (N, 1, 1)."""
        return 2.0 * self.integer(0, 1) - 1.0

    def random(self, i: Tensor, j: Tensor, channel: int = 0) -> Tensor:
        """A number in 0 to 1 for each cell (i, j) of a lattice, the same wherever that cell is asked for.

        `i`, `j` (N, H, W) hold whole numbers as floats; channels are independent of each other.
        """
        return self._look_up(i.long() + 17 * channel, j.long() + 29 * channel)

    def _look_up(self, i: Tensor, j: Tensor) -> Tensor:
        """Random numbers of the cells (i, j), int64, of a lattice that repeats itself after `_TABLE` cells."""
        cell = (((j & (_TABLE - 1)) * _TABLE) + (i & (_TABLE - 1))).expand(self.count, -1, -1)
        return self._lattice.gather(1, cell.flatten(1)).reshape(cell.shape)

    # --- Fields ---

    def noise(self, x: Tensor, y: Tensor, channel: int = 0) -> Tensor:
        """Smooth noise, mean 0, standard deviation about 0.7, with features of unit size; four channels, 0 to 3."""
        # Bilinear interpolation of a smoothed table at two cells a unit: a third of bicubic's time.
        places = torch.stack(torch.broadcast_tensors(x, y), dim=-1) * (4.0 / _TABLE)
        table = 0.5 * self._noise[:, channel : channel + 1]
        return F.grid_sample(table, places, "bilinear", padding_mode="reflection", align_corners=False)[:, 0]

    def fractal_noise(self, x: Tensor, y: Tensor, octaves: int = 4, channel: int = 0) -> Tensor:
        """Sum of noise at unit size, at half of it, and so on, with halved amplitudes; deviation about 0.8."""
        total = torch.zeros(())
        for octave in range(octaves):
            scale = 2.0**octave
            total = total + self.noise(scale * x + 5.1 * octave, scale * y - 3.7 * octave, channel) / scale
        return total

    def nearest_points(
        self, x: Tensor, y: Tensor, jitter: float = 0.8, channel: int = 0
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """The nearest of a set of scattered points, one near the middle of each unit cell.

        Returns the distances to the nearest and to the second, the offset (dx, dy) from the nearest, and that
        point's random number in 0 to 1.
        """
        u, v, column, row = cell_coordinates(x, y)
        i, j = column.long(), row.long()
        nearest = second = torch.full_like(x, 9.0)
        offset_x = offset_y = torch.zeros_like(x)
        number_i, number_j = i, j
        for di in (-1, 0, 1):
            for dj in (-1, 0, 1):
                dx = u - di - jitter * (self._look_up(i + (di + 17 * channel), j + (dj + 29 * channel)) - 0.5)
                dy = v - dj - jitter * (self._look_up(i + (di + 17 * channel + 7), j + (dj + 29 * channel + 5)) - 0.5)
                squared = dx * dx + dy * dy
                closer = squared < nearest
                second = torch.minimum(second, torch.maximum(nearest, squared))
                nearest = torch.minimum(nearest, squared)
                offset_x, offset_y = torch.where(closer, dx, offset_x), torch.where(closer, dy, offset_y)
                number_i, number_j = torch.where(closer, i + di, number_i), torch.where(closer, j + dj, number_j)
        return nearest.sqrt(), second.sqrt(), offset_x, offset_y, self._look_up(number_i + 31, number_j + 11)

    # --- Points ---

    def splat(self, x: Tensor, y: Tensor, weight: Tensor | float = 1.0, radius: float = 0.0) -> Tensor:
        """Amount of points at every pixel, (N, H, W): each adds its weight, shared between the four nearest.

        `x`, `y` (N, P) are in units of the canvas, without its warp; `radius` is that of a Gaussian blur in pixels.
        """
        across, upwards = x[:, :, None] - self._shift[0], y[:, :, None] - self._shift[1]
        column = ((self._cos * across + self._sin * upwards) / self.pixel + 0.5 * self.size - 0.5)[:, :, 0]
        row = (0.5 * self.size - 0.5 - (self._cos * upwards - self._sin * across) / self.pixel)[:, :, 0]
        picture = torch.zeros(self.count, self.size * self.size)
        left, top = column.floor(), row.floor()
        for i, j in ((0, 0), (1, 0), (0, 1), (1, 1)):
            share = (1.0 - (column - left - i).abs()) * (1.0 - (row - top - j).abs()) * weight
            c, r = left + i, top + j
            inside = (c >= 0) & (c < self.size) & (r >= 0) & (r < self.size)
            cell = torch.where(inside, r * self.size + c, torch.zeros_like(c)).long()
            picture.scatter_add_(1, cell, torch.where(inside, share, torch.zeros_like(share)))
        picture = picture.reshape(self.count, self.size, self.size)
        return blur(picture, radius) if radius > 0.0 else picture


def smoothstep(low: Tensor | float, high: Tensor | float, x: Tensor) -> Tensor:
    """Rise smoothly from 0 at `low` to 1 at `high`, or fall where `low` > `high`."""
    t = ((x - low) / (high - low)).clamp(0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def cell_coordinates(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The unit cell that each pixel is in: coordinates from its middle, -0.5 to 0.5, and its column and row."""
    i, j = x.floor(), y.floor()
    return x - i - 0.5, y - j - 0.5, i, j


def rotate(x: Tensor, y: Tensor, angle: Tensor | float) -> tuple[Tensor, Tensor]:
    """Coordinates in a frame that is turned by `angle` (counter-clockwise)."""
    angle = torch.as_tensor(angle)
    cos, sin = angle.cos(), angle.sin()
    return cos * x + sin * y, cos * y - sin * x


def polar(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Radius and angle, the latter from -pi to pi."""
    return torch.sqrt(x * x + y * y + 1e-12), torch.atan2(y, x)


def blur(pictures: Tensor, radius: float) -> Tensor:
    """Gaussian blur of (N, H, W) with a standard deviation of `radius` pixels; edges repeat."""
    reach = max(1, math.ceil(2.5 * radius))
    taps = torch.exp(-0.5 * (torch.arange(-reach, reach + 1) / radius) ** 2)
    taps = taps / taps.sum()
    padded = F.pad(pictures[:, None], (reach,) * 4, mode="replicate")
    return F.conv2d(F.conv2d(padded, taps.reshape(1, 1, 1, -1)), taps.reshape(1, 1, -1, 1))[:, 0]
