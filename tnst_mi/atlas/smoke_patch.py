"""A ball of smoke stylized towards a channel: a small stylization, seen from the front."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import mitsuba as mi
import numpy as np

from tnst_mi.fields.pyramid import gaussian
from tnst_mi.frame import Frame
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.single_frame import optimise
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.driving import main_view
from tnst_mi.rendering.exposure import exposure_for

#: Radius of the ball relative to each side of the grid.
_RADIUS = 0.48

#: Unevenness of the smoke: standard deviation of its logarithm, and the size of its clumps (σ) in cells.
_UNEVENNESS, _CLUMPS = 0.4, 2.0


@dataclass(frozen=True)
class PatchSettings:
    """How a patch is made: the grid (D, H, W) of the ball, keys of the recipe, and the seed of ball and views."""

    shape: tuple[int, int, int] = (24, 96, 96)
    recipe: Mapping[str, Any] = field(
        default_factory=lambda: {
            "lam": 0.5,
            "transport": "step",
            "gamma": 0.05,
            # The ball has units of its own.
            "density_scale": 1.0,
            "eta": 0.025,
            "octaves": 2,
            "iterations": 7,
            "views": 2,
        }
    )
    seed: int = 0

    @property
    def steps(self) -> int:
        """Iterations of all octaves together."""
        recipe = Recipe.from_dict(self.recipe)
        return recipe.octaves * recipe.iterations


@dataclass(frozen=True)
class Patch:
    """The main view (H, W) in [0, 1] of the stylized ball, and the channel's mean before and after.

    The means are taken over three views, `before` and `after` the stylization.
    """

    image: np.ndarray
    before: float
    after: float


def ball(shape: tuple[int, int, int], seed: int) -> np.ndarray:
    """An uneven, soft ball of smoke that fills a grid: (D, H, W) float32, ≥ 0.

    Uniform smoke would not do: transporting it changes nothing.
    """
    square = sum(
        ((np.arange(n) - (n - 1) / 2) / (_RADIUS * n)).reshape([-1 if i == axis else 1 for i in range(3)]) ** 2
        for axis, n in enumerate(shape)
    )
    clumps = gaussian(mi.TensorXf(np.random.default_rng(seed).standard_normal(shape).astype(np.float32)), _CLUMPS)
    clumps = clumps.numpy() / clumps.numpy().std()
    return (np.clip(1.0 - square, 0.0, None) * np.exp(_UNEVENNESS * clumps)).astype(np.float32)


def stylized_ball(
    network: GoogLeNet,
    layer: str,
    channel: int,
    settings: PatchSettings | None = None,
    on_iteration: Callable[[], None] = lambda: None,
) -> Patch:
    """Stylize the ball towards a channel.

    The same arguments give the same bits.

    Args:
        network: the network.
        layer: a layer of it.
        channel: a channel of that layer, from 0.
        settings: of the ball and the stylization; None for the defaults.
        on_iteration: called after every iteration.

    Raises:
        InputError: the network has no such layer or channel.
        KeyboardInterrupt: Ctrl-C was pressed.
    """
    settings = settings or PatchSettings()
    recipe = Recipe.from_dict({**settings.recipe, "semantic": [f"{layer}:{channel}"], "seed": settings.seed})
    density = ball(settings.shape, settings.seed)
    stylized = optimise(Frame(density), recipe, network, on_iteration=lambda progress: on_iteration())
    if stylized.interrupted:
        raise KeyboardInterrupt
    exposure = exposure_for(float(main_view(density, recipe).max()))
    image = np.clip(exposure * main_view(stylized.density, recipe), 0.0, 1.0)
    (name,) = stylized.terms_after
    return Patch(image, -stylized.terms_before[name], -stylized.terms_after[name])
