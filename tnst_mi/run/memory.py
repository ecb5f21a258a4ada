"""Estimates the memory that a run needs, to report it before the start and to refuse a run that cannot fit."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch

from tnst_mi.errors import InputError
from tnst_mi.fields.grid import Shape
from tnst_mi.losses.evaluation import views_at_once
from tnst_mi.machine import environment
from tnst_mi.machine.backend import torch_device
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.targets import targets_of
from tnst_mi.rendering.levels import levels_of
from tnst_mi.rendering.renderer import LARGEST_SAMPLES, view_samples

#: Bytes of a process that has loaded Mitsuba, Dr.Jit, LLVM, torch and a GoogLeNet, and compiled its kernels.
PROCESS = 450_000_000

#: Bytes per pixel of every view: the image, exposed and as a tensor of torch, and its derivative, likewise.
_IMAGES = 20


@dataclass(frozen=True)
class Costs:
    """What a kind of device takes, in bytes.

    Attributes:
        process: what a run takes whatever its grid.
        transport_cell, transport_component: per cell of the finest grid (density, mask, the images' derivatives,
            transport, result), and per component of the fields.
        density_cell: the same where density values are optimised.
        flow_cell, volume_cell: what transport along the flow adds: ends of paths, velocity, and sums of its derivative;
            and what its conservative form adds to that.
        result_cell: per cell of the frames, the transport of the result, where octaves are coarser than they.
        colour_cell: what colours that are optimised add beside their field: start, colour, and its derivative.
        region_cell: what each mask of a region adds: on the full grid, on the octave's, and in use.
        window_cell, window_component: what a window adds: velocity, gain, sums, and an item that is read ahead.
        network_factor, network_pixel: the network's evaluation takes more than what autograd saves: gradients and
            workspaces as a factor, a convolution's columns per pixel.
    """

    process: int
    transport_cell: int
    transport_component: int
    density_cell: int
    flow_cell: int
    volume_cell: int
    result_cell: int
    colour_cell: int
    region_cell: int
    window_cell: int
    window_component: int
    network_factor: float
    network_pixel: int


#: By kind of device. CPU: measured with `stylize` at 128×192×128 and 200×300×200 cells (docs/performance.md); the peak
#: resident size, less what the network takes, is linear in the number of cells for each parameterisation. GPU: measured
#: with scripts/measure_gpu.py on an H100 at three sizes (docs/gpu.md), of which the dearest counts: Dr.Jit rounds each
#: array up to a power of two. What the flow takes on a GPU, where it is computed for all cells, is not measured: it is
#: the sum of its arrays, a third of them empty, and the transport of results likewise. What regions take is the sum of
#: their arrays too. What colours add on a CPU was measured at three sizes: 0.7 to 1.05 of it.
COSTS = {
    "cpu": Costs(PROCESS, 55, 27, 55, 38, 30, 80, 60, 16, 50, 16, 1.2, 1000),
    "cuda": Costs(1_300_000_000, 60, 36, 52, 120, 50, 180, 80, 16, 60, 24, 2.5, 0),
}


@dataclass(frozen=True)
class Need:
    """The peak memory of a run on the device of the active variant.

    Attributes:
        shape: (D, H, W) of the frames.
        recipe: of the run.
        count: number of frames.
        saved: bytes that autograd saves of the network's evaluation, per pixel of one view.
        on_disk: whether the state of the frames is on disk.
    """

    shape: Shape
    recipe: Recipe
    count: int
    saved: float
    on_disk: bool

    @property
    def total(self) -> int:
        """In bytes: of the process, the grids, the network, and the samples of views that are stored together."""
        costs, recipe, finest = COSTS[torch_device().type], self.recipe, levels_of(self.recipe, self.shape)[-1]
        of_grids = self._of_iterations(costs) * math.prod(finest.shape)
        if finest.shape != self.shape:
            of_grids += (costs.result_cell + costs.volume_cell * recipe.conservative) * math.prod(self.shape)
        # Whatever the octaves, the colours of a result: start, change, display and linear values, on the frames' grid.
        of_grids += costs.colour_cell * (recipe.colour == "style") * math.prod(self.shape)
        at_once, saved, pixels = 0, self.saved, math.prod(finest.size)
        if torch_device().type != "cpu":
            at_once = recipe.views
            saved *= views_at_once(at_once, saved * pixels)
        elif not self.on_disk:
            of_grids += working_bytes(self.shape, self.count, recipe)
        samples = view_samples(finest.shape, finest.size)
        of_samples = min(at_once * samples, max(samples, LARGEST_SAMPLES))
        by_pixel = costs.network_factor * saved + costs.network_pixel + _IMAGES * recipe.views
        return costs.process + of_samples + int(of_grids + by_pixel * pixels)

    def _of_iterations(self, costs: Costs) -> float:
        """Bytes per cell of the finest octave."""
        recipe, components = self.recipe, self.recipe.components
        by_cell = costs.transport_cell + costs.transport_component * components
        if recipe.transport == "flow":
            by_cell += costs.flow_cell + costs.volume_cell * recipe.conservative
        if recipe.parameterisation == "density":
            by_cell = costs.density_cell + 3 * costs.transport_component * (recipe.colour == "style")
        if recipe.window > 1:
            by_cell += costs.window_cell + costs.window_component * components
        targets = targets_of(recipe)
        by_cell += costs.colour_cell * (recipe.colour == "style")
        by_cell += costs.region_cell * sum(bool(target.mask) for target in targets)
        # Their gradients are kept until the step is made of all.
        return by_cell + 4 * components * (len(targets) - 1)

    def largest_that_fits(self, free: int) -> Shape | None:
        """The largest grid (D, H, W) of these proportions that needs no more than `free` bytes; None if none does."""
        depth, height, width = self.shape
        for rows in range(height, 0, -1):
            shape = (max(1, depth * rows // height), rows, max(1, width * rows // height))
            if replace(self, shape=shape).total <= free:
                return shape
        return None


def working_bytes(shape: tuple[int, int, int], count: int, recipe: Recipe, states: bool = False) -> int:
    """Upper bound of the bytes that a run of `count` frames (D, H, W) keeps or writes, including results.

    Per cell: the density (4 bytes) and the mask (2) of a frame, the masks of its regions (2 each, and 2 for their
    support), its fields (4 per component); with a window also the velocity (6), the gain (2), the step (2 per
    component, 4 if it is a gradient) and the change (2); as results a density (4) and a velocity (12), and where
    colours are optimised, those with which they begin (12) and those of results (12), assuming no compression; and with
    `states`, the fields once more, for a run that goes on from there. Coarser octaves add less than a quarter, which
    leaves room for an obstacle.
    """
    components, of_colour = recipe.components, 24 * (recipe.colour == "style")
    step = components * (4 if recipe.step_order == "align_first" else 2)
    masks = sum(bool(target.mask) for target in targets_of(recipe))
    by_cell = 6 + 2 * (masks + (masks > 0)) + 4 * components + 16 + (10 + step if recipe.window > 1 else 0) + of_colour
    by_cell += 4 * components * states
    return int(1.25 * math.prod(shape) * count * by_cell)


def cache_bytes(need: Need, free: int, count: int, recipe: Recipe, processes: int = 1) -> int:
    """Bytes of device memory in which a run may keep items, so that a window is not read again for every frame.

    At most what the items take: of `count` frames with a window, of one frame without. And of what the run leaves free,
    at most a half on a GPU, and a quarter on a CPU, whose memory others use too.
    """
    share = 4 if torch_device().type == "cpu" else 2
    items = working_bytes(need.shape, count if recipe.window > 1 else 1, recipe)
    return max(0, min(items, (_of_each(free, processes) - need.total) // share))


def _of_each(free: int, processes: int) -> int:
    """What each of several processes may take; each has a GPU of its own."""
    return free // processes if torch_device().type == "cpu" else free


def require_memory(need: Need, free: int, processes: int = 1) -> str:
    """Check that a run fits into the free memory, and return a line that says how much of it the run takes.

    Args:
        need: of one process.
        free: memory, in bytes.
        processes: how many share the work.

    Raises:
        InputError: the run does not fit.
    """
    free = _of_each(free, processes)
    if need.total > free and processes > 1:
        raise InputError(
            f"memory: each of {processes} processes needs about {need.total / 1e9:.1f} GB and {free / 1e9:.1f} GB are "
            "free for it; take fewer processes, resample the frames, or free some memory"
        )
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
    each = f"for each of {processes} processes " if processes > 1 else ""
    return f"memory: {each}about {need.total / 1e9:.1f} GB of {free / 1e9:.1f} GB that are free"


def free_bytes() -> int:
    """Memory that a run can use on the device of the active variant, in bytes."""
    device = torch_device()
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    # The process already holds part of what a run needs.
    return environment.free_memory() + min(environment.resident_memory(), PROCESS)
