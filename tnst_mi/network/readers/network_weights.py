"""What every reader returns: GoogLeNet's tensors under their BVLC names, checked for consistency."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from tnst_mi.machine.terminal import quoted
from tnst_mi.network.shipped import PATTERNS

FLAVOUR_NAMES = ("bvlc", "inception5h", "torchvision", PATTERNS)
"""The published networks in order of preference, and the one that ships with the package."""

BLOCKS = tuple(f"inception_{name}" for name in ("3a", "3b", "4a", "4b", "4c", "4d", "4e", "5a", "5b"))
"""The inception blocks from the image to the classifier."""

BRANCH_LAYERS = ("1x1", "3x3_reduce", "3x3", "5x5_reduce", "5x5", "pool_proj")
"""The six convolutions of an inception block."""

CONCATENATED = ("1x1", "3x3", "5x5", "pool_proj")
"""The branch layers whose results are concatenated, in this order, into the output of the block."""

STEM = ("conv1/7x7_s2", "conv2/3x3_reduce", "conv2/3x3")
"""The three convolutions before the first block."""

CLASSIFIER = "loss3/classifier"
"""The fully connected layer after the last block."""

CONVOLUTIONS = (*STEM, *(f"{block}/{branch}" for block in BLOCKS for branch in BRANCH_LAYERS))
"""Every convolution, in the order of evaluation."""


def tensorflow_name(layer: str) -> str:
    """Name of a layer in the TensorFlow graph: `inception_4b/pool_proj` is `mixed4b_pool_reduce` there."""
    if layer in STEM:
        return f"conv2d{STEM.index(layer)}"
    if layer == CLASSIFIER:
        return "softmax2"
    block, branch = layer.removeprefix("inception_").split("/")
    branch = "pool_reduce" if branch == "pool_proj" else branch.replace("_reduce", "_bottleneck")
    return f"mixed{block}_{branch}"


class MalformedFile(ValueError):
    """A weights file violates its format or holds something else; `read_weights` adds the file's name."""


@dataclass(frozen=True)
class ResponseNorm:
    """Local response normalisation, y_c = x_c · (bias + alpha · Σ_{|i−c| ≤ depth_radius} x_i²)^(−beta)."""

    depth_radius: int
    bias: float
    alpha: float
    beta: float


@dataclass(frozen=True)
class NetworkWeights:
    """The contents of a weights file.

    `tensors` maps `<BVLC layer>.weight` (out, in, rows, columns) and `<BVLC layer>.bias` to float32 tensors;
    `response_norms` holds the two sets of constants, if the file itself states them; `class_names` is the file's own
    list, if it has one.
    """

    flavour: str
    tensors: dict[str, Tensor]
    response_norms: tuple[ResponseNorm, ResponseNorm] | None = None
    class_names: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        """Raise `MalformedFile` unless the tensors are exactly those of a GoogLeNet, consistent and finite."""
        expected = {f"{layer}.{kind}" for layer in (*CONVOLUTIONS, CLASSIFIER) for kind in ("weight", "bias")}
        require_names(self.tensors.keys(), expected)
        for layer, inputs, kernel in self._convolution_inputs():
            self._require_shape(layer, (self._width(layer), inputs, kernel, kernel))
        self._require_shape(CLASSIFIER, (self._width(CLASSIFIER), self.block_width(BLOCKS[-1])))
        for name, tensor in self.tensors.items():
            # The extremes of a tensor are finite only if all its values are: NaN propagates to both.
            if not all(math.isfinite(extreme) for extreme in torch.aminmax(tensor)):
                raise MalformedFile(f"tensor {quoted(name)} has values that are not finite")

    def block_width(self, block: str) -> int:
        """Channels of the block's output."""
        return sum(self._width(f"{block}/{branch}") for branch in CONCATENATED)

    def _width(self, layer: str) -> int:
        return self.tensors[f"{layer}.bias"].numel()

    def _convolution_inputs(self) -> Iterator[tuple[str, int, int]]:
        """Each convolution with its number of input channels and its kernel size."""
        channels = 3
        for layer, kernel in zip(STEM, (7, 1, 3), strict=True):
            yield layer, channels, kernel
            channels = self._width(layer)
        # torchvision's "5x5" branch was trained with 3x3 kernels (pytorch/vision issue 906).
        kernels = {"3x3": 3, "5x5": 3 if self.flavour == "torchvision" else 5}
        for block in BLOCKS:
            for branch, kernel in kernels.items():
                yield f"{block}/{branch}", self._width(f"{block}/{branch}_reduce"), kernel
            for branch in ("1x1", "3x3_reduce", "5x5_reduce", "pool_proj"):
                yield f"{block}/{branch}", channels, 1
            channels = self.block_width(block)

    def _require_shape(self, layer: str, expected: tuple[int, ...]) -> None:
        weight, bias = self.tensors[f"{layer}.weight"], self.tensors[f"{layer}.bias"]
        if tuple(weight.shape) != expected or tuple(bias.shape) != expected[:1] or expected[0] == 0:
            raise MalformedFile(
                f"weights of another network: {quoted(layer)} has weight {tuple(weight.shape)} and bias "
                f"{tuple(bias.shape)}, expected {expected} and {expected[:1]}"
            )


def require_names(found: Collection[str], expected: Collection[str]) -> None:
    """Raise `MalformedFile` unless the tensors' names are exactly the expected ones."""
    missing, unexpected = sorted(set(expected) - set(found)), sorted(set(found) - set(expected))
    if missing or unexpected:
        raise MalformedFile(
            "weights of another network: "
            + "; ".join(
                f"{len(names)} {what} tensor(s), such as {quoted(names[0])}"
                for what, names in (("missing", missing), ("unexpected", unexpected))
                if names
            )
        )
