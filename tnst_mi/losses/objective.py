"""Weighted sums of loss terms on GoogLeNet features: adding, scaling, and evaluating them.

The terms themselves are in `losses`. Every term is summed over the views of a batch; lower is better.
"""

from __future__ import annotations

import copy
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from numbers import Real
from typing import Any, NamedTuple

import torch
from torch import Tensor

from tnst_mi.errors import InputError
from tnst_mi.network.googlenet import GoogLeNet

#: A term whose gradient is smaller is not amplified beyond this: it is zero but for rounding.
SMALLEST_SCALE = 1e-12

#: Bytes of feature maps that a GPU keeps at once, unless those of one view are more. On an H100, nine views of the
#: paper's 200×300 pixels (2.1 GB) take 20 ms at once and 47 in threes: cuDNN's choices for small batches are worse,
#: and take more memory for themselves (docs/gpu.md).
LARGEST_BATCH = 1 << 32

Features = Mapping[str, Tensor]


class BoundTerm(NamedTuple):
    """A term with its targets: the layers it looks at, and its value, a scalar summed over the views."""

    layers: tuple[str, ...]
    loss: Callable[[Features], Tensor]


class Objective:
    """A weighted sum of terms. `a + b`, `2 * a` and `-a` make new objectives."""

    def __init__(self, weighted_terms: Iterable[tuple[float, Term]]) -> None:
        """Sum these (weight, term) pairs; raises `InputError` where there are none."""
        self._weighted_terms = tuple(weighted_terms)
        if not self._weighted_terms:
            raise InputError("objective: there is no term; give a style, semantic, tag or content target")

    @property
    def weighted_terms(self) -> tuple[tuple[float, Term], ...]:
        """The (weight, term) pairs, in the order they were added."""
        return self._weighted_terms

    def __add__(self, other: Objective) -> Objective:
        """Both sums in one."""
        if not isinstance(other, Objective):
            return NotImplemented
        return Objective(self.weighted_terms + other.weighted_terms)

    def __mul__(self, factor: float) -> Objective:
        """The same terms with every weight multiplied."""
        if not isinstance(factor, Real):
            return NotImplemented
        return Objective((float(factor) * weight, term) for weight, term in self.weighted_terms)

    __rmul__ = __mul__

    def __neg__(self) -> Objective:
        """The opposite aim."""
        return -1.0 * self

    @property
    def names(self) -> list[str]:
        """A readable name of each term; the second and later of equal ones are numbered."""
        seen: Counter[str] = Counter()
        names = []
        for _, term in self.weighted_terms:
            seen[term.name] += 1
            names.append(term.name if seen[term.name] == 1 else f"{term.name} #{seen[term.name]}")
        return names

    def bind(self, net: GoogLeNet, height: int, width: int) -> BoundObjective:
        """Compute the targets for images of height x width pixels, without gradients.

        Raises:
            InputError: A layer, channel or class tag that the network lacks.
        """
        with torch.no_grad():
            terms = [term.bind_term(net, height, width) for _, term in self.weighted_terms]
        weights = [weight for weight, _ in self.weighted_terms]
        return BoundObjective(net, (height, width), self.names, weights, terms)


class Term(Objective):
    """One loss; by itself it is the objective of weight 1."""

    @property
    def weighted_terms(self) -> tuple[tuple[float, Term], ...]:
        """Itself, with weight 1."""
        return ((1.0, self),)

    @property
    def name(self) -> str:
        """What logs call it."""
        raise NotImplementedError

    def bind_term(self, net: GoogLeNet, height: int, width: int) -> BoundTerm:
        """Compute the targets for images of height x width pixels."""
        raise NotImplementedError


class BoundObjective:
    """An objective with its targets for one image size: Σ_i weight_i L_i / scale_i.

    It does not change: `scaled` and `weighed` make others, which share the network and the targets.

    Attributes:
        names: One per term, unique.
        scales: By name: what each term is divided by, 1 as it comes. Plain floats, fit for a checkpoint.
    """

    def __init__(
        self,
        net: GoogLeNet,
        size: tuple[int, int],
        names: Sequence[str],
        weights: Sequence[float],
        terms: Sequence[BoundTerm],
    ) -> None:
        """Made by `Objective.bind`."""
        self.names = list(names)
        self.scales = dict.fromkeys(names, 1.0)
        self._net = net
        self._size = size
        self._weights = dict(zip(names, weights, strict=True))
        self._terms = dict(zip(names, terms, strict=True))
        self._layers = list(dict.fromkeys(layer for term in terms for layer in term.layers))

    def __call__(self, images: Tensor) -> Tensor:
        """Return Σ_i weight_i L_i / scale_i, a scalar that is differentiable with respect to the images.

        Args:
            images: (N, H, W) grey views in about [0, 1], of the size that the objective was bound to.
        """
        return self.evaluate(images)[0]

    def evaluate(self, images: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """As a call, with the raw values L_i by name, scalar tensors without gradient."""
        if images.ndim != 3 or tuple(images.shape[1:]) != self._size:
            raise ValueError(f"images of shape {tuple(images.shape)}: expected (N, {self._size[0]}, {self._size[1]})")
        if torch.is_grad_enabled() and images.requires_grad:
            terms: dict[str, Tensor] = {}
            return _ViewByView.apply(images, self, terms), terms
        return self._forward(images)

    def _forward(self, images: Tensor, gradient: Tensor | None = None) -> tuple[Tensor, dict[str, Tensor]]:
        """The weighted sum and the raw values of the terms; where `gradient` is given, the derivative goes there."""
        totals: dict[str, Tensor] = {}
        for part in self._parts(images):
            losses, views = self._losses(images[part], gradient is not None)
            for name, loss in losses.items():
                totals[name] = totals.get(name, 0) + loss.detach()
            if gradient is not None:
                with torch.enable_grad():
                    weighted = self._sum(losses)
                (gradient[part],) = torch.autograd.grad(weighted, views)
        return self._sum(totals), totals

    def _parts(self, images: Tensor) -> Iterator[slice]:
        """Which views the network sees at once.

        On a CPU one by one: the feature maps of one fit its caches better, and take up no more memory than they must.
        On a GPU in equal parts whose feature maps stay below `LARGEST_BATCH`, which depends on nothing but the images
        and the network: the same views give the same bits.
        """
        on_cpu = images.device.type == "cpu"
        at_once = 1 if on_cpu else views_at_once(len(images), self.saved_bytes)
        return (slice(first, first + at_once) for first in range(0, len(images), at_once))

    @cached_property
    def saved_bytes(self) -> int:
        """Bytes that autograd keeps of the evaluation of one view, until its derivative is found."""
        blocks: dict[int, int] = {}

        def record(tensor: Tensor) -> Tensor:
            block = tensor.untyped_storage()
            blocks[block.data_ptr()] = block.nbytes()
            return tensor

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
        """The same with other weights, in the order of `names`."""
        other = copy.copy(self)
        other._weights = dict(zip(self.names, weights, strict=True))
        return other

    def scaled(self, scales: Mapping[str, float]) -> BoundObjective:
        """The same with the scales of a checkpoint or of `rms_scales`; raises `InputError` if for other terms."""
        if set(scales) != set(self.names):
            raise InputError(f"loss scales: they are for {sorted(scales)}, expected {sorted(self.names)}")
        other = copy.copy(self)
        other.scales = {name: float(scales[name]) for name in self.names}
        return other

    def gradient_square_sum(self, images: Tensor) -> dict[str, tuple[float, int]]:
        """Return, by name, the sum of (∂L_i/∂pixel)² over all pixels of all views, and their number."""
        sums = dict.fromkeys(self.names, 0.0)
        for part in self._parts(images):
            losses, views = self._losses(images[part], True)
            for name, loss in losses.items():
                (gradient,) = torch.autograd.grad(loss, views, retain_graph=True)
                sums[name] += gradient.double().square().sum().item()
        return {name: (square_sum, images.numel()) for name, square_sum in sums.items()}

    def calibrated(self, images: Tensor) -> BoundObjective:
        """The same with every scale the RMS of its term's image gradient over this one batch."""
        return self.scaled(rms_scales([self.gradient_square_sum(images)]))

    def _losses(self, images: Tensor, differentiable: bool) -> tuple[dict[str, Tensor], Tensor]:
        """The terms by name, and the images that they can be differentiated with respect to."""
        images = images.detach().requires_grad_(differentiable)
        with torch.set_grad_enabled(differentiable):
            features = self._net(as_rgb(images), layers=self._layers)
            return {name: term.loss(features) for name, term in self._terms.items()}, images


class _ViewByView(torch.autograd.Function):
    """A bound objective whose derivative is found together with its value, so that no view's features are kept."""

    @staticmethod
    def forward(ctx: Any, images: Tensor, objective: BoundObjective, terms: dict[str, Tensor]) -> Tensor:
        gradient = torch.empty_like(images)
        value, found = objective._forward(images, gradient)
        terms.update(found)
        ctx.save_for_backward(gradient)
        return value

    @staticmethod
    def backward(ctx: Any, factor: Tensor) -> tuple[Tensor, None, None]:
        (gradient,) = ctx.saved_tensors
        return gradient * factor, None, None


def views_at_once(count: int, saved_bytes: float) -> int:
    """How many of `count` views a network on a GPU sees at once: the fewest equal parts below `LARGEST_BATCH`."""
    fitting = max(1, int(LARGEST_BATCH // saved_bytes))
    return math.ceil(count / math.ceil(count / fitting))


def rms_scales(sums: Iterable[Mapping[str, tuple[float, int]]]) -> dict[str, float]:
    """Pool what `gradient_square_sum` gave, e.g. for all frames: RMS by name, at least `SMALLEST_SCALE`."""
    squares: defaultdict[str, float] = defaultdict(float)
    counts: Counter[str] = Counter()
    for batch in sums:
        for name, (square_sum, count) in batch.items():
            squares[name] += square_sum
            counts[name] += count
    return {name: max(math.sqrt(squares[name] / counts[name]), SMALLEST_SCALE) for name in counts}


def as_rgb(images: Tensor) -> Tensor:
    """Turn (N, H, W) grey into (N, 3, H, W) without copying."""
    return images[:, None].expand(-1, 3, -1, -1)
