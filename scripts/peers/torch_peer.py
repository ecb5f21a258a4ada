"""Transport and rendering in plain PyTorch: what a careful user of `grid_sample` and autograd would write.

The formulas are those of the package (central differences, MacCormack with reverting limiter, inclusive sum over a
rotated box of the grid's size), so that values and gradients can be compared; only the sampling of the rotated box is
PyTorch's own. Velocities are never stored longer than autograd needs them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.views import sample_views


def velocity(phi: Tensor) -> Tensor:
    """∇Φ by central differences, one-sided at the ends: (D, H, W) → (D, H, W, 3), components (x, y, z)."""
    return torch.stack(torch.gradient(phi, dim=(2, 1, 0)), dim=-1)


def _cell_centres(field: Tensor) -> Tensor:
    """(D, H, W, 3) integer positions (x, y, z) of the cells of a field (D, H, W)."""
    axes = (torch.arange(n, dtype=torch.float32, device=field.device) for n in field.shape)
    z, y, x = torch.meshgrid(*axes, indexing="ij")
    return torch.stack([x, y, z], dim=-1)


def _sample(field: Tensor, position: Tensor) -> Tensor:
    """Trilinear interpolation of (D, H, W) at positions (…, 3) in cells; 0 outside."""
    d, h, w = field.shape
    size = torch.tensor([w, h, d], dtype=torch.float32, device=field.device)
    normalised = (2 * position + 1) / size - 1
    return functional.grid_sample(field[None, None], normalised[None], padding_mode="zeros", align_corners=False)[0, 0]


def advect(density: Tensor, motion: Tensor) -> Tensor:
    """MacCormack with reverting limiter (Selle et al. 2008), one Euler back-trace, 0 outside."""
    centres = _cell_centres(density)
    departure = centres - motion
    forward = _sample(density, departure)
    backward = _sample(forward, centres + motion)
    corrected = forward + 0.5 * (density - backward)
    with torch.no_grad():
        low, high = _corner_range(density, departure)
        kept = (corrected >= low) & (corrected <= high)
    return torch.where(kept, corrected, forward)


def _corner_range(density: Tensor, departure: Tensor) -> tuple[Tensor, Tensor]:
    """Minimum and maximum of the eight cells around the departure points; cells outside are 0."""
    padded = functional.pad(density[None, None], (2, 2, 2, 2, 2, 2))
    high = functional.max_pool3d(padded, 2, stride=1)[0, 0]
    low = -functional.max_pool3d(-padded, 2, stride=1)[0, 0]
    d, h, w = high.shape
    index = [
        (departure[..., axis].floor().long() + 2).clamp(0, n - 1) for axis, n in zip(range(3), (w, h, d), strict=True)
    ]
    flat = (index[2] * h + index[1]) * w + index[0]
    return low.flatten()[flat], high.flatten()[flat]


def render(density: Tensor, views: Sequence[tuple[float, float]], gamma: float) -> Tensor:
    """Inclusive sum along the depth of the grid's box, rotated for each view (degrees): (V, H, W), row 0 at the top."""
    return torch.stack([_render_view(density, azimuth, elevation, gamma) for azimuth, elevation in views])


def _render_view(density: Tensor, azimuth: float, elevation: float, gamma: float) -> Tensor:
    a, e = math.radians(azimuth), math.radians(elevation)
    towards = density.new_tensor([math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)])
    right = density.new_tensor([math.cos(a), 0.0, -math.sin(a)])
    up = torch.linalg.cross(towards, right)
    d, h, w = density.shape
    middle = density.new_tensor([w - 1.0, h - 1.0, d - 1.0]) / 2
    local = _cell_centres(density) - middle
    position = local @ torch.stack([right, up, towards]) + middle
    # The camera is on the side of large z.
    seen = _sample(density, position).flip(0)
    thickness = torch.cumsum(seen, dim=0)
    return (seen * torch.exp(-gamma * thickness)).sum(0).flip(0)


def _blurred(field: Tensor, kernel: Tensor, padding: str) -> Tensor:
    """(D, H, W), convolved along each axis."""
    field, reach = field[None, None], len(kernel) // 2
    for axis in range(3):
        shape, pad = [1, 1, 1, 1, 1], [0] * 6
        shape[2 + axis], pad[4 - 2 * axis], pad[5 - 2 * axis] = len(kernel), reach, reach
        field = functional.conv3d(functional.pad(field, pad, mode=padding), kernel.reshape(shape))
    return field[0, 0]


def normalised(gradient: Tensor, levels: int, sigma: float = 1.2) -> Tensor:
    """The gradient, blurred, with the bands of its Laplacian pyramid divided by their RMS and merged."""
    reach = math.ceil(4 * sigma)
    gaussian = torch.exp(-0.5 * (torch.arange(-reach, reach + 1, device=gradient.device) / sigma) ** 2)
    field = _blurred(gradient, gaussian / gaussian.sum(), "replicate")
    binomial = gradient.new_tensor([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
    bands = []
    for _ in range(levels):
        coarse = _blurred(field, binomial, "replicate")[::2, ::2, ::2]
        bands.append(field - _expanded(coarse, field.shape))
        field = coarse
    merged = field / field.square().mean().sqrt().clamp(min=1e-10)
    for band in reversed(bands):
        merged = _expanded(merged, band.shape) + band / band.square().mean().sqrt().clamp(min=1e-10)
    return merged


def _expanded(coarse: Tensor, shape: Sequence[int]) -> Tensor:
    return functional.interpolate(coarse[None, None], size=tuple(shape), mode="trilinear", align_corners=False)[0, 0]


class StyleIteration:
    """A whole iteration of a style recipe: transport, views, network (channels last, one batch), normalised step."""

    def __init__(
        self, density: np.ndarray, phi: np.ndarray, recipe: Recipe, network: GoogLeNet, exposure: float
    ) -> None:
        device = next(network.parameters()).device
        self.density, self.phi = (torch.from_numpy(field).to(device) for field in (density, phi))
        self.phi.requires_grad_()
        self.recipe, self.network, self.exposure = recipe, network, exposure
        self.layers = list(recipe.style_layers)
        # The cost does not depend on the picture.
        picture = torch.rand(1, 3, *density.shape[1:], generator=torch.Generator().manual_seed(0)).to(device)
        with torch.no_grad():
            features = network(picture, layers=self.layers)
            self.targets = {layer: gram(values)[0] for layer, values in features.items()}

    def __call__(self) -> Tensor:
        """The potential after the iteration."""
        views = sample_views(self.recipe.views, self.recipe.azimuth, self.recipe.elevation, 0)
        moved = advect(self.density, velocity(self.phi))
        seen = moved.detach().requires_grad_()
        images = self.exposure * render(seen, views, self.recipe.gamma)
        features = self.network(images[:, None].repeat(1, 3, 1, 1), layers=self.layers)
        loss = sum(
            ((gram(values) - self.targets[layer]).square().sum((1, 2)) / self.targets[layer].square().sum()).sum()
            for layer, values in features.items()
        )
        (gradient,) = torch.autograd.grad(loss, seen)
        (gradient,) = torch.autograd.grad(moved, self.phi, gradient)
        with torch.no_grad():
            return self.phi - 1e-9 * self.density * normalised(gradient, self.recipe.pyramid_levels)


def gram(features: Tensor) -> Tensor:
    """Gram matrices: (N, C, h, w) → (N, C, C), divided by the number of positions."""
    flat = features.flatten(2)
    return flat @ flat.transpose(1, 2) / flat.shape[2]
