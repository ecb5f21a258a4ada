"""A frame of any size through the network: the box of its smoke, octave by octave, in blocks of bounded memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import mitsuba as mi
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from tnst_mi.fields.grid import Octave
from tnst_mi.optimisation.parameterisation import Fields, Parameterisation
from tnst_mi.optimisation.plan import FramePlan
from tnst_mi.realtime.potential_network import BLOCK_MULTIPLE, BLOCK_REACH, CHANNELS, FIELDS, PotentialNetwork

#: Optical thickness γ d h of a cell that counts as 1 to the network: that of smoke of density 1 in images as the paper
#: has them. What is seen depends on nothing else of γ and density, so whoever changes γ needs no other network.
THICK = 0.1

#: Cells with less than this density, in the run's unit, are not smoke.
_VISIBLE = 1e-3

#: Cells around the smoke within which potentials may differ from 0. Their edge is soft: curl and gradient of a jump
#: would be a wind along the sides of the box.
MARGIN = 12

#: A block has at most so many cells, with those around it that matter to it: about 1 GB in a network of width 32.
MOST_CELLS = 1 << 22


def network_box(density: np.ndarray, multiple: int) -> tuple[slice, slice, slice] | None:
    """The box of a frame's smoke and a margin.

    Args:
        density: (D, H, W), in the run's unit.
        multiple: of the cell at which it begins along each axis.

    Returns:
        The slices of its cells along z, y and x; None if there is no smoke.
    """
    visible = density > _VISIBLE
    if not visible.any():
        return None
    box = []
    for axis, cells in enumerate(density.shape):
        there = np.flatnonzero(visible.any(axis=tuple(other for other in range(3) if other != axis)))
        first, last = max(0, int(there[0]) - MARGIN), min(cells, int(there[-1]) + 1 + MARGIN)
        # Boxes of frames that follow each other begin at the same cells for a while: motifs then do not shift.
        first -= first % multiple
        box.append(slice(first, last))
    return box[0], box[1], box[2]


def edge_fade(shape: tuple[int, ...], box: tuple[slice, slice, slice]) -> np.ndarray:
    """A factor (d, h, w) for potentials in a box of a grid: 1 inside, falling to 0 towards sides within the grid."""
    fade = np.ones((), np.float32)
    for axis, (cells, part) in enumerate(zip(shape, box, strict=True)):
        along = np.arange(part.start, part.stop) + 0.5
        rise = np.ones_like(along)
        if part.start > 0:
            rise = np.minimum(rise, (along - part.start) / MARGIN)
        if part.stop < cells:
            rise = np.minimum(rise, (part.stop - along) / MARGIN)
        smooth = rise * rise * (3 - 2 * rise)
        fade = fade[..., None] * smooth.astype(np.float32) if axis else smooth.astype(np.float32)
    return fade


class Example:
    """The box of a frame's smoke as the network takes it, and the way of its result back onto the grid.

    Args:
        density: (D, H, W), in the run's unit.
        extinction: γ of a cell of this grid, per unit of density.
        lam: λ of the velocity that the potentials are for.
        network: that it is for.
    """

    def __init__(self, density: np.ndarray, extinction: float, lam: float, network: PotentialNetwork) -> None:
        multiple = network.architecture.multiple
        self._shape, self.box, self._multiple = density.shape, network_box(density, multiple), multiple
        device = next(network.parameters()).device
        if self.box is None:
            return
        thickness = density[self.box] * np.float32(extinction / THICK)
        inside = torch.from_numpy(np.ascontiguousarray(thickness, np.float32)).to(device)
        self._size = tuple(inside.shape)
        missing = [-cells % multiple for cells in self._size]
        self._lam = torch.tensor([lam], device=device)
        self._smoke = functional.pad(inside[None, None], (0, missing[2], 0, missing[1], 0, missing[0]))
        self._fade = torch.from_numpy(edge_fade(self._shape, self.box)).to(device)

    @property
    def groups(self) -> int:
        """Along its shortest side, the cells of the coarsest convolutions; 0 if there is no smoke."""
        return 0 if self.box is None else min(self._smoke.shape[2:]) // self._multiple

    def potentials(self, network: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
        """What the network gives for the box, on the grid: (D, H, W, C), 0 elsewhere; it can be differentiated."""
        assert self.box is not None
        potentials = network(self._smoke, self._lam)
        d, h, w = self._size
        inside = (potentials[0, :, :d, :h, :w] * self._fade).permute(1, 2, 3, 0)
        around = [(part.start, cells - part.stop) for part, cells in zip(self.box, self._shape, strict=True)]
        return functional.pad(inside, (0, 0, *around[2], *around[1], *around[0]))


@torch.no_grad()
def predicted(
    network: PotentialNetwork, density: np.ndarray, extinction: float, lam: float, most_cells: int = MOST_CELLS
) -> np.ndarray:
    """The potentials of smoke, (D, H, W, C) in squares of cells per frame.

    Args:
        network: that has learned a style.
        density: (D, H, W), in the run's unit, in which that of thick smoke is about 1.
        extinction: γ of a cell of this grid, per unit of density.
        lam: λ of the velocity that they are for.
        most_cells: that go through the network at a time; the result does not depend on it, but for rounding.
    """
    example = Example(density, extinction, lam, network)
    if example.box is None:
        return np.zeros((*density.shape, CHANNELS), np.float32)
    return example.potentials(lambda smoke, lam: _in_blocks(network, smoke, lam, most_cells)).cpu().numpy()


def predicted_fields(network: PotentialNetwork, frame: FramePlan, octave: Octave, density: mi.TensorXf) -> Fields:
    """The fields that a network gives for a frame, in squares of full-resolution cells per frame.

    Args:
        network: that has learned a style.
        frame: the plan of the frame.
        octave: the grid on which it sees the smoke.
        density: (D, H, W) on this grid, in the run's unit.
    """
    recipe, h = frame.recipe, octave.cell_size
    potentials = predicted(network, density.numpy(), recipe.extinction * h, recipe.lam, MOST_CELLS)
    return fields_of(potentials, frame.parameterisation, h)


def fields_of(potentials: np.ndarray, parameterisation: Parameterisation, h: float) -> Fields:
    """Potentials (D, H, W, C), in squares of the cells of their grid, as fields, in squares of full-resolution cells.

    Args:
        potentials: of a network.
        parameterisation: whose fields they become; those that it does not have are left out.
        h: the size of a cell in full-resolution cells.
    """
    return Fields(
        {
            name: mi.TensorXf(np.ascontiguousarray(potentials[..., part] * np.float32(h * h)))
            for name, part in channels_of(parameterisation).items()
        }
    )


def channels_of(parameterisation: Parameterisation) -> dict[str, int | slice]:
    """Where the fields of a parameterisation are among the channels of a network, by name."""
    places, first = {}, 0
    for name, count in FIELDS.items():
        if name in parameterisation.channels:
            places[name] = first if count == 1 else slice(first, first + count)
        first += count
    return places


def _in_blocks(network: PotentialNetwork, smoke: Tensor, lam: Tensor, most_cells: int) -> Tensor:
    """`network(smoke, lam)`, each octave in blocks of at most so many cells."""

    def in_parts(seen: Tensor) -> Tensor:
        shape = tuple(seen.shape[2:])
        found = seen.new_empty((1, CHANNELS, *shape))
        for part in _blocks(shape, most_cells):
            wider = tuple(
                slice(max(0, along.start - BLOCK_REACH), min(cells, along.stop + BLOCK_REACH))
                for along, cells in zip(part, shape, strict=True)
            )
            inner = tuple(
                slice(along.start - around.start, along.stop - around.start)
                for along, around in zip(part, wider, strict=True)
            )
            found[:, :, *part] = network.block(seen[:, :, *wider])[:, :, *inner]
        return found

    return network.coarse_to_fine(smoke, lam, in_parts)


def _blocks(shape: tuple[int, ...], most_cells: int) -> Iterator[tuple[slice, slice, slice]]:
    """Parts of a grid that have at most so many cells, with all around them that matter, but a few of their own.

    They begin at multiples of `BLOCK_MULTIPLE`, as the grid does.
    """
    if np.prod(shape) <= most_cells:
        yield tuple(slice(0, cells) for cells in shape)  # pyright: ignore[reportReturnType]
        return
    room = int(most_cells ** (1 / 3)) - 2 * BLOCK_REACH
    side = max(4 * BLOCK_MULTIPLE, room - room % BLOCK_MULTIPLE)
    starts = [range(0, cells, side) for cells in shape]
    for z in starts[0]:
        for y in starts[1]:
            for x in starts[2]:
                yield (
                    slice(z, min(z + side, shape[0])),
                    slice(y, min(y + side, shape[1])),
                    slice(x, min(x + side, shape[2])),
                )
