"""A loaded Mitsuba scene and an integrator: images in independent batches, derivatives of a weighted mean of them."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.compare.bench.renderers.parameters import SceneParameters
from tnst_mi.compare.bench.renderers.variants import LUMINANCE
from tnst_mi.compare.bench.statistics.batches import Batches
from tnst_mi.compare.values import seed_of
from tnst_mi.machine.garbage import collection_paused

#: Paths per pixel of one launch: a film adds them up in float32, which loses 1e-4 of the sum of 65 536.
_DEEPEST_LAUNCH = 4096

#: Paths of one launch, for the memory.
_LARGEST_LAUNCH = 1 << 20

#: Called with the number of paths per pixel that were traced.
Traced = Callable[[int], None]


@dataclass(frozen=True, eq=False)
class SideRenderer:
    """Renders one side.

    Attributes:
        scene: its first sensor renders it.
        integrator: in place of the scene's own.
        views: V, the number of views that the film shows from top to bottom.
        free_of_noise: whether one path per pixel is all there is.
        traces_paths: whether paths are random, and not only their places in pixels.
        offset, factor: an image is `offset` + `factor` times what the film holds.
        brightest: what no path in the film exceeds.
        of_luminance: whether a film of red, green and blue is shown by its luminance.
        remark: what its images do not show precisely; "" if there is nothing to say.
    """

    scene: mi.Scene
    integrator: mi.Integrator
    views: int
    free_of_noise: bool
    traces_paths: bool = True
    offset: float = 0.0
    factor: float = 1.0
    brightest: float = math.inf
    of_luminance: bool = False
    remark: str = ""

    @functools.cached_property
    def shape(self) -> tuple[int, int, int, int]:
        """(V, H, W, C) of the images; C is 1 or 3, without alpha."""
        rows, columns, channels = self._film_shape
        return self.views, rows // self.views, columns, 1 if channels < 3 or self.of_luminance else 3

    @functools.cached_property
    def _film_shape(self) -> tuple[int, int, int]:
        # Not a single path: polarized variants cannot record the loop of one.
        rows, columns, channels = self._film(2, 0).shape
        return rows, columns, channels

    @property
    def differentiates(self) -> bool:
        """Whether the integrator has derivatives of its own. Mitsuba would differentiate the code of others as it
        stands, which leaves out how the probabilities of paths change."""
        return isinstance(self.integrator, mi.CppADIntegrator)

    def images(self, spp: int, count: int, seed: Sequence[int], traced: Traced) -> Batches:
        """(batches, V, H, W, C), of `spp` paths per pixel all together in `count` batches, or a single one."""
        paths, count = self._divided(spp, count)
        batches = []
        for batch in range(count):
            batches.append(self._image(paths, (*seed, batch)))
            traced(paths)
        values = np.stack(batches)
        low, high = sorted(self.offset + self.factor * light for light in (0.0, self.brightest))
        # A filter of pixels may have negative weights.
        inside = values.min(initial=0.0) >= low if self.factor > 0 else values.max(initial=0.0) <= high
        ends = (low, high) if self.traces_paths and inside else (-math.inf, math.inf)
        return Batches(values, self.traces_paths, paths, ends)

    def derivatives(
        self, parameters: SceneParameters, name: str, spp: int, count: int, seed: Sequence[int], traced: Traced
    ) -> Batches:
        """Of the weighted mean with respect to a parameter, by the integrator's own differentiation: (batches,).

        One that is 0 in all batches may have been missed by chance: see `batches.comparable`.
        """
        paths, count = self._divided(spp, count)
        sensor = self.scene.sensors()[0]
        adjoint = mi.TensorXf(self._on_film(self.factor * ramp(self.shape)).astype(np.float32))
        batches = []
        for batch in range(count):
            total = 0.0
            for launch, part in enumerate(self._launches(paths)):
                number = seed_of(*seed, batch, launch)
                with parameters.differentiated(name) as tracked:
                    with dr.suspend_grad(), collection_paused():
                        self.integrator.render_backward(self.scene, tracked, adjoint, sensor, seed=number, spp=part)
                    total += part / paths * parameters.gradient(name)
            batches.append(total)
            traced(paths)
        return Batches(np.array(batches), self.traces_paths, paths)

    def differences(
        self, parameters: SceneParameters, name: str, spp: int, count: int, seed: Sequence[int], traced: Traced
    ) -> Batches:
        """The same by central differences: (batches,).

        All images of a batch have the same random numbers, and those of one step and of two are extrapolated, so that
        what is left of the step is of its fourth order.
        """
        paths, count = self._divided(spp, count)
        weights, step = ramp(self.shape), parameters.step(name)
        batches = []
        for batch in range(count):
            slopes = []
            for steps in (1, 2):
                values = []
                for sign in (1, -1):
                    with parameters.displaced(name, sign * steps * step):
                        values.append(float((weights * self._image(paths, (*seed, batch))).sum()))
                slopes.append((values[0] - values[1]) / (2 * steps * step))
            batches.append((4 * slopes[0] - slopes[1]) / 3)
            traced(4 * paths)
        return Batches(np.array(batches), self.traces_paths, paths)

    def _divided(self, spp: int, count: int) -> tuple[int, int]:
        """Paths per pixel of a batch, as many as the sampler can draw, and the number of batches."""
        if self.free_of_noise:
            return 1, 1
        sampler = self.scene.sensors()[0].sampler()
        sampler.set_sample_count(-(-spp // count))
        return int(sampler.sample_count()), count

    def _launches(self, paths: int) -> list[int]:
        views, rows, columns, _ = self.shape
        most = max(1, min(_DEEPEST_LAUNCH, _LARGEST_LAUNCH // (views * rows * columns)))
        return [min(most, paths - first) for first in range(0, paths, most)]

    def _image(self, paths: int, seed: Sequence[int]) -> np.ndarray:
        total = np.zeros(self.shape)
        for launch, part in enumerate(self._launches(paths)):
            values = self._film(part, seed_of(*seed, launch))
            values = values[..., :3] @ np.array(LUMINANCE) if self.of_luminance else values[..., : self.shape[-1]]
            total += part / paths * values.reshape(self.shape)
        return self.offset + self.factor * total

    def _on_film(self, weights: np.ndarray) -> np.ndarray:
        """Weights of the channels of the film, from those (V, H, W, C) of the image."""
        film = np.zeros(self._film_shape)
        if self.of_luminance:
            weights = weights * np.array(LUMINANCE)
        film[..., : weights.shape[-1]] = weights.reshape(*film.shape[:2], -1)
        return film

    def _film(self, spp: int, seed: int) -> np.ndarray:
        sensor = self.scene.sensors()[0]
        with collection_paused():
            image = mi.render(self.scene, sensor=sensor, integrator=self.integrator, spp=spp, seed=seed)
            return image.numpy().astype(np.float64)


def ramp(shape: tuple[int, int, int, int]) -> np.ndarray:
    """The weights (V, H, W, C) of the mean that is differentiated, of sum 1: brighter to the right and downwards, since
    the plain mean hardly changes when the sensor moves."""
    _, rows, columns, _ = shape
    across, down = (np.linspace(-1, 1, n) if n > 1 else np.zeros(1) for n in (columns, rows))
    weights = np.broadcast_to((1 + across / 2 + down[:, None] / 3)[None, :, :, None], shape)
    return weights / weights.sum()
