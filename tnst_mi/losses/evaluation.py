"""An objective with its targets: its value on images, its derivative, and the scales of its terms.

Views are independent of each other: they go through the network one by one or several at once.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from tnst_mi.errors import InputError
from tnst_mi.losses.guided import UNGUIDED, Guide, Guides
from tnst_mi.losses.images import PIXELS, as_rgb
from tnst_mi.losses.recorded import RecordedEvaluation
from tnst_mi.losses.scales import rms_scales
from tnst_mi.losses.sizes import Shrinking, by_size, coarser_features
from tnst_mi.network.googlenet import LAST_BLOCK, LOGITS, GoogLeNet

#: Limit in bytes of the feature maps that a GPU holds at once; a single view may exceed it. On an H100, nine views of
#: the paper's 200×300 pixels (2.1 GB) take 20 ms in one batch and 47 ms in batches of three: for small batches cuDNN
#: chooses slower algorithms, which also need more memory of their own (docs/gpu.md).
LARGEST_BATCH = 1 << 32

#: Number of pixels in a batch up to which its evaluation is recorded. A GPU takes longer for larger ones than the host
#: takes to launch them, and a recording keeps their memory.
LARGEST_RECORDED = 1 << 18

Features = Mapping[str, Tensor]


class BoundTerm(NamedTuple):
    """A term with its targets.

    Attributes:
        layers: those it reads, of images of other sizes by the names of `losses.sizes`.
        loss: that (N,) of each of N views, by their features and, if there is one, the guide of their positions.
        of_smoke: whether that guide is the smoke, where it is known, rather than the region.
        of_colour: whether the colours of the smoke alone follow it, and its density does not.
        in_colour: whether it is of a picture that has colours, which the network is to see of the smoke too.
        drawn: for a term that draws random numbers, the same with those of a seed; None for all others.
    """

    layers: tuple[str, ...]
    loss: Callable[[Features, Guide | None], Tensor]
    of_smoke: bool = False
    drawn: Callable[[Sequence[int]], BoundTerm] | None = None
    of_colour: bool = False
    in_colour: bool = False


class BoundObjective:
    """An objective with its targets for one image size: Σ_i weight_i L_i / scale_i, with L_i = Σ_views σ_view l_i.

    l_i is the loss of a term in one view. σ_view is 1, or the sum of the view's pixels (paper Eq. 2), which then takes
    part in the derivative.

    Immutable: `scaled`, `weighed` and `drawn` return new objectives, which share the network and the targets.

    Attributes:
        names: One per term, unique.
        scales: The divisor of each term by name, initially 1. Plain floats, so that a checkpoint can hold them.
    """

    def __init__(
        self,
        net: GoogLeNet,
        size: tuple[int, int],
        names: Sequence[str],
        weights: Sequence[float],
        terms: Sequence[BoundTerm],
        record: bool,
        sigma: bool,
    ) -> None:
        """Called by `Objective.bind`."""
        self.names = list(names)
        self.scales = dict.fromkeys(names, 1.0)
        self._net = net
        self._size = size
        self._sigma = sigma
        self._weights = dict(zip(names, weights, strict=True))
        self._terms = dict(zip(names, terms, strict=True))
        #: What `saved_bytes` has been found to be, once for all copies.
        self._measured: list[int] = []
        #: The recorded evaluation for each shape of images, likewise; None if none is to be recorded.
        self._recorded: dict[torch.Size, RecordedEvaluation] | None = {} if record else None
        self._layers = list(dict.fromkeys(layer for term in terms for layer in term.layers))
        self._smaller = {at: Shrinking(size, at, next(net.parameters())) for at in by_size(self._layers)[1]}

    def __call__(self, images: Tensor) -> Tensor:
        """Return Σ_i weight_i L_i / scale_i, a scalar that is differentiable with respect to the images.

        Args:
            images: (N, H, W) grey views in about [0, 1], of the objective's size, or coloured ones (N, H, W, 3).
        """
        return self.evaluate(images)[0]

    def evaluate(self, images: Tensor, guides: Guides = UNGUIDED) -> tuple[Tensor, dict[str, Tensor]]:
        """Like a call, but also return the raw values L_i by name, scalar tensors without gradient.

        With guides, the losses are those of a region, or of the smoke; of a view that does not show it, 0.
        """
        if tuple(images.shape[1:]) not in (self._size, (*self._size, 3)):
            raise ValueError(f"images of shape {tuple(images.shape)}: expected (N, {self._size[0]}, {self._size[1]})")
        if torch.is_grad_enabled() and images.requires_grad:
            terms: dict[str, Tensor] = {}
            return _ViewByView.apply(images, self, terms, guides), terms
        return self._forward(images, guides)

    def _forward(
        self, images: Tensor, guides: Guides, gradient: Tensor | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The weighted sum and the raw values of the terms; if `gradient` is given, the derivative is written to it."""
        totals: dict[str, Tensor] = {}
        for part in self._parts(images):
            shown = guides.of(part)
            if gradient is None:
                losses, _ = self._losses(images[part], False, shown)
            else:
                losses, gradient[part] = self._differentiated(images[part], shown)
            for name, loss in losses.items():
                totals[name] = totals.get(name, 0) + loss.detach()
        return self._sum(totals), totals

    def _differentiated(self, images: Tensor, guides: Guides) -> tuple[dict[str, Tensor], Tensor]:
        """The values of the terms, and the derivative of their weighted sum."""
        factors = [self._weights[name] / self.scales[name] for name in self.names]
        # A recording has no place for the weights of positions, which differ from call to call.
        if self._recorded is None or guides != UNGUIDED or not images.is_cuda or images.numel() > LARGEST_RECORDED:
            return self._evaluated(images, factors, guides)

        def evaluate(images: Tensor, factors: Tensor) -> tuple[Tensor, Tensor]:
            losses, gradient = self._evaluated(images, factors.unbind(), UNGUIDED)
            return torch.stack([losses[name].detach() for name in self.names]), gradient

        if images.shape not in self._recorded:
            # Batches of different size are evaluated one after the other, and share their memory.
            pool = next((recorded.pool for recorded in self._recorded.values()), None)
            self._recorded[images.shape] = RecordedEvaluation(evaluate, images, len(factors), pool)
        values, gradient = self._recorded[images.shape](images, factors)
        return dict(zip(self.names, values, strict=True)), gradient

    def _evaluated(
        self, images: Tensor, factors: Sequence[float | Tensor], guides: Guides
    ) -> tuple[dict[str, Tensor], Tensor]:
        losses, views = self._losses(images, True, guides)
        with torch.enable_grad():
            weighted = [factor * losses[name] for name, factor in zip(self.names, factors, strict=True)]
            total = torch.stack(weighted).sum()
        (gradient,) = torch.autograd.grad(total, views)
        return losses, gradient

    def _parts(self, images: Tensor) -> Iterator[slice]:
        """Slices of the views that go through the network together.

        On a CPU, one view at a time, whose feature maps fit the caches better. On a GPU, the fewest equal parts whose
        maps stay below `LARGEST_BATCH`. It depends on images and network alone: the same views give the same bits.
        """
        on_cpu = images.device.type == "cpu"
        at_once = 1 if on_cpu else views_at_once(len(images), self.saved_bytes)
        return (slice(first, first + at_once) for first in range(0, len(images), at_once))

    @property
    def saved_bytes(self) -> int:
        """Bytes that autograd saves for the backward pass of one view."""
        if not self._measured:
            self._measured.append(self._measure_saved_bytes())
        return self._measured[0]

    def _measure_saved_bytes(self) -> int:
        blocks: dict[int, int] = {}

        def record(tensor: Tensor) -> Tensor:
            block = tensor.untyped_storage()
            blocks[block.data_ptr()] = block.nbytes()
            # Not itself: what an operation saves of its own result would then hold the operation, for ever.
            return tensor.detach()

        weight = next(self._net.parameters())
        view = torch.zeros(1, *self._size, dtype=weight.dtype, device=weight.device)
        with torch.autograd.graph.saved_tensors_hooks(record, lambda tensor: tensor):
            kept = self._losses(view, True)
        for weight in self._net.parameters():
            blocks.pop(weight.untyped_storage().data_ptr(), None)
        del kept
        return sum(blocks.values())

    def _sum(self, losses: Mapping[str, Tensor]) -> Tensor:
        return torch.stack([(self._weights[name] / self.scales[name]) * loss for name, loss in losses.items()]).sum()

    def weighed(self, weights: Sequence[float]) -> BoundObjective:
        """A copy with other weights, in the order of `names`."""
        other = copy.copy(self)
        other._weights = dict(zip(self.names, weights, strict=True))
        return other

    def drawn(self, seed: Sequence[int]) -> BoundObjective:
        """A copy whose random terms are those of a seed, integers ≥ 0; itself if it has none."""
        drawn = {name: term.drawn(seed) for name, term in self._terms.items() if term.drawn is not None}
        if not drawn:
            return self
        other = copy.copy(self)
        other._terms = self._terms | drawn
        # A recording has no place for other numbers either.
        other._recorded = None
        return other

    def apart(self) -> tuple[BoundObjective | None, BoundObjective | None]:
        """What density and colours follow, and what the colours alone follow; None where nothing counts."""
        if not self.of_colour:
            return self, None
        colours = [name for name in self.names if self._terms[name].of_colour]
        others = [name for name in self.names if name not in colours]
        counts = [any(self._weights[name] for name in names) for names in (others, colours)]
        of_all = self._part(others) if counts[0] or (others and not counts[1]) else None
        return of_all, self._part(colours) if counts[1] or not others else None

    def _part(self, names: list[str]) -> BoundObjective:
        """A copy with some of the terms; recordings are those of a part then, since all together are not evaluated."""
        other = copy.copy(self)
        other.names, other._terms = names, {name: self._terms[name] for name in names}
        other._layers = list(dict.fromkeys(layer for term in other._terms.values() for layer in term.layers))
        if other._layers == [PIXELS]:
            # There is no network in it, whose many kernels are worth recording.
            other._recorded = None
        return other

    @property
    def of_colour(self) -> bool:
        """Whether there is a term that colours alone follow."""
        return any(term.of_colour for term in self._terms.values())

    @property
    def of_smoke(self) -> bool:
        """Whether a term takes statistics of the smoke, which then has to be among the guides."""
        return any(term.of_smoke for term in self._terms.values())

    def scaled(self, scales: Mapping[str, float]) -> BoundObjective:
        """A copy with scales from a checkpoint or from `rms_scales`; raises `InputError` if their terms differ."""
        if set(scales) != set(self.names):
            raise InputError(f"loss scales: they are for {sorted(scales)}, expected {sorted(self.names)}")
        other = copy.copy(self)
        other.scales = {name: float(scales[name]) for name in self.names}
        return other

    def gradient_square_sum(self, images: Tensor, guides: Guides = UNGUIDED) -> dict[str, tuple[float, int]]:
        """Return, by name, the sum of (∂L_i/∂pixel)² over all pixels of all views, and the number of pixels."""
        sums = dict.fromkeys(self.names, 0.0)
        for part in self._parts(images):
            losses, views = self._losses(images[part], True, guides.of(part))
            for name, loss in losses.items():
                # The last one need not keep what is saved for the others.
                (gradient,) = torch.autograd.grad(loss, views, retain_graph=name != self.names[-1])
                sums[name] += gradient.double().square().sum().item()
        return {name: (square_sum, images.numel()) for name, square_sum in sums.items()}

    def calibrated(self, images: Tensor) -> BoundObjective:
        """A copy in which each scale is the RMS of its term's image gradient over this batch."""
        return self.scaled(rms_scales([self.gradient_square_sum(images)]))

    def _losses(
        self, images: Tensor, differentiable: bool, guides: Guides = UNGUIDED
    ) -> tuple[dict[str, Tensor], Tensor]:
        """The values of the terms by name, and the leaf tensor of images to differentiate them with respect to."""
        images = images.detach().requires_grad_(differentiable)
        with torch.set_grad_enabled(differentiable):
            features = self._features(images, guides.region)
            by_view: dict[str, Tensor] = {}
            for name, term in self._terms.items():
                guide = guides.of_term(term.of_smoke)
                loss = term.loss(features, guide)
                by_view[name] = loss if guide is None else guide.seen * loss
            if self._sigma:
                # Of smoke in colour it is not differentiated: that would be lowered by blackening the colours.
                sigma = images.flatten(1).sum(1) if images.ndim == 3 else images.detach().mean(3).flatten(1).sum(1)
                by_view = {name: sigma * loss for name, loss in by_view.items()}
            return {name: loss.sum() for name, loss in by_view.items()}, images

    def _features(self, images: Tensor, guide: Guide | None) -> Features:
        """The features of the layers; of a region, the logits are those of the mean of its features alone."""
        layers, coarser = by_size(layer for layer in self._layers if layer != PIXELS)
        features: dict[str, Tensor] = {PIXELS: as_rgb(images)} if PIXELS in self._layers else {}
        if not layers:
            return features
        # Grey pictures say nothing of colours: a network finds some that excite it alike, and smoke would take them on.
        shown = as_rgb(images, any(term.in_colour for term in self._terms.values()))
        features |= coarser_features(self._net, shown, coarser, self._smaller)
        if guide is None or LOGITS not in layers:
            return features | self._net(shown, layers=layers)
        features |= self._net(shown, layers=[*layers, LAST_BLOCK])
        return features | {LOGITS: self._net.classifier(guide.mean(features[LAST_BLOCK]))}


class _ViewByView(torch.autograd.Function):
    """A bound objective that computes its derivative along with its value, so that no view's features are kept."""

    @staticmethod
    def forward(
        ctx: Any, images: Tensor, objective: BoundObjective, terms: dict[str, Tensor], guides: Guides
    ) -> Tensor:
        gradient = torch.empty_like(images)
        value, found = objective._forward(images, guides, gradient)
        terms.update(found)
        ctx.save_for_backward(gradient)
        return value

    @staticmethod
    def backward(ctx: Any, factor: Tensor) -> tuple[Tensor, None, None, None]:
        (gradient,) = ctx.saved_tensors
        return gradient * factor, None, None, None


def views_at_once(count: int, saved_bytes: float) -> int:
    """Batch size for `count` views on a GPU: the fewest equal parts that stay below `LARGEST_BATCH`."""
    fitting = max(1, int(LARGEST_BATCH // saved_bytes))
    return math.ceil(count / math.ceil(count / fitting))
