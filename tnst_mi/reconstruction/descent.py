"""The extinction of one grid, changed until its renderings are the pictures: stochastic gradient descent by Adam.

What is lowered is the mean square of the difference between pixels and pictures, plus a prior on the extinction σ, its
total variation: of all densities that fit as well as the noise allows, the one with the fewest and clearest edges. With
noise ν and pixels in parts of the peak, both are the negative logarithm of a posterior up to a factor:

    mean (pixel − picture)² + ν² · PRIOR · L · mean |∇σ|

L is the longest edge of the grid, which makes the prior one of optical depths: the same smoke in more cells has the
same prior. After each step, negative extinctions become 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby

import mitsuba as mi
import numpy as np
import torch
from torch import Tensor

from tnst_mi.fields.grid import Octave
from tnst_mi.fields.torch_operation import called_from_torch
from tnst_mi.machine.backend import torch_device
from tnst_mi.reconstruction.image_model import ImageModel
from tnst_mi.reconstruction.photographs import Photograph
from tnst_mi.reconstruction.rendering import RendererChoice

#: Weight of the prior, chosen for the least error of scenes/obstacle from 36 views with 1% noise.
PRIOR = 0.75

#: By how much Adam changes the extinction of a cell in a step, at most, in parts of a typical extinction.
_STEP = 0.1

#: Decay of Adam's moments. Few steps are done, so that the second one has to be quick too.
_BETAS = (0.9, 0.99)

#: Differences of the extinction below this share of a typical one count as smooth.
_SMOOTH = 1e-3


class Descent:
    """The steps on one grid.

    Args:
        octave: the grid.
        extinction: (D, H, W) float32, σ per full-resolution cell, where it starts.
        typical: a typical extinction of smoke, in the same unit.
        photographs: what is to be fitted, in units of the peak, averaged for this grid.
        renderers: what renders it.
        model: what a pixel is taken to be.
        noise: ν, of the pictures, in units of the peak.
        longest: L, of the full grid, in its cells.
        steps: how many will be done.
        batch: views of a step.
        seed: of the order of the views.
        waits: steps before what is to be found of the model is found: an extinction that is nothing yet tells nothing.
    """

    def __init__(
        self,
        octave: Octave,
        extinction: np.ndarray,
        typical: float,
        photographs: Sequence[Photograph],
        renderers: RendererChoice,
        model: ImageModel,
        noise: float,
        longest: int,
        steps: int,
        batch: int,
        seed: Sequence[int],
        waits: int,
    ) -> None:
        device = torch_device()
        self.octave, self.steps, self.done, self.model = octave, steps, 0, model
        self.extinction = torch.from_numpy(extinction).to(device).requires_grad_()
        self._typical, self._photographs, self._renderers = typical, photographs, renderers
        self._weight = noise**2 * PRIOR * longest
        self._batch, self._seed = min(batch, len(photographs)), list(seed)
        self._views = [_OnDevice(photograph, device) for photograph in photographs]
        self._waits = waits
        self.adam = torch.optim.Adam([self.extinction], betas=_BETAS)

    @property
    def unknown(self) -> Tensor:
        """What is to be found: the extinction."""
        return self.extinction

    def step(self) -> float:
        """Do one more step; gives the mean square difference of its views, in units of the squared peak."""
        for group in self.adam.param_groups:
            group["lr"] = 0.5 * (1 + math.cos(math.pi * self.done / self.steps)) * _STEP * self._typical
        self.adam.zero_grad()
        loss = self.difference(self.extinction, self.done)
        total = loss + self._weight * self._variation() if self._weight else loss
        total.backward()
        self.adam.step()
        with torch.no_grad():
            self.extinction.clamp_(min=0.0)
        self.done += 1
        return loss.item()

    def fit_model(self) -> None:
        """Find what is to be found of the image model, by all views."""
        if not self.model.complete:
            with torch.no_grad():
                everywhere = sorted(range(len(self._views)), key=self._by_size)
                self._fit(self._rendered(self.extinction, everywhere, self.done))

    def _chosen(self, step: int) -> list[int]:
        """The views of a step: all of them once in a random order, then again in another."""
        count, first = len(self._photographs), step * self._batch
        orders = {
            epoch: np.random.default_rng([*self._seed, epoch]).permutation(count)
            for epoch in {first // count, (first + self._batch - 1) // count}
        }
        chosen = {int(orders[k // count][k % count]) for k in range(first, first + self._batch)}
        return sorted(chosen, key=self._by_size)

    def _by_size(self, number: int) -> tuple[tuple[int, ...], int]:
        """Orders views by the size of their pictures: those of one size are rendered together."""
        return self._photographs[number].values.shape, number

    def difference(self, extinction: Tensor, step: int) -> Tensor:
        """The mean square difference between pictures and renderings of an extinction, in the views of a step."""
        images = self._rendered(extinction, self._chosen(step), step)
        if not self.model.complete and step >= self._waits:
            self._fit(images)
        total, pixels = torch.zeros((), device=self.extinction.device), 0
        for number, image in images:
            view = self._views[number]
            shown = self._renderers.pixels(image, view.background, self.model)
            total = total + (view.weights * (shown - view.values) ** 2).sum()
            pixels += image.numel()
        return total / pixels

    def _rendered(self, extinction: Tensor, chosen: Sequence[int], step: int) -> list[tuple[int, Tensor]]:
        """What is seen in some views, in order of their size, each with its number."""
        found = []
        for size, group in groupby(chosen, key=lambda number: self._photographs[number].values.shape):
            numbers = list(group)
            cameras = [self._photographs[number].camera for number in numbers]
            renderer, seed = self._renderers.of(self.octave, size), [*self._seed, step]
            images = called_from_torch(
                lambda σ, renderer=renderer, cameras=cameras, seed=seed: renderer.render(σ, cameras, seed),
                [extinction],
            )
            found.extend(zip(numbers, images, strict=True))
        return found

    def _fit(self, images: Sequence[tuple[int, Tensor]]) -> None:
        views = [(image, self._views[number]) for number, image in images]
        self.model.fit([(image, view.values, view.weights, view.background) for image, view in views])

    def _variation(self) -> Tensor:
        """mean |∇σ| in units of full-resolution cells; the extinction repeats its border outside."""
        σ, h = self.extinction, self.octave.cell_size
        squares = torch.zeros_like(σ)
        for axis in range(3):
            if σ.shape[axis] > 1:
                # The last one's difference to the outside, which repeats it, is 0.
                along = (torch.diff(σ, dim=axis) / h) ** 2
                squares = squares + torch.nn.functional.pad(along, [0, 0] * (2 - axis) + [0, 1])
        return (squares + (_SMOOTH * self._typical / h) ** 2).sqrt().mean()


class _OnDevice:
    """The arrays of a photograph as tensors."""

    def __init__(self, photograph: Photograph, device: torch.device) -> None:
        self.values, self.weights = (torch.from_numpy(a).to(device) for a in (photograph.values, photograph.weights))
        background = photograph.background
        self.background = None if background is None else torch.from_numpy(background).to(device)


def rendered(
    extinction: np.ndarray,
    octave: Octave,
    photographs: Sequence[Photograph],
    renderers: RendererChoice,
    model: ImageModel,
) -> list[np.ndarray]:
    """What is seen of an extinction (D, H, W) through the cameras of photographs, in units of the peak."""
    images = []
    for number, photograph in enumerate(photographs):
        renderer = renderers.of(octave, photograph.values.shape, still=True)
        image = torch.from_numpy(renderer.render(mi.TensorXf(extinction), [photograph.camera], [number]).numpy()[0])
        background = None if photograph.background is None else torch.from_numpy(photograph.background)
        with torch.no_grad():
            images.append(renderers.pixels(image, background, model).numpy())
    return images
