"""Transport along a flow, from its definition alone, in torch and float64: autograd differentiates it."""

from __future__ import annotations

import torch
from torch import Tensor

#: Ralston's third-order Runge–Kutta method: shares of the time step, and weights.
_NODES, _WEIGHTS = (0.0, 0.5, 0.75), (2 / 9, 3 / 9, 4 / 9)


def centres(shape: tuple[int, int, int]) -> Tensor:
    """The positions (x, y, z) of all cells, (D, H, W, 3)."""
    z, y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in shape), indexing="ij")
    return torch.stack([x, y, z], -1)


def corners(values: Tensor, position: Tensor, outside: str) -> tuple[Tensor, Tensor]:
    """The values (8, …, C) of the cells around positions (…, 3), and their trilinear weights (8, …, 1)."""
    last = torch.tensor(values.shape[2::-1]) - 1
    low = torch.floor(position.detach())
    found, weights = [], []
    for number in range(8):
        upper = torch.tensor([number & 1, number >> 1 & 1, number >> 2 & 1])
        cell = low.long() + upper
        x, y, z = torch.minimum(cell.clamp(min=0), last).unbind(-1)
        inside = ((cell >= 0) & (cell <= last)).all(-1, keepdim=True) | torch.tensor(outside == "edge")
        found.append(values[z, y, x] * inside)
        t = position - low
        weights.append(torch.where(upper.bool(), t, 1 - t).prod(-1, keepdim=True))
    return torch.stack(found), torch.stack(weights)


def interpolated(values: Tensor, position: Tensor, outside: str) -> Tensor:
    """Trilinear values (…, C)."""
    found, weights = corners(values, position, outside)
    return (found * weights).sum(0)


def divergence(u: Tensor) -> Tensor:
    """Central differences, one-sided at the ends, of a velocity (D, H, W, 3)."""
    return sum(torch.gradient(u[..., c], dim=2 - c)[0] for c in range(3) if u.shape[2 - c] > 1)


def traced(u: Tensor, stages: int, sign: int) -> tuple[Tensor, Tensor]:
    """The ends (D, H, W, 3) of all paths along ± u, and the integral of its divergence (D, H, W)."""
    rates = torch.cat([u, divergence(u)[..., None]], -1)
    position, volume, step = centres(u.shape[:3]), torch.zeros(u.shape[:3], dtype=torch.float64), sign / stages
    for _ in range(stages):
        rate, total = torch.zeros_like(rates), torch.zeros_like(rates)
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            rate = interpolated(rates, position + node * step * rate[..., :3], "edge")
            total = total + weight * rate
        position, volume = position + step * total[..., :3], volume + step * total[..., 3]
    return position, volume


def transported(
    d: Tensor,
    u: Tensor,
    stages: int,
    method: str = "maccormack",
    outside: str = "zero",
    conservative: bool = False,
    reverted: Tensor | None = None,
) -> Tensor:
    """The field (D, H, W, C) after one frame, with u in cells; `reverted` (D, H, W, C) fixes the limiter's choice."""
    departure, volume = traced(u, stages, -1)
    f = interpolated(d, departure, outside)
    result = f
    if method != "semi_lagrangian":
        result = f + (d - interpolated(f, traced(u, stages, 1)[0], outside)) / 2
    if method == "maccormack":
        around, _ = corners(d, departure, outside)
        if reverted is None:
            reverted = (result < around.amin(0)) | (result > around.amax(0))
        result = torch.where(reverted, f, result)
    return result * torch.exp(volume)[..., None] if conservative else result
