"""The gradient of one frame: density → images of all views → loss, and back to the fields (paper Alg. 1)."""

from __future__ import annotations

import gc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np
import torch

from tnst_mi.fields.kernels import opaque
from tnst_mi.fields.resampling import resample_density
from tnst_mi.losses.evaluation import BoundObjective
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.parameterisation import Fields
from tnst_mi.optimisation.plan import FramePlan, Plan
from tnst_mi.rendering.cameras.views import View, sample_views
from tnst_mi.rendering.driving import driving_renderer
from tnst_mi.rendering.levels import Level

#: Offset of the outer views for judging results, as a share of the way from the main view to the end of the azimuths.
_JUDGED_REACH = 0.8


@dataclass(frozen=True)
class Evaluation:
    """The loss, its terms, the stylized density (D, H, W) that has it, and its gradient with respect to the fields.

    Everything is on the device; the loss and its terms are scalar tensors.
    """

    loss: torch.Tensor
    terms: dict[str, torch.Tensor]
    density: mi.TensorXf
    gradient: Fields


@dataclass(frozen=True)
class OctaveProblem:
    """What all frames share in one octave.

    Attributes:
        octave: the grid and its images.
        loss: for images of this size, with its targets and scales.
    """

    octave: Level
    loss: BoundObjective

    def scaled(self, scales: Mapping[str, float]) -> OctaveProblem:
        """The same problem with other scales of the terms."""
        return replace(self, loss=self.loss.scaled(scales))

    def gradient(self, frame: FramePlan, fields: Fields, density: mi.TensorXf, seed: Sequence[int]) -> Evaluation:
        """The loss, summed over random views, and its derivative with respect to the fields.

        Args:
            frame: the plan of the frame.
            fields: on the octave's grid.
            density: (D, H, W), unstylized, on the octave's grid.
            seed: of the views, and of the renderer where it is random.
        """
        # Two phases: the views accumulate their gradient on a copy of the density; it is then propagated back through
        # the transport once instead of once per view.
        parameterisation = frame.parameterisation
        seen, pull_back = parameterisation.density_with_pullback(fields, density, self.octave.cell_size)
        stylized = dr.detach(seen)
        dr.enable_grad(seen)
        images = self._images(seen, frame, seed)
        found: dict[str, torch.Tensor] = {}
        loss_of_frame = self._loss_of(frame)

        @dr.wrap(source="drjit", target="torch")
        def loss_of(batch):  # noqa: ANN202
            value, terms = loss_of_frame.evaluate(batch)
            found.update(terms | {"": value.detach()})
            return value

        loss = loss_of(images)
        dr.backward(loss)
        gradient = pull_back(dr.grad(seen))
        value = found.pop("")
        # `dr.wrap` puts the torch graph into reference cycles. Arrays outside Python's heap do not trigger the garbage
        # collector, so the young generations are collected explicitly, which is cheap.
        del loss, images, seen, pull_back, loss_of
        gc.collect(1)
        return Evaluation(value, found, stylized, gradient)

    def gradient_square_sum(
        self, frame: FramePlan, fields: Fields, density: mi.TensorXf, seed: Sequence[int]
    ) -> dict[str, tuple[float, int]]:
        """Per term, the sum of its squared image gradient over the views, and the pixel count; see `rms_scales`."""
        with dr.suspend_grad():
            stylized = frame.parameterisation.density(fields, density, self.octave.cell_size)
            images = self._images(stylized, frame, seed)
        return self.loss.gradient_square_sum(images.torch().clone())

    def judge(self, frame: FramePlan, density: np.ndarray) -> tuple[float, dict[str, float]]:
        """Loss of a scaled full-resolution density (D, H, W), and its unscaled terms, as means over three fixed views.

        They are the main view, and the views 0.8 of the way from it to either end of the range of azimuths.
        """
        recipe = frame.recipe
        (azimuth, elevation), reach = recipe.main_view, _JUDGED_REACH * (recipe.azimuth[1] - recipe.azimuth[0]) / 2
        views = [(azimuth - reach, elevation), (azimuth, elevation), (azimuth + reach, elevation)]
        with torch.no_grad(), dr.suspend_grad():
            seen = resample_density(mi.TensorXf(density), 1.0, self.octave.shape, self.octave.cell_size)
            images = self._rendered(seen, views, frame, (recipe.seed,))
            loss, terms = self._loss_of(frame).evaluate(images.torch())
        return float(loss) / len(views), {name: float(value) / len(views) for name, value in terms.items()}

    def _loss_of(self, frame: FramePlan) -> BoundObjective:
        return self.loss if frame.weights is None else self.loss.weighed(frame.weights)

    def _images(self, density: mi.TensorXf, frame: FramePlan, seed: Sequence[int]) -> mi.TensorXf:
        recipe = frame.recipe
        angles = sample_views(recipe.views, recipe.azimuth, recipe.elevation, seed)
        views = [(float(azimuth), float(elevation)) for azimuth, elevation in angles]
        return self._rendered(density, views, frame, seed)

    def _rendered(
        self, density: mi.TensorXf, views: Sequence[View], frame: FramePlan, seed: Sequence[int]
    ) -> mi.TensorXf:
        octave = self.octave
        renderer = driving_renderer(frame.recipe, octave.shape, octave.cell_size, size=octave.size, pixel=octave.pixel)
        return renderer.render(density, views, seed) * opaque(frame.exposure)


def problem_of(plan: Plan, octave: Level, network: GoogLeNet) -> OctaveProblem:
    """The problem of an octave, with all scales 1.

    Raises:
        InputError: the network lacks a layer, channel or class, or a picture cannot be used.
    """
    loss = plan.objective.bind(network, *octave.size, record=True, sigma=plan.recipe.sigma == "loss")
    return OctaveProblem(octave, loss)
