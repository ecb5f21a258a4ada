"""The extinction of one grid, changed until its renderings are the pictures: stochastic gradient descent by Adam.

What is lowered is the mean square of the difference between pixels and pictures, in parts of the peak, plus the
roughness of the extinction (`prior`), by the weight ν² M / N that makes both a posterior: ν is the noise of the
pictures, M the number of cells and N that of all pixels. After each step, negative extinctions become 0.

Where the brightness of smoke is to be found, the steps go round by round, with another brightness in each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import groupby

import mitsuba as mi
import numpy as np
import torch
from torch import Tensor

from tnst_mi.fields.grid import Octave
from tnst_mi.fields.torch_operation import called_from_torch
from tnst_mi.machine.backend import torch_device
from tnst_mi.reconstruction.fitting.brightness_search import BrightnessSearch
from tnst_mi.reconstruction.fitting.image_model import ImageModel, SeenView
from tnst_mi.reconstruction.fitting.prior import roughness
from tnst_mi.reconstruction.fitting.rendering import RendererChoice
from tnst_mi.reconstruction.photographs import Photograph

#: By how much Adam changes the extinction of a cell in a step, at most, in parts of a typical extinction.
#: A step makes as much of noise as of what there is to find: where derivatives are noisy, smaller ones average more.
_STEP, _NOISY_STEP = 0.1, 0.03

#: Decay of Adam's moments. Few steps are done, so that the second one has to be quick too.
_BETAS = (0.9, 0.99)


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
        steps: how many will be done.
        rounds: into how many descents they are divided, each with its own brightness if that is to be found.
        batch: views of a step.
        seed: of the order of the views.
        outline: (D, H, W) bool, where there can be smoke; elsewhere the extinction stays 0. None for everywhere.
        waits: steps before a background is to be found: an extinction that is nothing yet tells nothing.

    Attributes:
        extinction: likewise, as a tensor, as found so far.
        done: steps so far.
        search: of the brightness.
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
        steps: int,
        rounds: int,
        batch: int,
        seed: Sequence[int],
        outline: np.ndarray | None,
        waits: int,
    ) -> None:
        device = torch_device()
        self.octave, self.steps, self.done, self.model = octave, steps, 0, model
        self.extinction = torch.from_numpy(extinction).to(device).requires_grad_()
        self._photographs, self._renderers = photographs, renderers
        pixels = sum(float(photograph.weights.sum(dtype=np.float64)) for photograph in photographs)
        self._prior = noise**2 * extinction.size / pixels
        self._batch, self._seed = min(batch, len(photographs)), list(seed)
        self._views = [_OnDevice(photograph, device) for photograph in photographs]
        self._outline = None if outline is None else torch.from_numpy(outline).to(device)
        self._rate = (_NOISY_STEP if renderers.noisy else _STEP) * typical
        self._waits, self._round, self.search = waits, max(1, steps // rounds), BrightnessSearch()
        self.adam = torch.optim.Adam([self.extinction], betas=_BETAS)

    @property
    def unknown(self) -> Tensor:
        """What is to be found: the extinction."""
        return self.extinction

    @property
    def remembered(self) -> dict[str, Tensor]:
        """The light that has been found so far, and where else it was looked for."""
        return {
            "light": torch.tensor([self.model.brightness, self.model.background], dtype=torch.float64),
            "search": torch.tensor(self.search.points, dtype=torch.float64).reshape(-1, 2),
        }

    def remember(self, tensors: Mapping[str, Tensor]) -> None:
        """Go on with what was `remembered`."""
        self.model.brightness, self.model.background = tensors["light"].tolist()
        if not self.model.brightness > 0:
            raise ValueError("no brightness")
        self.search.points = [(place, value) for place, value in tensors["search"].tolist()]

    def step(self) -> float:
        """Do one more step; gives the mean square difference of its views, in units of the squared peak."""
        if self.model.find_brightness and self.done and self.done % self._round == 0:
            self._search_brightness()
        for group in self.adam.param_groups:
            part = self.done % self._round / self._round
            group["lr"] = 0.5 * (1 + math.cos(math.pi * part)) * self._rate
        self.adam.zero_grad()
        loss = self.difference(self.extinction, self.done)
        prior = self._prior * roughness(self.extinction, self.model.find_brightness) if self._prior else 0.0
        (loss + prior).backward()
        self.adam.step()
        with torch.no_grad():
            self.extinction.clamp_(min=0.0)
            if self._outline is not None:
                self.extinction.mul_(self._outline)
        self.done += 1
        return loss.item()

    def fit_background(self) -> None:
        """Find the background by all views, if it is to be found."""
        if self.model.find_background:
            self.model.fit_background(self._seen_in_all())

    def misfits(self) -> tuple[float, float]:
        """The mean square difference of all pictures from what is found, and from what is seen without any smoke."""
        found, nothing = 0.0, 0.0
        for image, values, weights, background in self._seen_in_all():
            of_found, of_nothing = (
                float((weights * (self._renderers.pixels(shown, background, self.model) - values) ** 2).sum())
                for shown in (image, torch.zeros_like(image))
            )
            found, nothing = found + of_found, nothing + of_nothing
        pixels = sum(view.values.numel() for view in self._views)
        return found / pixels, nothing / pixels

    def _search_brightness(self) -> None:
        """Change the brightness towards the best one; emission, which thin smoke shows, stays the same."""
        before = 1 / self.model.brightness
        after = self.search.next(before, self.model.slope(self._seen_in_all()))
        self.model.brightness = 1 / after
        with torch.no_grad():
            self.extinction.mul_(after / before)

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
        if self.model.find_background and step >= self._waits:
            self.model.fit_background(self._seen(images))
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

    def _seen_in_all(self) -> list[SeenView]:
        """All views, as the extinction is now."""
        with torch.no_grad():
            everywhere = sorted(range(len(self._views)), key=self._by_size)
            return self._seen(self._rendered(self.extinction, everywhere, self.done))

    def _seen(self, images: Sequence[tuple[int, Tensor]]) -> list[SeenView]:
        views = [(image.detach(), self._views[number]) for number, image in images]
        return [(image, view.values, view.weights, view.background) for image, view in views]


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
