"""The network: from the smoke that is seen to potentials, coarse to fine, with one block for all octaves.

Each octave halves the cells of the one before. The block sees the smoke of its octave, the λ by which potentials become
a velocity, and the potentials that the coarser octaves have found, and adds to these, as the iterations of an
optimisation do. It measures lengths in cells of the octave, so one block serves all of them, and a motif is drawn
coarsely before it gets its details.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

#: Sizes of what a block is given are multiples of this: it works on cells of twice and four times the size.
BLOCK_MULTIPLE = 4

#: How far away a cell can matter to a block's result, in cells of its octave: 2 for each of the four convolutions at
#: twice their size, 4 for each of the four at four times, and up to 3 for where a group of cells begins.
BLOCK_REACH = 28

#: Largest potential that a block adds, in cells of the octave times full-resolution cells per frame. As in an
#: optimisation, all octaves can move smoke equally far.
LARGEST = 4.0

#: What the network gives, in the order of its channels, and the channels of each.
FIELDS = {"phi": 1, "psi": 3}

#: All of these channels.
CHANNELS = sum(FIELDS.values())

#: What a block is given beside the potentials: the smoke, the same softened, and λ.
_GIVEN = 3

#: Cells on each side over which the smoke is softened, so that a block finds thick smoke without counting.
_SOFTENED = 2


@dataclass(frozen=True)
class Architecture:
    """What has to be known to build a network.

    Attributes:
        octaves: how many there are; the finest has the cells of the input.
        width: channels at half the resolution of an octave; twice as many at a quarter.
    """

    octaves: int
    width: int

    @property
    def multiple(self) -> int:
        """Sizes of what the network is given are multiples of this."""
        return BLOCK_MULTIPLE << (self.octaves - 1)


class Block(nn.Module):
    """What one octave adds to the potentials: (1, 3 + C, D, H, W) → (1, C, D, H, W).

    The channels are the smoke, the same softened, λ, and the potentials that there are, in units of what a block adds.
    It begins as 0: an untrained network leaves smoke as it is.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        # Eight cells become the channels of one: what a full grid costs is an eighth of it, and nothing is lost.
        self.first = _convolution(8 * (_GIVEN + CHANNELS), width)
        self.fine = _convolution(width, width)
        self.narrow = _convolution(width, 2 * width)
        self.coarse = nn.ModuleList([_convolution(2 * width, 2 * width) for _ in range(3)])
        self.joined = _convolution(3 * width, width)
        self.last = _convolution(width, 8 * CHANNELS)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(_bias(self.last))

    def forward(self, seen: Tensor) -> Tensor:
        """The change of the potentials; the sizes are multiples of `BLOCK_MULTIPLE`."""
        fine = functional.silu(self.first(_gathered(seen)))
        fine = fine + functional.silu(self.fine(fine))
        coarse = functional.silu(self.narrow(functional.avg_pool3d(fine, 2)))
        for convolution in self.coarse:
            coarse = coarse + functional.silu(convolution(coarse))
        wide = functional.interpolate(coarse, scale_factor=2.0, mode="nearest")
        joined = functional.silu(self.joined(torch.cat([fine, wide], dim=1)))
        # Unlike that of tanh, this bound never quite loses its derivative, so what is too large can be unlearned.
        return LARGEST * functional.softsign(_spread(self.last(joined)).float() / LARGEST)


class PotentialNetwork(nn.Module):
    """Smoke (1, 1, D, H, W) and λ (1,) → potentials (1, C, D, H, W) in squares of cells per frame.

    The smoke is its optical thickness, see `prediction.THICK`; the channels are those of `FIELDS`; the sizes are
    multiples of `architecture.multiple`.
    """

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        self.architecture = architecture
        self.block = Block(architecture.width)

    def forward(self, smoke: Tensor, lam: Tensor) -> Tensor:
        """The potentials of all octaves together."""
        return self.coarse_to_fine(smoke, lam, self.block)

    def coarse_to_fine(self, smoke: Tensor, lam: Tensor, block: Callable[[Tensor], Tensor]) -> Tensor:
        """`forward`, with something that does what the block does of an octave, such as in parts."""
        octaves = [smoke]
        for _ in range(self.architecture.octaves - 1):
            octaves.append(functional.avg_pool3d(octaves[-1], 2))
        potentials = block(self.seen(octaves[-1], lam, None))
        for finer in reversed(octaves[:-1]):
            known = self.carried(potentials)
            potentials = known + block(self.seen(finer, lam, known))
        return potentials

    @staticmethod
    def seen(smoke: Tensor, lam: Tensor, known: Tensor | None) -> Tensor:
        """What a block is given of an octave: its smoke, λ, and the potentials that there are, None for 0."""
        softened = functional.avg_pool3d(
            functional.pad(smoke, (_SOFTENED,) * 6, mode="replicate"), 2 * _SOFTENED + 1, stride=1
        )
        if known is None:
            known = smoke.new_zeros((1, CHANNELS, *smoke.shape[2:]))
        return torch.cat([smoke, softened, lam.to(smoke).expand(smoke.shape), known / LARGEST], dim=1)

    @staticmethod
    def carried(potentials: Tensor) -> Tensor:
        """Potentials of an octave on the grid of the next one, and in its unit: its cells have half the size."""
        return 2.0 * functional.interpolate(potentials, scale_factor=2.0, mode="trilinear", align_corners=False)


def _gathered(x: Tensor) -> Tensor:
    """(1, C, D, H, W) → (1, 8 C, D/2, H/2, W/2): the eight cells of each double cell as channels."""
    _, c, d, h, w = x.shape
    parts = x.reshape(1, c, d // 2, 2, h // 2, 2, w // 2, 2).permute(0, 1, 3, 5, 7, 2, 4, 6)
    return parts.reshape(1, 8 * c, d // 2, h // 2, w // 2)


def _spread(x: Tensor) -> Tensor:
    """(1, 8 C, D, H, W) → (1, C, 2 D, 2 H, 2 W), the inverse of `_gathered`."""
    _, c, d, h, w = x.shape
    parts = x.reshape(1, c // 8, 2, 2, 2, d, h, w).permute(0, 1, 5, 2, 6, 3, 7, 4)
    return parts.reshape(1, c // 8, 2 * d, 2 * h, 2 * w)


def _convolution(inputs: int, outputs: int) -> nn.Conv3d:
    return nn.Conv3d(inputs, outputs, 3, padding=1)


def _bias(convolution: nn.Conv3d) -> Tensor:
    assert convolution.bias is not None
    return convolution.bias
