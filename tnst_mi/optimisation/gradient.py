"""The gradient of one frame: density → images of all views → loss, and back to the fields (paper Alg. 1)."""

from __future__ import annotations

import gc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np
import torch

from tnst_mi.errors import InputError
from tnst_mi.fields.kernels import opaque
from tnst_mi.fields.resampling import resample_density, resample_mask
from tnst_mi.losses.evaluation import BoundObjective
from tnst_mi.losses.guided import UNGUIDED, Guide, Guides
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.colouring import COLOUR, on_octave
from tnst_mi.optimisation.parameterisation import Fields
from tnst_mi.optimisation.plan import FramePlan, Plan
from tnst_mi.regions.seen import seen_in_views
from tnst_mi.rendering.cameras.views import View, sample_views
from tnst_mi.rendering.driving import colour_renderer, driving_renderer
from tnst_mi.rendering.levels import Level
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

#: Offset of the outer views for judging results, as a share of the way from the main view to the end of the azimuths.
_JUDGED_REACH = 0.8


@dataclass(frozen=True)
class Evaluation:
    """The loss, its terms, the stylized density (D, H, W) that has it, and the gradient of each target's loss with
    respect to the fields.

    Everything is on the device; the loss and its terms are scalar tensors.
    """

    loss: torch.Tensor
    terms: dict[str, torch.Tensor]
    density: mi.TensorXf
    gradients: tuple[Fields, ...]


@dataclass(frozen=True)
class OctaveProblem:
    """What all frames share in one octave.

    Attributes:
        octave: the grid and its images.
        losses: for each target, that for images of this size, with its targets and scales.
    """

    octave: Level
    losses: tuple[BoundObjective, ...]

    @property
    def scales(self) -> dict[str, float]:
        """The scales of the terms of all targets, by `term_name`."""
        return {
            self.term_name(number, name): scale
            for number, loss in enumerate(self.losses)
            for name, scale in loss.scales.items()
        }

    def scaled(self, scales: Mapping[str, float]) -> OctaveProblem:
        """The same problem with other scales of the terms."""
        if set(scales) != set(self.scales):
            raise InputError(f"loss scales: they are for {sorted(scales)}, expected {sorted(self.scales)}")
        losses = tuple(
            loss.scaled({name: scales[self.term_name(number, name)] for name in loss.names})
            for number, loss in enumerate(self.losses)
        )
        return replace(self, losses=losses)

    def term_name(self, number: int, name: str) -> str:
        """The name of a term among those of all targets, which may have the same terms."""
        return name if len(self.losses) == 1 else f"target {number + 1}: {name}"

    def gradient(
        self,
        frame: FramePlan,
        fields: Fields,
        density: mi.TensorXf,
        seed: Sequence[int],
        regions: Sequence[mi.TensorXf | None] = (),
        start: mi.TensorXf | None = None,
    ) -> Evaluation:
        """The loss, summed over random views, and the derivative of each target's with respect to the fields.

        Args:
            frame: the plan of the frame.
            fields: on the octave's grid.
            density: (D, H, W), unstylized, on the octave's grid.
            seed: of the views, and of the renderer where it is random.
            regions: for each target, its mask on the octave's grid, or None for everywhere; none at all if all are.
            start: the colours that the fields change, (D, H, W, 3) likewise; None for grey smoke.
        """
        # Two phases: the views accumulate their gradient on a copy of the density; it is then propagated back through
        # the transport once instead of once per view.
        parameterisation = frame.parameterisation
        seen, pull_back = parameterisation.density_with_pullback(fields, density, self.octave.cell_size)
        stylized = dr.detach(seen)
        dr.enable_grad(seen)
        parts = [self._loss_of(frame, target).drawn(seed).apart() for target in range(len(self.losses))]
        strokes = any(of_all is not None for of_all, _ in parts)
        colour, pull_colour_back = frame.coloured(fields, start, self.octave.cell_size, strokes)
        dr.enable_grad(colour)
        views = self._views(frame, seed)
        exposure = opaque(frame.exposure)
        raw = images = tinted = of_strokes = None
        # Without strokes, colours alone are differentiated.
        if strokes:
            raw = self._unexposed(seen, views, frame, seed, colour)
            images = raw * exposure
        found: dict[str, torch.Tensor] = {}
        values: list[torch.Tensor] = []
        gradients = []

        @dr.wrap(source="drjit", target="torch")
        def loss_of(batch, loss, target, guides):  # noqa: ANN202
            value, terms = loss.evaluate(batch, guides)
            found.update({self.term_name(target, name): term for name, term in terms.items()})
            values.append(value.detach())
            return value

        of_targets = self._guides(stylized, regions, views, frame)
        # What colours alone follow is differentiated on the same images, of which the density is fixed.
        if colour is not None and any(of_colour is not None for _, of_colour in parts):
            tinted = self._unexposed(stylized, views, frame, seed, colour, None if raw is None else dr.detach(raw))
            tinted = tinted * exposure
        shares = []
        for target, guides in enumerate(of_targets):
            # The images are those of all targets: their graph is kept until the last one has been differentiated.
            last = target == len(of_targets) - 1
            flags = dr.ADFlag.Default if last else dr.ADFlag.ClearVertices
            for loss, shown in zip(parts[target], (images, tinted), strict=True):
                if loss is not None and shown is not None:
                    dr.backward(loss_of(shown, loss, target, guides.needed(loss.of_smoke)), flags)
                    shares.append(frame.shares[target])
                if strokes and shown is images and colour is not None:
                    of_strokes = dr.grad(colour)
            gradients.append(pull_back(dr.grad(seen), last))
            dr.clear_grad(seen)
            if colour is not None:
                of_colour = pull_colour_back(dr.grad(colour), of_strokes, last)
                gradients[-1] = Fields({**(gradients[-1] + of_colour), COLOUR: of_colour[COLOUR]})
                dr.clear_grad(colour)
        # `dr.wrap` puts the torch graph into reference cycles. Arrays outside Python's heap do not trigger the garbage
        # collector, so the young generations are collected explicitly, which is cheap.
        del raw, images, tinted, seen, pull_back, pull_colour_back, loss_of
        gc.collect(1)
        return Evaluation(_total(values, shares), found, stylized, tuple(gradients))

    def gradient_square_sum(
        self,
        frame: FramePlan,
        fields: Fields,
        density: mi.TensorXf,
        seed: Sequence[int],
        regions: Sequence[mi.TensorXf | None] = (),
        start: mi.TensorXf | None = None,
    ) -> dict[str, tuple[float, int]]:
        """Per term, the sum of its squared image gradient over the views, and the pixel count; see `rms_scales`."""
        with dr.suspend_grad():
            stylized = frame.parameterisation.density(fields, density, self.octave.cell_size)
            views = self._views(frame, seed)
            colour, _ = frame.coloured(fields, start, self.octave.cell_size, followed=False)
            images = self._rendered(stylized, views, frame, seed, colour).torch().clone()
            of_targets = self._guides(stylized, regions, views, frame)
        return {
            self.term_name(target, name): found
            for target, guides in enumerate(of_targets)
            for name, found in self.losses[target].drawn(seed).gradient_square_sum(images, guides).items()
        }

    def judge(
        self,
        frame: FramePlan,
        density: np.ndarray,
        regions: Sequence[np.ndarray | None] = (),
        colour: np.ndarray | None = None,
    ) -> tuple[float, dict[str, float]]:
        """Loss of a scaled full-resolution density (D, H, W), and its unscaled terms, as means over three fixed views.

        They are the main view, and the views 0.8 of the way from it to either end of the range of azimuths.
        `regions` are the masks of the targets at full resolution, as for `gradient`, and `colour`, (D, H, W, 3) display
        values, is that of the smoke; None for grey smoke.
        """
        recipe = frame.recipe
        azimuth, elevation = sum(recipe.azimuth) / 2, sum(recipe.elevation) / 2
        reach = _JUDGED_REACH * (recipe.azimuth[1] - recipe.azimuth[0]) / 2
        views = [recipe.view(azimuth + across, elevation) for across in (-reach, 0.0, reach)]
        with torch.no_grad(), dr.suspend_grad():
            shape, h = self.octave.shape, self.octave.cell_size
            smoke = resample_density(mi.TensorXf(density), 1.0, shape, h)
            tint = None if colour is None else on_octave(colour, self.octave)
            images = self._rendered(smoke, views, frame, (recipe.seed,), tint).torch()
            masks = [None if mask is None else resample_mask(mi.TensorXf(mask), 1.0, shape, h) for mask in regions]
            found = [
                self._loss_of(frame, target).evaluate(images, guides)
                for target, guides in enumerate(self._guides(smoke, masks, views, frame))
            ]
        loss = _total([value for value, _ in found], frame.shares)
        terms = {
            self.term_name(i, name): value for i, (_, of_one) in enumerate(found) for name, value in of_one.items()
        }
        return float(loss) / len(views), {name: float(value) / len(views) for name, value in terms.items()}

    def _loss_of(self, frame: FramePlan, target: int) -> BoundObjective:
        loss = self.losses[target]
        return loss if frame.weights is None else loss.weighed(frame.weights[target])

    def _views(self, frame: FramePlan, seed: Sequence[int]) -> list[View]:
        recipe = frame.recipe
        angles = sample_views(recipe.views, recipe.azimuth, recipe.elevation, seed)
        return [recipe.view(float(azimuth), float(elevation)) for azimuth, elevation in angles]

    def _guides(
        self, density: mi.TensorXf, regions: Sequence[mi.TensorXf | None], views: Sequence[View], frame: FramePlan
    ) -> list[Guides]:
        """For each target, where its region is seen in the views of a density, and where its smoke is, if it asks."""
        masks = [mask for mask in regions if mask is not None]
        if not masks and not any(loss.of_smoke for loss in self.losses):
            return [UNGUIDED] * len(self.losses)
        octave, gamma = self.octave, frame.recipe.extinction
        renderer = EmissionAbsorptionRenderer(
            octave.shape, gamma, "exact", octave.cell_size, size=octave.size, pixel=octave.pixel
        )
        seen = seen_in_views(density, masks, views, renderer)
        opacity, shares = seen.opacity.torch(), iter(seen.shares)
        found = []
        for target, loss in enumerate(self.losses):
            everywhere = not regions or regions[target] is None
            share = None if everywhere else next(shares).torch()
            smoke = opacity if share is None else share * opacity
            found.append(Guides(None if share is None else Guide(share), Guide(smoke) if loss.of_smoke else None))
        return found

    def _rendered(
        self,
        density: mi.TensorXf,
        views: Sequence[View],
        frame: FramePlan,
        seed: Sequence[int],
        colour: mi.TensorXf | None,
    ) -> mi.TensorXf:
        """The images (V, H, W) of grey smoke, or (V, H, W, 3) of smoke of a colour, as the network sees them."""
        return self._unexposed(density, views, frame, seed, colour) * opaque(frame.exposure)

    def _unexposed(
        self,
        density: mi.TensorXf,
        views: Sequence[View],
        frame: FramePlan,
        seed: Sequence[int],
        colour: mi.TensorXf | None,
        known: mi.TensorXf | None = None,
    ) -> mi.TensorXf:
        """Those images before they are exposed; in colour, `known` are the same if they have been rendered already."""
        octave, recipe = self.octave, frame.recipe
        if colour is None:
            renderer = driving_renderer(recipe, octave.shape, octave.cell_size, size=octave.size, pixel=octave.pixel)
            return renderer.render(density, views, seed)
        coloured = colour_renderer(recipe, octave.shape, octave.cell_size, size=octave.size, pixel=octave.pixel)
        return coloured.render_colour(density, colour, views, known)


def problem_of(plan: Plan, octave: Level, network: GoogLeNet) -> OctaveProblem:
    """The problem of an octave, with all scales 1.

    Raises:
        InputError: the network lacks a layer, channel or class, or a picture cannot be used.
    """
    losses = tuple(
        objective.bind(network, *octave.size, record=True, sigma=plan.recipe.sigma == "loss")
        for objective in plan.objectives
    )
    return OctaveProblem(octave, losses)


def _total(values: Sequence[torch.Tensor], shares: Sequence[float]) -> torch.Tensor:
    """The sum of losses, each times the factor of the steps of its target."""
    if len(values) == 1:
        return values[0]
    return torch.stack([share * value for share, value in zip(shares, values, strict=True)]).sum()
