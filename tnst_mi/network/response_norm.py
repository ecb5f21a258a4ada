"""Local response normalisation across channels, and its derivative (Krizhevsky et al. 2012, section 3.3)."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from tnst_mi.network.readers.network_weights import ResponseNorm


class LocalResponseNorm(nn.Module):
    """x · s^(−β) with s = bias + α Σ x² over neighbouring channels; x is (N, C, H, W).

    The sum over channels is a convolution with a banded matrix; torch's own function computes it by three-dimensional
    pooling and is several times slower.
    """

    def __init__(self, channels: int, constants: ResponseNorm) -> None:
        """For feature maps of `channels` channels."""
        super().__init__()
        index = torch.arange(channels)
        band = (index[:, None] - index[None, :]).abs() <= constants.depth_radius
        self.register_buffer("band", constants.alpha * band.float()[:, :, None, None], persistent=False)
        self.register_buffer("bias", torch.full((channels,), constants.bias), persistent=False)
        self.beta = constants.beta

    def forward(self, x: Tensor) -> Tensor:
        """The normalised feature maps."""
        return _Normalise.apply(x, self.band, self.bias, self.beta)


class _Normalise(torch.autograd.Function):
    """y = x · p with p = s^(−β) and s = bias + B x²; ∂y/∂xᵀ g = g · p − 2 β x · B(g · x · p / s); B is symmetric."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, band: Tensor, bias: Tensor, beta: float) -> Tensor:
        s = functional.conv2d(x * x, band, bias)
        ctx.save_for_backward(x, s, band)
        ctx.beta = beta
        return _negative_power(s, beta).mul_(x)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        x, s, band = ctx.saved_tensors
        scaled = _negative_power(s, ctx.beta).mul_(gradient)
        spread = functional.conv2d((scaled * x).div_(s), band).mul_(x)
        return scaled.sub_(spread, alpha=2 * ctx.beta), None, None, None


def _negative_power(s: Tensor, beta: float) -> Tensor:
    """s^(−β); for the usual β, square roots take a fraction of the time of a power."""
    if beta == 0.5:
        return s.rsqrt()
    if beta == 0.75:
        return s.sqrt().mul_(s).rsqrt_()
    return s.pow(-beta)
