"""What is thought of smoke before any picture is seen: that its extinction hardly differs from that around it.

The noise of pictures is taken to be normal with deviation ν, and the Laplacian of the extinction σ on the grid, the sum
of the differences to the six neighbours, with deviation s. The negative logarithm of the posterior is then, up to a
constant, for N pixels of all pictures and M cells,

    N / (2 ν²) · mean (pixel − picture)² + M / (2 s²) · mean (Δσ)²

so that beside a mean square difference of pixels the prior has the weight ν² M / (N s²): the more cells there are to a
pixel, the more it has to decide. s is a share of the extinction of the smoke itself, of its mean over the mass,
Σσ² / Σσ, so that nothing depends on units.
"""

from __future__ import annotations

import torch
from torch import Tensor

#: s as a share of the smoke's extinction. Where there is smoke, the root mean square of Δσ is 0.7 times that of σ on
#: soft balls, and 1.3 times on scenes/obstacle, at the full and at half the resolution: of both the lower one, since
#: pictures outweigh it where they show more.
_SHARE = 0.7

#: Keeps a grid without smoke from a division by 0.
_NOTHING = 1e-30


def roughness(extinction: Tensor, scale_free: bool = False) -> Tensor:
    """mean (Δσ)² / s², without a unit; outside, the grid (D, H, W) repeats its border.

    Its derivative takes s as given, which draws smoke a little thinner as a whole. Where nothing else says how thick
    smoke is, since its brightness is not known either, it has to be `scale_free`: that of s counts too, and the
    derivative along σ itself is 0. It is not so always, since it draws dense smoke denser, which is what pictures of
    opaque smoke tell least of.
    """
    σ = extinction
    padded = torch.nn.functional.pad(σ[None, None], (1,) * 6, mode="replicate")[0, 0]
    inner = slice(1, -1)
    neighbours = (
        padded[2:, inner, inner]
        + padded[:-2, inner, inner]
        + padded[inner, 2:, inner]
        + padded[inner, :-2, inner]
        + padded[inner, inner, 2:]
        + padded[inner, inner, :-2]
    )
    s = _SHARE * (σ * σ).sum() / σ.sum().clamp(min=_NOTHING)
    s = s if scale_free else s.detach()
    return ((neighbours - 6 * σ) ** 2).mean() / (s * s).clamp(min=_NOTHING)
