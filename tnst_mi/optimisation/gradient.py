"""The gradient of one frame: density → images of all views → loss, and back to the parameters (paper Alg. 1)."""

from __future__ import annotations

import gc
import math
from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
import torch

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Octave, opaque
from tnst_mi.losses.objective import Objective
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.parameterisation import Parameterisation
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.views import View, sample_views
from tnst_mi.rendering.driving import driving_renderer

#: How far the views that results are judged from reach.
_JUDGED_REACH = 0.8


@dataclass(frozen=True)
class Evaluation:
    """The loss, the value of each of its terms, and the stylized density (D, H, W) that has it."""

    loss: float
    terms: dict[str, float]
    density: mi.TensorXf


class OctaveProblem:
    """What all frames share in one octave: the size of the images, and the loss with its targets and scales.

    Args:
        objective: what to minimise.
        network: judges the images.
        octave: the grid.
        exposure: factor from rendered images to the network's [0, 1].
    """

    def __init__(self, objective: Objective, network: GoogLeNet, octave: Octave, exposure: float) -> None:
        self.octave, self.exposure = octave, exposure
        self.loss = objective.bind(network, octave.shape[1], octave.shape[2])

    def gradient(
        self,
        parameters: Parameterisation,
        density: mi.TensorXf,
        recipe: Recipe,
        seed: Sequence[int],
    ) -> Evaluation:
        """Leave the derivative of the loss, merged over random views, in the fields of the parameters.

        Args:
            parameters: fields on the octave's grid.
            density: (D, H, W), unstylized, on the octave's grid.
            recipe: the recipe of the frame.
            seed: of the views, and of the renderer where it is random.

        Raises:
            InputError: the loss is not finite.
        """
        parameters.attach()
        stylized = parameters.density(density)

        # Two phases: the views accumulate their gradient on a copy of the density, which then goes back through the
        # transport once instead of once per view.
        seen = dr.detach(stylized)
        dr.enable_grad(seen)
        images = self._images(seen, recipe, seed)

        @dr.wrap(source="drjit", target="torch")
        def loss_of(batch):  # noqa: ANN202
            return self.loss(batch)

        loss = loss_of(images)
        dr.backward(loss)
        dr.set_grad(stylized, dr.grad(seen))
        dr.enqueue(dr.ADMode.Backward, stylized)
        dr.traverse(dr.ADMode.Backward)

        terms = {name: float(value) for name, value in self.loss.last_terms.items()}
        value = float(loss.array[0])
        if not math.isfinite(value):
            raise InputError(
                f"the loss is {value}, expected a finite number; "
                f"try a smaller eta ({recipe.eta:g}) or gamma ({recipe.gamma:g})"
            )
        evaluation = Evaluation(value, terms, dr.detach(stylized))
        # `dr.wrap` ties the torch graph into reference cycles. Arrays outside Python's heap do not make the collector
        # run, so it is asked to look at the young objects, which costs little.
        del loss, images, seen, stylized
        gc.collect(1)
        return evaluation

    def gradient_square_sum(
        self, parameters: Parameterisation, density: mi.TensorXf, recipe: Recipe, seed: Sequence[int]
    ) -> dict[str, tuple[float, int]]:
        """By term, the sum of its squared image gradient over the views, and the number of pixels; see `rms_scales`."""
        with dr.suspend_grad():
            images = self._images(parameters.density(density), recipe, seed)
        return self.loss.gradient_square_sum(images.torch().clone())

    def judge(self, density: np.ndarray, recipe: Recipe) -> tuple[float, dict[str, float]]:
        """Loss of a density (D, H, W), and its terms unscaled, as means over three fixed views.

        They are the main view, and 0.8 of the way from there to both ends of the range of azimuths.
        """
        (azimuth, elevation), reach = recipe.main_view, _JUDGED_REACH * (recipe.azimuth[1] - recipe.azimuth[0]) / 2
        views = [(azimuth - reach, elevation), (azimuth, elevation), (azimuth + reach, elevation)]
        with torch.no_grad(), dr.suspend_grad():
            images = self._rendered(mi.TensorXf(density), views, recipe, (recipe.seed,))
            loss = float(self.loss(images.torch())) / len(views)
        return loss, {name: float(value) / len(views) for name, value in self.loss.last_terms.items()}

    def _images(self, density: mi.TensorXf, recipe: Recipe, seed: Sequence[int]) -> mi.TensorXf:
        views = sample_views(recipe.views, recipe.azimuth, recipe.elevation, seed)
        return self._rendered(density, views, recipe, seed)

    def _rendered(
        self, density: mi.TensorXf, views: Sequence[View], recipe: Recipe, seed: Sequence[int]
    ) -> mi.TensorXf:
        renderer = driving_renderer(recipe, self.octave.shape, self.octave.cell_size)
        return renderer.render(density, views, seed) * opaque(self.exposure)
