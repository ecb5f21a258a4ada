"""The order of many numbers along rows, several times as fast on a CPU as `torch.argsort`."""

from __future__ import annotations

import torch
from torch import Tensor


def order_of(values: Tensor) -> Tensor:
    """Like `values.argsort(dim=-1, stable=True)`: the indices (…, P) that sort rows (…, P) of numbers that are not NaN.

    Rows of float32 on a CPU become integers that hold the number above its index, which numpy sorts with vector
    instructions; no two are equal, so that there is one order on any CPU. -0 comes before 0 there, whatever their
    indices; elsewhere the two are equal numbers, of which the one with the lower index comes first.
    """
    if values.is_cuda or values.dtype != torch.float32:
        return values.argsort(dim=-1, stable=True)
    bits = values.contiguous().view(torch.int32)
    # The bits of floats order as integers, but those of negative ones the other way round.
    rising = bits ^ ((bits >> 31) & 0x7FFFFFFF)
    keys = (rising.long() << 32) | torch.arange(values.shape[-1])
    keys.numpy().sort(axis=-1)
    return keys & 0xFFFFFFFF
