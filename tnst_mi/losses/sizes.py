"""Features of an image at several sizes: all octaves in one loss (Galerne et al. 2024, SGSST).

The images of an octave, made smaller, show what those of the coarser octaves do. Features of an image of another size
than its own go by the names of their layers with that size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import torch
from torch import Tensor

Size = tuple[int, int]

#: Rows that a smaller image has at least: less is no larger than the motifs of a network.
SMALLEST = 24

_AT = " at "


def coarser_sizes(height: int, width: int, ratio: float, most: int) -> list[Size]:
    """The sizes of the coarser octaves of an image, from fine to coarse.

    Args:
        height, width: of the image in pixels.
        ratio: of the sizes of neighbouring octaves, above 1.
        most: number of sizes, at most; those below `SMALLEST` are left out.

    Example:
        >>> coarser_sizes(96, 64, 1.8, 2), coarser_sizes(53, 35, 1.8, 2)
        ([(53, 36), (30, 20)], [(29, 19)])
    """
    sizes = [(round(height / ratio**step), max(1, round(width / ratio**step))) for step in range(1, most + 1)]
    return [size for size in sizes if size[0] >= SMALLEST]


def layer_at(layer: str, size: Size | None) -> str:
    """The name of a layer's features of the image made as large as this; its own name for the image's own size."""
    return layer if size is None else f"{layer}{_AT}{size[0]}x{size[1]}"


def coarser_features(
    net: Callable[..., dict[str, Tensor]],
    images: Tensor,
    layers: Mapping[Size, Sequence[str]],
    shrink: Mapping[Size, Shrinking],
) -> dict[str, Tensor]:
    """The features of images (N, 3, H, W) at smaller sizes, by the names of `layer_at`."""
    found: dict[str, Tensor] = {}
    for size, names in layers.items():
        found |= {layer_at(name, size): value for name, value in net(shrink[size](images), layers=names).items()}
    return found


def by_size(names: Iterable[str]) -> tuple[list[str], dict[Size, list[str]]]:
    """Layers of the image's own size, and by another size that they see, of the names that `layer_at` has made.

    Example:
        >>> by_size(["conv2/3x3", layer_at("conv2/3x3", (53, 36))])
        (['conv2/3x3'], {(53, 36): ['conv2/3x3']})
    """
    own, others = list[str](), dict[Size, list[str]]()
    for name in names:
        layer, _, at = name.partition(_AT)
        if at:
            rows, columns = map(int, at.split("x"))
            others.setdefault((rows, columns), []).append(layer)
        else:
            own.append(layer)
    return own, others


class Shrinking:
    """Makes images smaller: each new pixel is the mean over its area.

    By two products of matrices, whose derivatives are products too, and the same bits in every run on a GPU.

    Args:
        size: of the images.
        smaller: that they get.
        like: a tensor of their type, on their device.
    """

    def __init__(self, size: Size, smaller: Size, like: Tensor) -> None:
        self._rows, self._columns = (_shares(*pair).to(like) for pair in zip(size, smaller, strict=True))

    def __call__(self, images: Tensor) -> Tensor:
        """Images (N, C, H, W), made smaller."""
        return self._rows @ images @ self._columns.T


def _shares(count: int, fewer: int) -> Tensor:
    """(fewer, count) float64: the share of each pixel of a row in those of a row of fewer; each sums to 1."""
    edges = torch.arange(count + 1, dtype=torch.float64) * fewer / count
    new = torch.arange(fewer, dtype=torch.float64)[:, None]
    return (torch.minimum(edges[1:], new + 1) - torch.maximum(edges[:-1], new)).clamp_min(0)
