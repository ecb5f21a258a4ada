"""Convolution of grey images as a product of patches and filters, with its derivative.

Libraries lack a fast convolution for one input channel, in particular for its derivative with respect to the image.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn import functional


class _GreyConvolution(torch.autograd.Function):
    """Image patches times filters; the backward pass sums the patches' derivatives where they overlap."""

    @staticmethod
    def forward(ctx: Any, images: Tensor, filters: Tensor, stride: int) -> Tensor:
        ctx.save_for_backward(filters)
        ctx.stride, ctx.size = stride, images.shape[2:]
        window = filters.shape[-1]
        patches = images[:, 0].unfold(1, window, stride).unfold(2, window, stride).flatten(3)
        return (patches @ filters.flatten(1).t()).permute(0, 3, 1, 2)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        (filters,) = ctx.saved_tensors
        window = filters.shape[-1]
        patches = filters.flatten(1).t() @ gradient.flatten(2)
        return functional.fold(patches, ctx.size, window, stride=ctx.stride), None, None


def grey_convolution(images: Tensor, filters: Tensor, stride: int) -> Tensor:
    """Convolve grey images without padding.

    Args:
        images: (N, 1, H, W), already padded.
        filters: (C, k, k), not differentiated.
        stride: distance between window positions in pixels.

    Returns:
        (N, C, h, w) in channels-last layout, differentiable with respect to the images.
    """
    return _GreyConvolution.apply(images, filters, stride)
