"""Mitsuba's path tracer `prbvolpath` as an independent estimator of the emission–absorption image.

Mitsuba's media do not emit. But emission d over extinction γ d is the constant 1/γ, so that the continuous image is
I = (1 − T)/γ with the transmittance T = exp(−γ ∫ d). And T is the radiance that a path tracer measures of a constant
environment of radiance 1 through the same smoke, purely absorbing (albedo 0). Each path contributes 0 or 1: it is
absorbed or escapes.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.bounds import Region, smoke_box
from tnst_mi.machine.garbage import collection_paused
from tnst_mi.machine.optix import require_optix
from tnst_mi.rendering.cameras.perspective import require_outside
from tnst_mi.rendering.cameras.views import View
from tnst_mi.rendering.scene import scene_description

_EXTINCTION = "smoke.interior_medium.sigma_t.data"

#: Maximum number of paths traced in one launch; the memory of a launch grows with it.
_LARGEST_LAUNCH = 1 << 20

#: Empty cells kept around the smoke: paths are traced, and derivatives taken, there too.
_MARGIN = 2


class PathTracer:
    """Estimates T, and derivatives of I = (1 − T)/γ, along the rays through the pixel centres of some views.

    The rays are those of `tnst_mi.render`, and `prbvolpath` is evaluated by its own `sample()` on them: rendering with
    it would average over each pixel's area instead. The medium ends two cells outside the smoke, since crossing empty
    space costs as many tentative collisions as crossing dense smoke.

    Args:
        density: (D, H, W) float32, finite, ≥ 0, somewhere > 0.
        views: V of them, orthographic or in perspective; see `rendering.cameras.views`.
        gamma: extinction γ per unit of density and cell.
        slack: ratio of the extinction's majorant to its maximum, > 1. At 1 the derivatives are wrong (they rely on
            null collisions, which do not occur where the smoke is densest); more slack means less noise and more
            collisions.

    Attributes:
        region: the slices of the (D, H, W) grid that the medium covers; derivatives outside it are not estimated.

    Raises:
        InputError: the density is 0 everywhere, the eye of a view is in the grid, or a GPU lacks OptiX.
    """

    def __init__(self, density: np.ndarray, views: Sequence[View], gamma: float, slack: float = 2.0) -> None:
        require_optix("compare")
        require_outside(views, density.shape, 1.0, "compare")
        d, h, w = density.shape
        self.shape, self.view_count = (d, h, w), len(views)
        self.region = smoke_region(density)
        extinction = np.ascontiguousarray(gamma * density[self.region], np.float32)

        description = scene_description(self.shape, gamma, "exact", 1.0, len(views))
        # No path scatters: one that collides is absorbed.
        description["integrator"] = {"type": "prbvolpath", "max_depth": 1}
        description["environment"] = {"type": "constant", "radiance": 1.0}
        smoke = scene_description(extinction.shape, gamma, "exact", 1.0, 1)["smoke"]
        grid = smoke["interior"]["sigma_t"]
        grid["grid"] = mi.VolumeGrid(extinction[..., None])
        grid["max_value"] = slack * float(extinction.max())
        offset = [(part.start + part.stop - size) / 2 for part, size in zip(self.region, self.shape, strict=True)]
        for placed in (smoke, grid):
            placed["to_world"] = mi.ScalarTransform4f().translate(offset[::-1]) @ placed["to_world"]
        description["smoke"] = smoke

        self.scene = mi.load_dict(description)
        self.parameters = mi.traverse(self.scene)
        self.integrator = self.scene.integrator()
        sensor = self.scene.sensors()[0]
        sensor.set_views(views)
        self.rays = sensor.rays.through_pixels(0, len(views))
        dr.eval(self.rays)

    @property
    def largest_launch(self) -> int:
        """Maximum number of samples per pixel of one call."""
        return max(1, _LARGEST_LAUNCH // dr.width(self.rays.d))

    def transmittance(self, spp: int, seed: int) -> np.ndarray:
        """Estimate T with `spp` paths per pixel: (V, H, W) float64, multiples of 1/spp in [0, 1]."""
        with dr.suspend_grad(), collection_paused():
            radiance, _ = self._trace(self._rays(spp), self._sampler(spp, seed))
            mean = dr.block_sum(radiance.x, spp)
        return np.asarray(mean.numpy(), np.float64).reshape(self.view_count, *self.shape[1:]) / spp

    def gradient(self, weights: np.ndarray, spp: int, seed: int) -> np.ndarray:
        """Estimate the derivative of Σ weights · I with respect to the density.

        Args:
            weights: (V, H, W), one factor per pixel.
            spp: paths per pixel.
            seed: of the random numbers.

        Returns:
            (D, H, W) float32, 0 outside `region`.
        """
        extinction = self.parameters[_EXTINCTION]
        dr.enable_grad(extinction)
        dr.set_grad(extinction, 0)
        self.parameters.update()
        # dI/dd = −(1/γ) dT/dσ · dσ/dd = −dT/dσ: γ cancels. A third for each of the three equal colour channels.
        adjoint = mi.Float(np.repeat(np.asarray(-weights / (3 * spp), np.float32).ravel(), spp))
        with dr.suspend_grad(), collection_paused():
            rays, sampler = self._rays(spp), self._sampler(spp, seed)
            replayed = sampler.clone()
            radiance, state = self._trace(rays, sampler)
            dr.eval(radiance, state)
            self._trace(rays, replayed, mi.Spectrum(adjoint), state)
        gradient = np.zeros(self.shape, np.float32)
        gradient[self.region] = dr.grad(extinction).numpy()[..., 0]
        dr.disable_grad(extinction)
        return gradient

    def _trace(
        self, rays: mi.Ray3f, sampler: mi.Sampler, adjoint: mi.Spectrum | None = None, state: mi.Spectrum | None = None
    ) -> tuple[mi.Spectrum, mi.Spectrum]:
        mode = dr.ADMode.Primal if adjoint is None else dr.ADMode.Backward
        radiance, _, _, state = self.integrator.sample(mode, self.scene, sampler, rays, adjoint, state, mi.Bool(True))
        return radiance, state

    def _rays(self, spp: int) -> mi.Ray3f:
        pixel = dr.repeat(dr.arange(mi.UInt32, dr.width(self.rays.d)), spp)
        rays = dr.gather(mi.Ray3f, self.rays, pixel)
        # Kept out of the path tracer's kernel, which would otherwise be recompiled for every `spp`.
        dr.eval(rays)
        return rays

    def _sampler(self, spp: int, seed: int) -> mi.Sampler:
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, dr.width(self.rays.d) * spp)
        return sampler


def smoke_region(density: np.ndarray) -> Region:
    """The smallest box of cells that contains all smoke and two empty cells around it.

    Raises:
        InputError: there is no smoke.
    """
    region = smoke_box(density, _MARGIN)
    if region is None:
        raise InputError("the density is 0 everywhere, expected smoke to compare renderers on")
    return region
