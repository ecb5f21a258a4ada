"""What differs between the published GoogLeNets and the shipped one; their layers are the same."""

from __future__ import annotations

from dataclasses import dataclass

from tnst_mi.network.readers.network_weights import ResponseNorm
from tnst_mi.network.shipped import PATTERNS


@dataclass(frozen=True)
class Flavour:
    """How a network preprocesses its image, and what it applies between the convolutions."""

    mean: tuple[float, float, float]
    """Subtracted from the image in 0 to 255, in the order R, G, B."""
    divisor: float
    """Divides the difference."""
    reversed_channels: bool
    """Whether the first convolution was trained on B, G, R."""
    same_padding: bool
    """Whether strided layers pad by TensorFlow's SAME rule instead of Caffe's."""
    response_norm: ResponseNorm | None
    last_pool: int
    """Window size of the pooling before inception_5a."""


FLAVOURS = {
    # Caffe divides alpha by the window's size, 5; `ResponseNorm` does not.
    "bvlc": Flavour((123.0, 117.0, 104.0), 1.0, True, False, ResponseNorm(2, 1.0, 1e-4 / 5, 0.75), 3),
    "inception5h": Flavour((117.0, 117.0, 117.0), 1.0, False, True, ResponseNorm(5, 2.0, 1e-4, 0.5), 3),
    # Its ImageNet statistics and transform_input=True together map 0..1 to −1..1.
    "torchvision": Flavour((127.5, 127.5, 127.5), 127.5, False, False, None, 2),
    PATTERNS: Flavour((117.0, 117.0, 117.0), 1.0, False, False, None, 3),
}
