"""Comparison of derivatives of one objective: ours, the path tracer's, and central differences.

The objective is Σ w I over the pixels of all views, with the "exact" image I and a fixed smooth random image w per
view. It is linear in the image, so that noise in the path tracer's image does not bias its gradient.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.compare.path_tracing import PathTracer, smoke_region
from tnst_mi.compare.values import Advance, launches, relative_rms, seed_of
from tnst_mi.rendering.cameras.views import View
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

#: The path tracer's samples are divided into this many independent estimates, whose scatter gives the error.
REPLICATES = 16

#: 97.5% quantile of Student's t with 15 degrees of freedom.
_STUDENT = 2.131

#: Structures in the random directions and weights have a size of 1/16 of the grid's rows.
_SMOOTHNESS = 1 / 16

#: Central differences change the exponent γ∫d by about this much: their own error is then below 1e-4 of it.
_EXPONENT_CHANGE = 0.03


@dataclass(frozen=True, eq=False)
class Directional:
    """Derivatives of the objective along N random smooth directions of the density, at one γ.

    Attributes:
        gamma: extinction per unit of density and cell.
        spp: paths per pixel behind `replicates`.
        step: our step in cells.
        ours: (N,) our gradient along the directions.
        replicates: (16, N) independent estimates by `prbvolpath`.
        central: (N,) central differences of our images.
        paper: (N,) like `ours`, for quadrature "paper" with the step of one cell.
        paper_central: (N,) its central differences.
    """

    gamma: float
    spp: int
    step: float
    ours: np.ndarray
    replicates: np.ndarray
    central: np.ndarray
    paper: np.ndarray
    paper_central: np.ndarray

    @property
    def traced(self) -> np.ndarray:
        """(N,) derivatives by the path tracer."""
        return self.replicates.mean(0)

    @property
    def interval(self) -> np.ndarray:
        """(N,) half widths of their 95% confidence intervals."""
        return _half_width(self.replicates)

    @property
    def covered(self) -> float:
        """Share of the directions whose confidence interval contains our derivative."""
        return float((np.abs(self.traced - self.ours) <= self.interval).mean())

    @property
    def slope(self) -> float:
        """Slope of the line through the origin fitted to traced against ours, which has no noise."""
        return float(self.traced @ self.ours / (self.ours @ self.ours))

    @property
    def slope_interval(self) -> float:
        """Half width of the slope's 95% confidence interval."""
        return float(_half_width(self.replicates @ self.ours / (self.ours @ self.ours)))

    @property
    def correlation(self) -> float:
        """Correlation of traced and ours over the directions."""
        return float(np.corrcoef(self.traced, self.ours)[0, 1])

    @property
    def traced_error(self) -> float:
        """RMS of traced − ours over the RMS of ours."""
        return relative_rms(self.traced, self.ours)

    @property
    def central_error(self) -> float:
        """RMS of ours − central over the RMS of central."""
        return relative_rms(self.ours, self.central)

    @property
    def paper_error(self) -> float:
        """RMS of paper − paper_central over the RMS of paper_central."""
        return relative_rms(self.paper, self.paper_central)


@dataclass(frozen=True, eq=False)
class GradientFields:
    """Gradients (D, H, W) of the objective of the view (0, 0) alone, at one γ.

    There each voxel affects one pixel only, so central differences of a whole layer of voxels can be taken at once.

    Attributes:
        gamma: extinction per unit of density and cell.
        spp: paths per pixel behind `traced`.
        ours: our gradient, step of one cell.
        traced: by `prbvolpath`; 0 outside the region that its medium covers.
        central: central differences.
        region: that region, slices of z, y, x.
    """

    gamma: float
    spp: int
    ours: np.ndarray
    traced: np.ndarray
    central: np.ndarray
    region: tuple[slice, slice, slice]

    @property
    def central_error(self) -> float:
        """RMS of ours − central over the RMS of central, over all voxels."""
        return relative_rms(self.ours, self.central)

    @property
    def slope(self) -> float:
        """Slope of the line through the origin fitted to traced against ours, over the voxels of the region."""
        ours, traced = (field[self.region].ravel().astype(np.float64) for field in (self.ours, self.traced))
        return float(traced @ ours / (ours @ ours))


def compare_directions(
    density: np.ndarray,
    views: Sequence[View],
    gamma: float,
    spp: int,
    step: float,
    directions: int,
    seed: Sequence[int],
    advance: Advance,
) -> Directional:
    """Compare derivatives along `directions` random smooth directions; `step` is our step in cells."""
    weights = np.stack([weight_image(density.shape[1:], (*seed, i)) for i in range(len(views))])
    replicates = _traced_gradients(PathTracer(density, views, gamma), weights, spp, (*seed, len(views)), advance)
    exact = WeightedSum(density, views, gamma, "exact", step, weights)
    paper = WeightedSum(density, views, gamma, "paper", 1.0, weights)
    fields = [exact.gradient(), *replicates, paper.gradient()]
    projected, differences = [], []
    for direction in random_directions(density, directions, (*seed, len(views) + 1)):
        projected.append([np.vdot(field, direction) for field in fields])
        differences.append([exact.central_difference(direction), paper.central_difference(direction)])
    columns, (central, paper_central) = np.array(projected, np.float64).T, np.array(differences).T
    return Directional(gamma, spp, step, columns[0], columns[1:-1], central, columns[-1], paper_central)


def compare_fields(
    density: np.ndarray, gamma: float, spp: int, seed: Sequence[int], advance: Advance
) -> GradientFields:
    """Compare the gradient of every voxel, in the view (0, 0)."""
    view = [(0.0, 0.0)]
    weights = weight_image(density.shape[1:], (*seed, 0))[None]
    tracer = PathTracer(density, view, gamma)
    traced = np.mean(_traced_gradients(tracer, weights, spp, (*seed, 1), advance), axis=0)
    objective = WeightedSum(density, view, gamma, "exact", 1.0, weights)
    change = np.float32(_EXPONENT_CHANGE / gamma)
    central = np.empty_like(density)
    for z in range(len(density)):
        images = []
        for sign in (1, -1):
            moved = density.copy()
            moved[z] += sign * change
            images.append(objective.images(moved)[0])
        # Image rows run from the top down.
        central[z] = (weights[0] * (images[0] - images[1]) / (2 * change))[::-1]
    return GradientFields(gamma, spp, objective.gradient(), traced, central, tracer.region)


def weight_image(shape: tuple[int, int], seed: Sequence[int]) -> np.ndarray:
    """A smooth random image (H, W) of RMS 1, float32."""
    return _smooth_noise(shape, _SMOOTHNESS * shape[0], seed)


def random_directions(density: np.ndarray, count: int, seed: Sequence[int]) -> Iterator[np.ndarray]:
    """Smooth random fields (D, H, W) of RMS 1 over the region of the smoke and 0 outside it, float32."""
    region = smoke_region(density)
    for i in range(count):
        direction = np.zeros(density.shape, np.float32)
        direction[region] = _smooth_noise(density.shape, _SMOOTHNESS * density.shape[1], (*seed, i))[region]
        yield direction


class WeightedSum:
    """Σ w I of our images, w one factor per pixel, as a function of the density (D, H, W); its derivatives.

    Args:
        density: where the derivatives are taken.
        views: V pairs (azimuth, elevation) in degrees.
        gamma: extinction per unit of density and cell.
        quadrature: "paper" or "exact".
        step: distance between samples in cells.
        weights: w, (V, H, W).
    """

    def __init__(
        self,
        density: np.ndarray,
        views: Sequence[View],
        gamma: float,
        quadrature: str,
        step: float,
        weights: np.ndarray,
    ) -> None:
        self.density, self.views, self.gamma, self.weights = density, views, gamma, weights
        self.renderer = EmissionAbsorptionRenderer(density.shape, gamma, quadrature, 1.0, step)

    def images(self, density: np.ndarray) -> np.ndarray:
        """The images (V, H, W) of another density."""
        return self.renderer.render(mi.TensorXf(density), self.views).numpy()

    def gradient(self) -> np.ndarray:
        """The gradient (D, H, W) by reverse mode."""
        leaf = mi.TensorXf(self.density)
        dr.enable_grad(leaf)
        dr.backward(dr.sum(self.renderer.render(leaf, self.views) * mi.TensorXf(self.weights), axis=None))
        return dr.grad(leaf).numpy()

    def central_difference(self, direction: np.ndarray) -> float:
        """The derivative along a direction (D, H, W) from two images."""
        change = _EXPONENT_CHANGE / (self.gamma * float(np.abs(direction.sum(0)).max()))
        upper, lower = (self.images(self.density + np.float32(sign * change) * direction) for sign in (1, -1))
        return float((self.weights * (upper.astype(np.float64) - lower)).sum() / (2 * change))


def _traced_gradients(
    tracer: PathTracer, weights: np.ndarray, spp: int, seed: Sequence[int], advance: Advance
) -> list[np.ndarray]:
    """Independent estimates of the gradient, among which the paths are divided."""
    share = max(1, spp // REPLICATES)
    gradients = []
    for replicate in range(REPLICATES):
        total = np.zeros(tracer.shape, np.float32)
        for launch, count in enumerate(launches(share, tracer.largest_launch)):
            total += count / share * tracer.gradient(weights, count, seed_of(*seed, replicate, launch))
            advance(count * weights.size)
        gradients.append(total)
    return gradients


def _half_width(replicates: np.ndarray) -> np.ndarray:
    return _STUDENT * replicates.std(0, ddof=1) / np.sqrt(REPLICATES)


def _smooth_noise(shape: tuple[int, ...], size: float, seed: Sequence[int]) -> np.ndarray:
    """White noise blurred periodically by a Gaussian of standard deviation `size` cells, scaled to RMS 1."""
    spectrum = np.fft.rfftn(np.random.default_rng(list(seed)).standard_normal(shape, np.float32))
    for axis, cells in enumerate(shape):
        frequency = np.fft.rfftfreq(cells) if axis == len(shape) - 1 else np.fft.fftfreq(cells)
        filter_ = np.exp(-2 * (np.pi * size * frequency) ** 2)
        spectrum *= filter_.reshape([-1 if other == axis else 1 for other in range(len(shape))])
    noise = np.fft.irfftn(spectrum, shape, axes=range(len(shape))).astype(np.float32)
    return noise / np.sqrt(np.mean(noise**2))
