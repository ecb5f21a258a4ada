"""GoogLeNet (Szegedy et al. 2015, Going Deeper with Convolutions): one torch module for all its weights.

A `Flavour` describes what differs between them; the layers are the same. Layers have their BVLC names
(`inception_4b/pool_proj`); those of the TensorFlow graph (`mixed4b_pool_reduce_pre_relu`) are aliases.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from tnst_mi.errors import InputError
from tnst_mi.network.class_names import class_index, class_names, imagenet_names, matching_classes
from tnst_mi.network.download import file_hash
from tnst_mi.network.flavours import FLAVOURS
from tnst_mi.network.grey_convolution import grey_convolution
from tnst_mi.network.readers import CLASS_LIST, read_weights
from tnst_mi.network.readers.network_weights import (
    BLOCKS,
    BRANCH_LAYERS,
    CLASSIFIER,
    CONCATENATED,
    CONVOLUTIONS,
    STEM,
    NetworkWeights,
    tensorflow_name,
)
from tnst_mi.network.response_norm import LocalResponseNorm
from tnst_mi.network.shipped import DOWNLOAD_COMMAND, PATTERNS
from tnst_mi.network.weights import announce_fallback, find_weights

LOGITS, LAST_BLOCK = "logits", f"{BLOCKS[-1]}/output"
"""The last layer, and the one whose mean over all positions it classifies."""

LAYERS = (
    *STEM,
    *(f"{block}/{layer}" for block in BLOCKS for layer in (*BRANCH_LAYERS, "output")),
    LOGITS,
)
"""The layers that can be requested, in the order of evaluation."""

ALIASES = {
    CLASSIFIER: LOGITS,
    "softmax2_pre_activation": LOGITS,
    **{tensorflow_name(layer): layer for layer in STEM},
    **{f"{tensorflow_name(layer)}_pre_relu": layer for layer in CONVOLUTIONS if layer not in STEM},
    **{block.replace("inception_", "mixed"): f"{block}/output" for block in BLOCKS},
}
"""Other names of layers, mostly from the TensorFlow graph. Each refers to exactly the same values."""

_POOLED = ("inception_3a", "inception_4a", "inception_5a")
"""The blocks with a stride-2 pooling before them."""


class GoogLeNet(nn.Module):
    """GoogLeNet with fixed weights: images to features, differentiable with respect to the images.

    Attributes: `flavour`; `layer_names`; `class_names` (empty if the weights come without a list); `source` and
    `sha256`, path and hash of the weights file.
    """

    mean: Tensor
    norm1: nn.Module
    norm2: nn.Module

    def __init__(self, weights: NetworkWeights, stride1: bool = True) -> None:
        """Build the network from its weights; `stride1` lowers the first convolution's stride from 2 to 1.

        Stride 1 is the paper's remedy for checkerboard artefacts; it doubles the resolution of every later layer.
        """
        super().__init__()
        description = FLAVOURS[weights.flavour]
        self.flavour = weights.flavour
        self.source = ""
        self.sha256 = ""
        self.class_names = class_names(weights)
        self.layer_names = list(LAYERS)
        self._description = description
        #: The first convolution's response to a black image, cached for the most recent image size.
        self._black: dict[tuple, Tensor] = {}
        self.convolutions = nn.ModuleDict({layer: _convolution(weights, layer) for layer in CONVOLUTIONS})
        stem = self._convolution(STEM[0])
        stem.stride = (1, 1) if stride1 else (2, 2)
        if description.reversed_channels:
            stem.weight = nn.Parameter(stem.weight.flip(1))
        classes, features = weights.tensors[f"{CLASSIFIER}.weight"].shape
        self.classifier = nn.Linear(features, classes, device="meta")
        _set_parameters(self.classifier, weights, CLASSIFIER)
        constants = weights.response_norms or (description.response_norm,) * 2
        for name, layer, norm in zip(("norm1", "norm2"), (STEM[0], STEM[2]), constants, strict=True):
            channels = self._convolution(layer).out_channels
            self.add_module(name, nn.Identity() if norm is None else LocalResponseNorm(channels, norm))
        self.register_buffer("mean", torch.tensor(description.mean).reshape(1, 3, 1, 1), persistent=False)
        # In channels-last layout the convolutions take a quarter less time on a CPU.
        # torch's annotations of `to` omit the memory format.
        self.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        self.requires_grad_(False).eval()

    @classmethod
    def load(cls, source: str | Path | None = None, flavour: str | None = None, stride1: bool = True) -> GoogLeNet:
        """Load a weights file, in evaluation mode and float32, with frozen weights.

        Args:
            source: a file, a folder, or "patterns", the network that ships with the package. If None, the places
                that `tnst-mi weights` lists are searched; if only "patterns" is found, a line on stderr says so once.
            flavour: "bvlc", "inception5h", "torchvision" or "patterns", to require that one.
            stride1: use stride 1 instead of 2 in the first convolution, the paper's remedy for checkerboard artefacts;
                it doubles the resolution of every later layer.

        Returns:
            A module that maps images (N, 3, H, W), RGB in 0 to 1, and layer names to {name: features (N, C, h, w)}.

        Raises:
            InputError: no such weights are found, or the file is damaged or holds another network.

        Example:
            >>> import torch
            >>> import tnst_mi
            >>> network = tnst_mi.GoogLeNet.load("patterns")
            >>> features = network(torch.rand(2, 3, 32, 48), layers=["conv2/3x3", "inception_4b/output"])
            >>> [tuple(values.shape) for values in features.values()]
            [(2, 192, 16, 24), (2, 512, 4, 6)]
            >>> network.channels("inception_4b/output")
            512
        """
        path, _, fallback = find_weights(source, flavour)
        if fallback:
            announce_fallback()
        return cls.from_file(path, stride1)

    @classmethod
    def from_file(cls, path: Path, stride1: bool = True) -> GoogLeNet:
        """Load exactly this file, as in `load`."""
        network = cls(read_weights(path), stride1)
        network.source = str(path)
        network.sha256 = file_hash(path, "sha256")
        return network

    def forward(self, x: Tensor, layers: Sequence[str]) -> dict[str, Tensor]:
        """Values of `layers` for the images `x` (N, 3, H, W), RGB in 0 to 1, of any size.

        The result maps the names as given to values (N, C, h, w), or (N, classes) for `logits`. Branch layers are taken
        before their ReLU, `…/output` and the three stem convolutions after it. Only what these layers depend on is
        evaluated. The memory layout is channels-last: use `flatten`, not `view`. Raises `InputError` for an unknown
        layer or a wrong shape of `x`.
        """
        if x.ndim != 4 or x.shape[1] != 3 or 0 in x.shape or not x.is_floating_point():
            raise InputError(f"images of shape {tuple(x.shape)}, {x.dtype}: expected floating point (N, 3, H, W)")
        names = {layer: self.resolve(layer) for layer in layers}
        known = {"image": x}
        return {layer: self._value(name, known) for layer, name in names.items()}

    def resolve(self, layer: str) -> str:
        """The BVLC name of a layer; an unknown one raises `InputError`, which names the nearest three."""
        name = ALIASES.get(layer, layer)
        if name not in LAYERS:
            nearest = difflib.get_close_matches(layer, (*LAYERS, *ALIASES), n=3, cutoff=0.0)
            raise InputError(f"layer {layer!r}: unknown; the nearest are {', '.join(nearest)}")
        return name

    def channels(self, layer: str) -> int:
        """Number of channels of a layer; raises `InputError` for an unknown one."""
        name = self.resolve(layer)
        if name == LOGITS:
            return self.classifier.out_features
        if name in self.convolutions:
            return self._convolution(name).out_channels
        block = name.removesuffix("/output")
        return sum(self._convolution(f"{block}/{branch}").out_channels for branch in CONCATENATED)

    def check_channels(self, layer: str, channels: Sequence[int]) -> None:
        """Raise `InputError` unless the layer exists and has all these channels (counted from 0)."""
        last = self.channels(layer) - 1
        for channel in channels:
            if not 0 <= channel <= last:
                raise InputError(f"channel {channel} of layer {layer!r}: expected 0 to {last}")

    def class_index(self, tag: str) -> int:
        """The entry of `logits` for a class name, as in `class_names.class_index`; raises `InputError`."""
        if not self.class_names:
            raise InputError(
                f"class tag {tag!r}: {self.source or self.flavour} comes without class names; "
                f"put its {CLASS_LIST} beside it or choose a channel of 'logits'"
            )
        try:
            return class_index(self.class_names, tag)
        except InputError as error:
            unknown = not matching_classes(self.class_names, tag)
            if not (unknown and self.flavour == PATTERNS and matching_classes(imagenet_names(), tag)):
                raise
            raise InputError(
                f"{error} of the network {PATTERNS}; it is an ImageNet class: "
                f"`{DOWNLOAD_COMMAND}` gets a network that knows those"
            ) from None

    def _convolution(self, layer: str) -> nn.Conv2d:
        return cast("nn.Conv2d", self.convolutions[layer])

    def _value(self, name: str, known: dict[str, Tensor]) -> Tensor:
        """The value of a layer, computed at most once: `known` caches the values."""
        if name not in known:
            known[name] = self._evaluate(name, known)
        return known[name]

    def _evaluate(self, name: str, known: dict[str, Tensor]) -> Tensor:
        """Evaluate a single layer from the layers it depends on."""
        if name == STEM[0]:
            return F.relu(self._first_convolution(known["image"]))
        if name == STEM[1]:
            return F.relu(self.convolutions[name](self.norm1(self._pool(self._value(STEM[0], known)))))
        if name == STEM[2]:
            return F.relu(self.convolutions[name](self._value(STEM[1], known)))
        if name == LOGITS:
            # At 224x224 the mean over all positions is Caffe's 7x7 average; it works for images of any size.
            return self.classifier(self._value(LAST_BLOCK, known).mean((2, 3)))
        block, layer = name.split("/")
        if layer == "input":
            return self._block_input(block, known)
        if layer == "output":
            branches = [self._value(f"{block}/{branch}", known) for branch in CONCATENATED]
            return F.relu(torch.cat(branches, dim=1))
        if layer in ("3x3", "5x5"):
            return self.convolutions[name](F.relu(self._value(f"{name}_reduce", known)))
        values = self._value(f"{block}/input", known)
        if layer == "pool_proj":
            values = F.max_pool2d(values, kernel_size=3, stride=1, padding=1)
        return self.convolutions[name](values)

    def _block_input(self, block: str, known: dict[str, Tensor]) -> Tensor:
        """The input of a block: the output of the block or stem before it, pooled for some blocks."""
        if block == BLOCKS[0]:
            return self._pool(self.norm2(self._value(STEM[2], known)))
        values = self._value(f"{BLOCKS[BLOCKS.index(block) - 1]}/output", known)
        if block not in _POOLED:
            return values
        return self._pool(values, self._description.last_pool if block == _POOLED[-1] else 3)

    def _first_convolution(self, x: Tensor) -> Tensor:
        """The first convolution of images in 0 to 1; grey ones (channels that share memory) need only one filter."""
        if x.stride(1) == 0:
            return self._convolved_grey(x[:, :1])
        image = (x * 255 - self.mean) / self._description.divisor
        return self._convolved(image.contiguous(memory_format=torch.channels_last))

    def _convolved(self, image: Tensor) -> Tensor:
        convolution = self._convolution(STEM[0])
        if not self._description.same_padding:
            return convolution(image)
        image = F.pad(image, self._stem_padding(image))
        return F.conv2d(image, convolution.weight, convolution.bias, convolution.stride)

    def _convolved_grey(self, grey: Tensor) -> Tensor:
        """The same for images whose channels all equal `grey` (N, 1, H, W).

        The filters of the three channels sum to a single filter. The contribution of the means, absent from the padding
        at the border, is the same for all images of one size: the convolution of a black image.
        """
        convolution = self._convolution(STEM[0])
        key = (*grey.shape[2:], grey.dtype, grey.device)
        if key not in self._black:
            black = (-self.mean / self._description.divisor).expand(1, -1, *grey.shape[2:])
            self._black = {key: self._convolved(black.contiguous(memory_format=torch.channels_last))}
        filters = convolution.weight.sum(1) * (255 / self._description.divisor)
        padded = F.pad(grey, self._stem_padding(grey))
        return grey_convolution(padded, filters, convolution.stride[0]) + self._black[key]

    def _stem_padding(self, image: Tensor) -> tuple[int, int, int, int]:
        """Padding of the first convolution: columns before and after, then rows before and after."""
        if not self._description.same_padding:
            return (3, 3, 3, 3)
        stride = self._convolution(STEM[0]).stride[0]
        rows, columns = (_same_padding(size, 7, stride) for size in image.shape[2:])
        return (*columns, *rows)

    def _pool(self, values: Tensor, window: int = 3) -> Tensor:
        """Max pooling at stride 2; the last window may extend past the end (`ceil_mode`), as in Caffe.

        With padding before the first cell, this is TensorFlow's SAME rule too. A single cell, too small for Caffe and
        torch, is its own maximum.
        """
        padding = [
            _same_padding(size, window, 2)[0] if self._description.same_padding else int(size == 1)
            for size in values.shape[2:]
        ]
        return F.max_pool2d(values, window, stride=2, padding=padding, ceil_mode=True)


def _same_padding(size: int, window: int, stride: int) -> tuple[int, int]:
    """Cells that TensorFlow's SAME rule adds before and after an axis of `size` cells."""
    outputs = -(-size // stride)
    total = max((outputs - 1) * stride + window - size, 0)
    return total // 2, total - total // 2


def _convolution(weights: NetworkWeights, layer: str) -> nn.Conv2d:
    outputs, inputs, kernel, _ = weights.tensors[f"{layer}.weight"].shape
    # On the meta device torch neither allocates nor initialises weights, which would be replaced at once.
    convolution = nn.Conv2d(inputs, outputs, kernel, padding=kernel // 2, device="meta")
    _set_parameters(convolution, weights, layer)
    return convolution


def _set_parameters(module: nn.Conv2d | nn.Linear, weights: NetworkWeights, layer: str) -> None:
    module.weight = nn.Parameter(weights.tensors[f"{layer}.weight"])
    module.bias = nn.Parameter(weights.tensors[f"{layer}.bias"])
