"""The velocity between two frames on one grid, changed until the smoke of the first, moved by it, shows the second.

The unknown is a vector potential Ψ whose curl u = ∇×Ψ has no divergence, as the velocity of smoke: moving smoke neither
makes nor loses any. What is lowered, by Adam through the adjoints of the renderer and of the transport, is

    P / 2 (ν² + FLOOR²) · mean (pixel − picture)² + N / 2 GRADIENT² · mean |∇u|²

It is the negative logarithm of a posterior: of P pixels with noise ν, and of N places whose |∇u| is normal with the
standard deviation GRADIENT. Pictures say nothing of a velocity along which smoke looks the same, nor of one where there
is none: there it continues smoothly what is around. Ψ is given on a lattice of twice the grid's cells and interpolated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from tnst_mi.fields.advection import advect
from tnst_mi.fields.grid import Octave, Shape
from tnst_mi.fields.potentials import velocity
from tnst_mi.fields.resampling import cubic_matrix, resample_potential, resample_velocity
from tnst_mi.fields.torch_operation import called_from_torch
from tnst_mi.reconstruction.fitting.descent import Descent

#: Standard deviation of |∇u| in cells per frame and cell: 0.10, 0.13 and 0.18 in the bundled simulations.
GRADIENT = 0.14

#: Number of places along the longest edge of a grid whose velocities differ: in the bundled simulations, the root mean
#: squares of u and ∇u have a ratio of 2.0 to 2.9 cells, a thirty-second of that edge.
_PLACES = 32

#: What a picture shows besides smoke that was moved, in parts of its peak, such as what an inflow has added: on the
#: bundled jet, moved by its own velocity, 0.0055.
_FLOOR = 0.005

#: Cells of the grid in one of the lattice, along every edge.
_SPACING = 2

#: By how much Adam changes the velocity in a step, at most, in cells of the grid per frame.
_STEP = 0.1

#: Adam leaves in place what changes the logarithm of the posterior by less than this, for a velocity of one cell per
#: frame: else it would walk about where pictures decide nothing, however little they do.
_DECIDES_NOTHING = 1.0

#: Decay of Adam's moments, as of the density's.
_BETAS = (0.9, 0.99)


class MotionDescent:
    """The steps on one grid.

    Args:
        views: the pictures of the second frame, with the extinction of the first on the grid.
        begun: velocity (D, H, W, 3) on the full grid, in its cells per frame, to which that of Ψ is added; None
            for 0.
        full: (D, H, W) of that grid.
        coarser: what has been found on a coarser grid; None to begin with `begun`.
        noise: ν, of the pictures, in units of the peak.
        pixels: P.
        steps: how many will be done.

    Attributes:
        octave: the grid.
        unknown: Ψ on its lattice, in full-resolution cells² per frame.
        steps, done: how many steps there are, and have been done.
        adam: what does them.
    """

    def __init__(
        self,
        views: Descent,
        begun: np.ndarray | None,
        full: Shape,
        coarser: MotionDescent | None,
        noise: float,
        pixels: int,
        steps: int,
    ) -> None:
        self.octave, self.steps, self.done, self._views = views.octave, steps, 0, views
        self._before = views.extinction.detach()
        device, h = self._before.device, self.octave.cell_size
        still = np.zeros((*full, 3), np.float32) if begun is None else begun
        octave_begun = np.array(resample_velocity(still, 1.0, self.octave.shape, h), np.float32)
        self._begun = torch.from_numpy(octave_begun).to(device)
        self._lattice = _lattice(self.octave, full)
        if coarser is None:
            start = np.zeros((*self._lattice.shape, 3), np.float32)
        else:
            found, cell = coarser.unknown.detach().cpu().numpy(), coarser._lattice.cell_size
            start = np.array(resample_potential(found, cell, self._lattice.shape, self._lattice.cell_size), np.float32)
        self.unknown = torch.from_numpy(start).to(device).requires_grad_()
        self._interpolation = [
            torch.from_numpy(cubic_matrix(m, self._lattice.cell_size, n, h)).float().to(device)
            for m, n in zip(self._lattice.shape, self.octave.shape, strict=True)
        ]
        places = math.prod(max(1.0, _PLACES * n / max(full)) for n in full)
        self._misfit_weight = pixels / (2 * (noise**2 + _FLOOR**2))
        self._roughness_weight = places / (2 * GRADIENT**2)
        # A potential that changes by the edge of a cell of the lattice from one to the next makes a velocity of one.
        self.adam = torch.optim.Adam([self.unknown], betas=_BETAS, eps=_DECIDES_NOTHING / self._lattice.cell_size)

    @property
    def remembered(self) -> dict[str, Tensor]:
        """Nothing besides Ψ."""
        return {}

    def remember(self, tensors: Mapping[str, Tensor]) -> None:
        """There is nothing to go on with."""

    def step(self) -> float:
        """Do one more step; gives the mean square difference of its views, in units of the squared peak."""
        fastest = _STEP * self.octave.cell_size * self._lattice.cell_size
        for group in self.adam.param_groups:
            group["lr"] = 0.5 * (1 + math.cos(math.pi * self.done / self.steps)) * fastest
        self.adam.zero_grad()
        u = self._velocity()
        loss = self._views.difference(self._moved(u), self.done)
        (self._misfit_weight * loss + self._roughness_weight * self._roughness(u)).backward()
        self.adam.step()
        self.done += 1
        return loss.item()

    def misfit(self) -> float:
        """The root mean square difference of the views of the first step, before any or after the latest one."""
        with torch.no_grad():
            return self._views.difference(self._moved(self._velocity()), 0).sqrt().item()

    def velocity(self, full: Shape) -> np.ndarray:
        """What has been found, on the full grid: (D, H, W, 3) float32, in its cells per frame."""
        with torch.no_grad():
            found = self._velocity().cpu().numpy()
        return np.array(resample_velocity(found, self.octave.cell_size, full, 1.0), np.float32)

    def _velocity(self) -> Tensor:
        """u on the grid, (D, H, W, 3)."""
        Ψ, h = self.unknown, self.octave.cell_size
        for axis, matrix in enumerate(self._interpolation):
            along = Ψ.movedim(axis, 0)
            Ψ = (matrix @ along.flatten(1)).unflatten(1, along.shape[1:]).movedim(0, axis)
        return self._begun + called_from_torch(lambda psi: velocity(None, psi, 0.0, h), [Ψ.contiguous()])

    def _moved(self, u: Tensor) -> Tensor:
        """The extinction of the first frame after one frame, (D, H, W)."""
        h = self.octave.cell_size
        return called_from_torch(
            lambda σ, v: advect(σ, v, "semi_lagrangian", h, trace="flow"), [self._before, u.contiguous()]
        )

    def _roughness(self, u: Tensor) -> Tensor:
        """mean |∇u|², per full-resolution cell."""
        total = torch.zeros((), device=u.device)
        for axis in range(3):
            if u.shape[axis] > 1:
                total = total + 3 * (torch.diff(u, dim=axis) / self.octave.cell_size).square().mean()
        return total


def _lattice(octave: Octave, full: Shape) -> Octave:
    """The lattice of a grid: places about the same centre, beyond its outermost cells."""
    cell = _SPACING * octave.cell_size
    d, h, w = (1 if n == 1 else math.ceil(n / cell) + 1 for n in full)
    return Octave((d, h, w), cell)
