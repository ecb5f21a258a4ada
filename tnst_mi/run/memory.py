"""What a run needs of memory, so that it is said before it starts, and refused where it cannot fit."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch

from tnst_mi.errors import InputError
from tnst_mi.losses.objective import views_at_once
from tnst_mi.machine import environment
from tnst_mi.machine.backend import torch_device
from tnst_mi.recipe.recipe import Recipe

# Measured with `stylize` at 128×192×128 and 200×300×200 cells (docs/performance.md): the largest resident size, less
# what the network takes up, is a line over the cells for each parameterisation.

#: Bytes of a process that has loaded Mitsuba, Dr.Jit, LLVM, torch and a GoogLeNet, and compiled its kernels.
PROCESS = 450_000_000

#: Bytes by cell of the finest grid: density, mask, images' derivatives, transport and result; more for each component.
_TRANSPORT_CELL, _TRANSPORT_COMPONENT, _DENSITY_CELL = 55, 27, 55

#: Bytes by cell, and by component, that a window adds: velocity, gain, sums, and an item that is read ahead.
_WINDOW_CELL, _WINDOW_COMPONENT = 50, 16

#: The network's evaluation takes more than what autograd keeps of it: gradients, and a convolution's columns by pixel.
_NETWORK_FACTOR, _NETWORK_PIXEL = 1.2, 1000


@dataclass(frozen=True)
class Need:
    """The most memory that a run takes, in bytes.

    Attributes:
        shape: (D, H, W) of the finest grid.
        by_cell: of the grids, for each cell; of the state of all frames too, where that is not on disk.
        by_pixel: of the network, for each pixel of an image, for all views that it sees at once.
    """

    shape: tuple[int, int, int]
    by_cell: float
    by_pixel: float

    @property
    def total(self) -> int:
        """All of it, the process included."""
        depth, height, width = self.shape
        return PROCESS + int(height * width * (self.by_cell * depth + self.by_pixel))

    def largest_that_fits(self, free: int) -> tuple[int, int, int] | None:
        """The largest grid (D, H, W) of these proportions that needs no more than `free` bytes; None if none does."""
        depth, height, width = self.shape
        for rows in range(height, 0, -1):
            shape = (max(1, depth * rows // height), rows, max(1, width * rows // height))
            if replace(self, shape=shape).total <= free:
                return shape
        return None


def needed(shape: tuple[int, int, int], recipe: Recipe, count: int, saved: float, on_disk: bool) -> Need:
    """What a run needs where the active variant computes.

    Args:
        shape: (D, H, W) of the frames.
        recipe: of the run.
        count: number of frames.
        saved: bytes that autograd keeps of the network's evaluation, for each pixel of one view.
        on_disk: whether the state of the frames is on disk.
    """
    components = recipe.components
    by_cell = _TRANSPORT_CELL + _TRANSPORT_COMPONENT * components
    if recipe.parameterisation == "density":
        by_cell = _DENSITY_CELL
    if recipe.window > 1:
        by_cell += _WINDOW_CELL + _WINDOW_COMPONENT * components
    if torch_device().type != "cpu":
        saved *= views_at_once(recipe.views, saved * shape[1] * shape[2])
    elif not on_disk:
        by_cell += working_bytes(shape, count, recipe) / math.prod(shape)
    return Need(shape, by_cell, _NETWORK_FACTOR * saved + _NETWORK_PIXEL)


def working_bytes(shape: tuple[int, int, int], count: int, recipe: Recipe) -> int:
    """The most bytes that a run of `count` frames (D, H, W) keeps or writes, results included.

    By cell: the density (4 bytes) and the mask (2) of a frame, its fields (4 a component); with a window the velocity
    (6), the gain (2), the step (2 a component) and the change (2) too; as results a density (4) and a velocity (12), if
    they compress to nothing less. Coarser octaves add up to less than a quarter, which leaves room for an obstacle.
    """
    components = recipe.components
    by_cell = 6 + 4 * components + 16 + (10 + 2 * components if recipe.window > 1 else 0)
    return int(1.25 * math.prod(shape) * count * by_cell)


def require_memory(need: Need, free: int) -> str:
    """Say what a run will take of the memory that is there.

    Raises:
        InputError: it is more than there is.
    """
    if need.total > free:
        size = "×".join(str(n) for n in reversed(need.shape))
        largest = need.largest_that_fits(free)
        fits = (
            "no grid would fit" if largest is None else f"{'×'.join(str(n) for n in reversed(largest))} cells would fit"
        )
        raise InputError(
            f"memory: frames of {size} cells need about {need.total / 1e9:.1f} GB and {free / 1e9:.1f} GB are free; "
            f"{fits}: resample the frames or free some memory"
        )
    return f"memory: about {need.total / 1e9:.1f} GB of {free / 1e9:.1f} GB"


def free_bytes() -> int:
    """What a run can have where the active variant computes, in bytes."""
    device = torch_device()
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    # Of what a run needs, the process holds a part already.
    return environment.free_memory() + min(environment.resident_memory(), PROCESS)
