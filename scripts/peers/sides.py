"""The three sides of the benchmark, with the same methods: the package, PyTorch, and plain Dr.Jit."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import torch

from peers import drjit_peer, torch_peer
from tnst_mi.machine.backend import torch_device
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.gradient import problem_of
from tnst_mi.optimisation.parameterisation import Fields, Transport
from tnst_mi.optimisation.plan import plan_of
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

GAMMA = 0.1


def wavy_potential(shape: tuple[int, int, int]) -> np.ndarray:
    """A smooth potential whose velocity is about half a cell."""
    waves = [np.sin(np.arange(n, dtype=np.float32) / 3) for n in shape]
    return np.float32(waves[0][:, None, None] + waves[1][:, None] + waves[2])


class Ours:
    """The package's transport and rendering of one grid."""

    def __init__(
        self, density: np.ndarray, views: list[tuple[float, float]], trace: str = "step", speed: float = 0.5
    ) -> None:
        self.density, self.views = mi.TensorXf(density), views
        self.renderer = EmissionAbsorptionRenderer(density.shape, GAMMA, "paper", 1.0)
        self.transport = Transport(1.0, trace=trace)
        self.fields = Fields(phi=mi.TensorXf(2 * speed * wavy_potential(density.shape)))

    def transport_forward(self) -> object:
        """The transported density."""
        return self.transport.density(self.fields, self.density, 1.0)

    def transport_backward(self) -> object:
        """The derivative with respect to the potential, the density being that of the result."""
        _, pull_back = self.transport.density_with_pullback(self.fields, self.density, 1.0)
        return pull_back(self.density)["phi"]

    def render_forward(self) -> object:
        """The images of all views."""
        return self.renderer.render(self.density, self.views)

    def render_backward(self) -> object:
        """The derivative of the sum of squared pixels with respect to the density."""
        return self._gradient_of_views(dr.detach(self.density))

    def both_backward(self) -> object:
        """The same of the transported density, with respect to the potential."""
        moved, pull_back = self.transport.density_with_pullback(self.fields, self.density, 1.0)
        return pull_back(self._gradient_of_views(moved))["phi"]

    def _gradient_of_views(self, seen: mi.TensorXf) -> mi.TensorXf:
        dr.enable_grad(seen)
        dr.backward(dr.sum(dr.square(self.renderer.render(seen, self.views).array)))
        return dr.grad(seen)

    def step(self) -> object:
        """The potential after a normalised step along the density."""
        rows = self.density.shape[1]
        return (self.fields - self.transport.step(Fields(phi=self.density), self.density, 1e-9, rows, 1.0, 3))["phi"]


class Iteration:
    """A whole iteration of one frame, as in `stylize`: views → loss → derivative → normalised step.

    Args:
        density: (D, H, W).
        recipe: of the iteration.
        network: judges the images.
        exposure: factor from rendered images to the network's [0, 1].
        speed: about how many cells the smoke moves per frame.
    """

    def __init__(
        self, density: np.ndarray, recipe: Recipe, network: GoogLeNet, exposure: float, speed: float = 0.5
    ) -> None:
        plan = plan_of(recipe, ["smoke"], [0], [1.0], [exposure], density.shape)
        self.rows, (self.frame,) = plan.rows, plan.frames
        self.problem = problem_of(plan, plan.full, network)
        self.density = mi.TensorXf(density)
        self.fields = Fields(phi=mi.TensorXf(2 * speed * wavy_potential(density.shape)))

    def __call__(self) -> object:
        """The potential after the iteration."""
        found = self.problem.gradient(self.frame, self.fields, self.density, (0,))
        step = self.frame.parameterisation.step(found.gradients[0], self.density, 1e-9, self.rows, 1.0, 3)
        self.fields = self.fields - step
        return self.fields["phi"]


class Torch:
    """PyTorch's, with `grid_sample` and autograd."""

    def __init__(self, density: np.ndarray, views: list[tuple[float, float]]) -> None:
        self.density, self.views = torch.from_numpy(density).to(torch_device()), views
        self.phi = torch.from_numpy(wavy_potential(density.shape)).to(torch_device()).requires_grad_()

    def transport_forward(self) -> object:
        """The transported density."""
        with torch.no_grad():
            return torch_peer.advect(self.density, torch_peer.velocity(self.phi))

    def transport_backward(self) -> object:
        """The derivative with respect to the potential, the density being that of the result."""
        moved = torch_peer.advect(self.density, torch_peer.velocity(self.phi))
        return torch.autograd.grad(moved, self.phi, self.density)

    def render_forward(self) -> object:
        """The images of all views."""
        with torch.no_grad():
            return torch_peer.render(self.density, self.views, GAMMA)

    def render_backward(self) -> object:
        """The derivative of the sum of squared pixels with respect to the density."""
        return self._gradient_of_views(self.density)

    def both_backward(self) -> object:
        """The same of the transported density, with respect to the potential."""
        moved = torch_peer.advect(self.density, torch_peer.velocity(self.phi))
        return torch.autograd.grad(moved, self.phi, self._gradient_of_views(moved))

    def _gradient_of_views(self, density: torch.Tensor) -> torch.Tensor:
        # View by view, so that only one view's graph is in memory.
        seen = density.detach().requires_grad_()
        total = torch.zeros_like(seen)
        for view in self.views:
            total += torch.autograd.grad(torch_peer.render(seen, [view], GAMMA).square().sum(), seen)[0]
        return total

    def step(self) -> object:
        """The potential after a normalised step along the density."""
        with torch.no_grad():
            return self.phi - 1e-9 * self.density * torch_peer.normalised(self.density, 3)


class PlainDrJit:
    """Dr.Jit's, with its own derivatives."""

    def __init__(self, density: np.ndarray, views: list[tuple[float, float]]) -> None:
        self.density, self.views, self.shape = mi.Float(density.ravel()), views, density.shape
        self.phi = mi.Float(wavy_potential(density.shape).ravel())

    def _moved(self, phi: mi.Float) -> mi.Float:
        return drjit_peer.advect(self.density, drjit_peer.velocity(phi, self.shape), self.shape)

    def _squares(self, density: mi.Float) -> mi.Float:
        images = drjit_peer.render(density, self.shape, self.views, GAMMA)
        return sum(dr.sum(image * image) for image in images)

    def transport_forward(self) -> object:
        """The transported density."""
        return self._moved(self.phi)

    def transport_backward(self) -> object:
        """The derivative with respect to the potential, the density being that of the result."""
        leaf = mi.Float(self.phi)
        dr.enable_grad(leaf)
        dr.backward(dr.sum(self._moved(leaf) * self.density))
        return dr.grad(leaf)

    def render_forward(self) -> object:
        """The images of all views."""
        return drjit_peer.render(self.density, self.shape, self.views, GAMMA)

    def render_backward(self) -> object:
        """The derivative of the sum of squared pixels with respect to the density."""
        leaf = mi.Float(self.density)
        dr.enable_grad(leaf)
        dr.backward(self._squares(leaf))
        return dr.grad(leaf)

    def both_backward(self) -> object:
        """The same of the transported density, with respect to the potential."""
        leaf = mi.Float(self.phi)
        dr.enable_grad(leaf)
        moved = self._moved(leaf)
        seen = dr.detach(moved)
        dr.enable_grad(seen)
        dr.backward(self._squares(seen))
        dr.backward(dr.sum(moved * dr.grad(seen)))
        return dr.grad(leaf)
