"""Estimates the memory that a run needs, to report it before the start and to refuse a run that cannot fit."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch

from tnst_mi.errors import InputError
from tnst_mi.losses.objective import views_at_once
from tnst_mi.machine import environment
from tnst_mi.machine.backend import torch_device
from tnst_mi.recipe.recipe import Recipe

# Measured with `stylize` at 128×192×128 and 200×300×200 cells (docs/performance.md): the peak resident size, less what
# the network takes up, is linear in the number of cells for each parameterisation.

#: Bytes of a process that has loaded Mitsuba, Dr.Jit, LLVM, torch and a GoogLeNet, and compiled its kernels.
PROCESS = 450_000_000

#: Bytes per cell of the finest grid (density, mask, images' derivatives, transport, result), and per component.
_TRANSPORT_CELL, _TRANSPORT_COMPONENT, _DENSITY_CELL = 55, 27, 55

#: Bytes per cell, and per component, that a window adds: velocity, gain, sums, and an item that is read ahead.
_WINDOW_CELL, _WINDOW_COMPONENT = 50, 16

#: The network's evaluation takes more than what autograd saves: gradients, and a convolution's columns, per pixel.
_NETWORK_FACTOR, _NETWORK_PIXEL = 1.2, 1000


@dataclass(frozen=True)
class Need:
    """The peak memory of a run, in bytes.

    Attributes:
        shape: (D, H, W) of the finest grid.
        by_cell: of the grids, per cell; with the state of all frames, if that is not on disk.
        by_pixel: of the network, per pixel of an image, for all views of a batch.
    """

    shape: tuple[int, int, int]
    by_cell: float
    by_pixel: float

    @property
    def total(self) -> int:
        """The sum, including the process itself."""
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
    """The memory that a run needs on the device of the active variant.

    Args:
        shape: (D, H, W) of the frames.
        recipe: of the run.
        count: number of frames.
        saved: bytes that autograd saves of the network's evaluation, per pixel of one view.
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
    """Upper bound of the bytes that a run of `count` frames (D, H, W) keeps or writes, including results.

    Per cell: the density (4 bytes) and the mask (2) of a frame, its fields (4 per component); with a window also the
    velocity (6), the gain (2), the step (2 per component) and the change (2); as results a density (4) and a velocity
    (12), assuming no compression. Coarser octaves add less than a quarter, which leaves room for an obstacle.
    """
    components = recipe.components
    by_cell = 6 + 4 * components + 16 + (10 + 2 * components if recipe.window > 1 else 0)
    return int(1.25 * math.prod(shape) * count * by_cell)


def require_memory(need: Need, free: int) -> str:
    """Check that a run fits into the free memory, and return a line that says how much of it the run takes.

    Raises:
        InputError: the run does not fit.
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
    """Memory that a run can use on the device of the active variant, in bytes."""
    device = torch_device()
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    # The process already holds part of what a run needs.
    return environment.free_memory() + min(environment.resident_memory(), PROCESS)
