"""The picture that excites a channel: gradient ascent on grey pixels, as in DeepDream (Mordvintsev et al. 2015).

It starts from faint noise at a coarse size and continues at the full size. Every step moves the pixels along the
gradient of the channel's mean, smoothed and normalised per band as in a stylization. Before each step the picture is
shifted at random, with wrap-around: whatever depends on the alignment of the network's grids averages out, and shapes
remain.

Pixels are grey because smoke is: in colour a channel may respond to green alone, which smoke cannot show.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mitsuba as mi
import numpy as np
import torch
from torch import Tensor

from tnst_mi.fields.pyramid import gaussian, normalise
from tnst_mi.losses.evaluation import BoundObjective
from tnst_mi.losses.pictures import resized
from tnst_mi.losses.terms import Semantic
from tnst_mi.machine.backend import torch_device
from tnst_mi.network.googlenet import GoogLeNet

#: The octave k before the last is smaller by this factor to the power k, as in a stylization.
_SCALE_FACTOR = 1.8

#: Width of the gradient's blur in pixels, and number of bands it is normalised in, besides the residual.
_SIGMA, _LEVELS = 1.2, 4

#: Mean and standard deviation of the initial noise.
_GREY, _NOISE = 0.5, 0.03


@dataclass(frozen=True)
class Ascent:
    """How a picture is made: rows and columns, steps in each octave, their size, and the largest shift in pixels."""

    size: int = 96
    octaves: int = 2
    iterations: int = 12
    rate: float = 0.04
    shift: int = 8
    seed: int = 0

    @property
    def steps(self) -> int:
        """Steps of all octaves together."""
        return self.octaves * self.iterations

    @property
    def sizes(self) -> list[int]:
        """Rows and columns in each octave, coarse to fine."""
        sizes = [self.size]
        for _ in range(self.octaves - 1):
            sizes.insert(0, int(sizes[0] / _SCALE_FACTOR))
        return sizes


def noise(ascent: Ascent, channel: int, size: int) -> np.ndarray:
    """The picture from which the ascent for a channel starts, (size, size) float32 in [0, 1]."""
    values = np.random.default_rng((ascent.seed, channel)).standard_normal((size, size))
    return np.clip(_GREY + _NOISE * values, 0.0, 1.0).astype(np.float32)


def excite(
    network: GoogLeNet,
    layer: str,
    channel: int,
    ascent: Ascent | None = None,
    on_iteration: Callable[[], None] = lambda: None,
) -> np.ndarray:
    """Find a grey picture for which a channel's mean is large.

    The same arguments give the same bits, whatever else was computed before.

    Args:
        network: the network, on the device of the active variant.
        layer: a layer of it.
        channel: a channel of that layer, from 0.
        ascent: the settings; None for the defaults.
        on_iteration: called after every step; an exception from it ends the ascent.

    Returns:
        The picture (size, size) float32 in [0, 1].

    Raises:
        InputError: the network has no such layer or channel.
    """
    ascent = ascent or Ascent()
    shifts = np.random.default_rng((ascent.seed, channel, 1))
    picture = noise(ascent, channel, ascent.sizes[0])
    for size in ascent.sizes:
        bound = Semantic(layer, (channel,)).bind(network, size, size)
        pixels = torch.from_numpy(resized(picture, size, size)).to(torch_device())
        for _ in range(ascent.iterations):
            shift = tuple(shifts.integers(-ascent.shift, ascent.shift + 1, 2).tolist())
            pixels = (pixels - ascent.rate * _direction(bound, pixels, shift)).clamp(0.0, 1.0)
            on_iteration()
        picture = pixels.numpy(force=True)
    return picture


def _direction(bound: BoundObjective, pixels: Tensor, shift: tuple[int, int]) -> Tensor:
    """The normalised gradient (H, W) of the loss of the shifted picture, shifted back."""
    shifted = pixels.roll(shift, (0, 1))[None].requires_grad_()
    (gradient,) = torch.autograd.grad(bound(shifted), shifted)
    gradient = gradient.roll((-shift[0], -shift[1]), (1, 2))
    # A grid with a single cell along z, along which the filters change nothing.
    return normalise(gaussian(mi.TensorXf(gradient), _SIGMA), _LEVELS).torch()[0]
