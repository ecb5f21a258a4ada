"""Renderers of a density on a grid, differentiable with respect to it, and the one of emission and absorption.

World units are full-resolution cells; the grid's centre is the origin. The density becomes the extinction σ_t = γ d of
a `heterogeneous` medium, and the `emission_absorption` plugin marches through it. A medium is enough: no Mitsuba scene
is built, so no ray tracer (OptiX on a GPU) is needed.
"""

from __future__ import annotations

import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.grid import Shape
from tnst_mi.fields.kernels import opaque_int
from tnst_mi.machine.backend import on_gpu
from tnst_mi.machine.garbage import collection_paused
from tnst_mi.machine.turns import turn
from tnst_mi.rendering.cameras.camera import Viewpoint
from tnst_mi.rendering.cameras.orthographic import OrthographicRays
from tnst_mi.rendering.cameras.perspective import ConvergingRays, ViewpointRays, rays_of
from tnst_mi.rendering.march.grid_march import GridMarch
from tnst_mi.rendering.march.lattice import Lattice
from tnst_mi.rendering.march.medium import GridMedium
from tnst_mi.rendering.scene import medium_description, view_distance

#: Limit in bytes of the adjoint samples that a GPU stores at once, of as many views as that allows: where grids are
#: small, launches of single views take the host longer than the GPU. On a CPU it is always one view, whose samples fit
#: the caches better.
LARGEST_SAMPLES = 1 << 28


class Renderer(ABC):
    """Renders densities (D, H, W) of one grid from centred views and from the cameras of shots, in any mixture.

    A seed is one or more integers ≥ 0 from which a renderer draws its random numbers: the same seed gives the same
    images and derivatives, those of path tracers up to the order in which a GPU adds.
    """

    def render(self, density: mi.TensorXf, views: Sequence[Viewpoint], seed: Sequence[int] = (0,)) -> mi.TensorXf:
        """Images (V, H, W) of a density (D, H, W), differentiable with respect to it; row 0 is at the top."""
        return dr.custom(_Render, density, self, tuple(views), tuple(seed))

    @abstractmethod
    def images(self, density: mi.TensorXf, views: Sequence[Viewpoint], seed: Sequence[int]) -> mi.TensorXf:
        """The images (V, H, W) of the views, without derivatives."""

    @abstractmethod
    def gradient(
        self,
        density: mi.TensorXf,
        views: Sequence[Viewpoint],
        seed: Sequence[int],
        images: mi.TensorXf,
        image_gradient: mi.TensorXf,
    ) -> mi.TensorXf:
        """Pull a gradient (V, H, W) with respect to the `images` back to one (D, H, W) with respect to the density."""

    def tangent(
        self, density: mi.TensorXf, views: Sequence[Viewpoint], seed: Sequence[int], change: mi.TensorXf
    ) -> mi.TensorXf:
        """The derivative of the images (V, H, W) along a change (D, H, W) of the density."""
        raise NotImplementedError(f"{type(self).__name__} has no forward-mode derivatives")


class _Render(dr.CustomOp):
    """density → images, by any renderer."""

    def eval(
        self, density: mi.TensorXf, renderer: Renderer, views: tuple[Viewpoint, ...], seed: tuple[int, ...]
    ) -> mi.TensorXf:
        self.density, self.renderer, self.arguments = dr.detach(density), renderer, (views, seed)
        with turn(), dr.suspend_grad(), collection_paused():
            self.images = renderer.images(self.density, views, seed)
            # Evaluated now: the adjoint needs them again and should not march for them.
            dr.eval(self.images)
        return self.images

    # Derivatives are taken by whoever wants them, and the medium is shared by all renderers of a grid.

    def forward(self) -> None:
        change = mi.TensorXf(self.grad_in("density").array, self.density.shape)
        with turn(), collection_paused():
            self.set_grad_out(self.renderer.tangent(self.density, *self.arguments, change))

    def backward(self) -> None:
        with turn(), collection_paused():
            gradient = self.renderer.gradient(self.density, *self.arguments, self.images, self.grad_out())
            self.set_grad_in("density", gradient)

    def name(self) -> str:
        return "render views"


class EmissionAbsorptionRenderer(Renderer):
    """Smoke that emits and absorbs light (paper Eq. 11); deterministic.

    Args:
        shape: (D, H, W) of the grid.
        gamma: ratio γ of extinction to density, per full-resolution cell.
        quadrature: one of `tnst_mi.choices.QUADRATURES`.
        h: size of a cell in full-resolution cells.
        step: distance between the samples of a ray in full-resolution cells; h if None.
        size: rows and columns of the images, around the grid's centre; those of the grid if None.
        pixel: distance between pixels in full-resolution cells, of views in perspective in the plane through the grid's
            centre; h if None. Cameras have their own. Rays are not averaged over pixels that are larger than cells:
            resample the density instead.
    """

    #: Adjoint samples that are stored for each sample of a ray.
    samples_per_ray = 1

    #: Limit in bytes of the adjoint samples that a CPU stores at once; of one view, if that has more.
    samples_of_cpu = 0

    def __init__(
        self,
        shape: Shape,
        gamma: float,
        quadrature: str,
        h: float,
        step: float | None = None,
        size: tuple[int, int] | None = None,
        pixel: float | None = None,
    ) -> None:
        self.shape, self.gamma, self.h, self.size = shape, gamma, h, size or shape[1:]
        self.pixel = pixel or h
        self._medium = _medium(mi.variant(), shape, h)
        self._step = step or h
        self._integrator = _integrator(mi.variant(), gamma, quadrature, self._step)

    def images(self, density: mi.TensorXf, views: Sequence[Viewpoint], seed: Sequence[int]) -> mi.TensorXf:
        """The images (V, H, W) of the views, without derivatives."""
        self._place(density)
        rays = self._rays(views)
        L = self._sample(dr.ADMode.Primal, rays, 0, len(views))
        return mi.TensorXf(L[0], (len(views), *self.size))

    def gradient(
        self,
        density: mi.TensorXf,
        views: Sequence[Viewpoint],
        seed: Sequence[int],
        images: mi.TensorXf,
        image_gradient: mi.TensorXf,
    ) -> mi.TensorXf:
        """Pull a gradient (V, H, W) with respect to the `images` back to one (D, H, W) with respect to the density."""
        rays = self._rays(views)
        pixels = math.prod(self.size)
        at_once = self._views_at_once(len(views))
        with dr.resume_grad():
            σ_t = self._place(density, attached=True)
            with dr.suspend_grad():
                for first in range(0, len(views), at_once):
                    count = min(at_once, len(views) - first)
                    pixel = dr.arange(mi.UInt32, count * pixels) + mi.UInt32(opaque_int(first * pixels))
                    L, δL = (dr.gather(mi.Float, image.array, pixel) for image in (images, image_gradient))
                    self._sample(dr.ADMode.Backward, rays, first, count, state_in=L, δL=mi.Spectrum(δL, 0, 0))
            return mi.TensorXf(dr.grad(σ_t).array, self.shape)

    def tangent(
        self, density: mi.TensorXf, views: Sequence[Viewpoint], seed: Sequence[int], change: mi.TensorXf
    ) -> mi.TensorXf:
        """The derivative of the images (V, H, W) along a change (D, H, W) of the density."""
        with dr.resume_grad():
            σ_t = self._place(density, attached=True)
            dr.set_grad(σ_t, mi.TensorXf(change.array, (*self.shape, 1)))
            with dr.suspend_grad():
                # The derivative is with respect to σ_t before the medium's scale, which is the density.
                L = self._sample(dr.ADMode.Forward, self._rays(views), 0, len(views))
        return mi.TensorXf(L[0], (len(views), *self.size))

    def march(self, density: mi.TensorXf, views: Sequence[Viewpoint]) -> tuple[GridMarch, mi.Float]:
        """The samples of all rays of the views in a density, without derivatives, and the distance between them."""
        self._place(density)
        rays = self._rays(views)
        together = rays.together(0, len(views))
        axis = together.axis if isinstance(together, ConvergingRays) else None
        lattice = Lattice(self._medium, rays.through_pixels(0, len(views)), self._step, axis=axis)
        return GridMarch(self._medium, lattice), lattice.step

    def _views_at_once(self, count: int) -> int:
        """Number of views whose adjoint samples are stored together."""
        of_view = self.samples_per_ray * view_samples(self.shape, self.size)
        return max(1, min(count, (LARGEST_SAMPLES if on_gpu() else self.samples_of_cpu) // of_view))

    def _rays(self, views: Sequence[Viewpoint]) -> OrthographicRays | ViewpointRays:
        rows, columns = self.size
        return rays_of(views, columns, rows, self.pixel, view_distance(self.shape, self.h))

    def _place(self, density: mi.TensorXf, attached: bool = False) -> mi.TensorXf:
        """Set the medium's density, which stays until the next call; returns the medium's tensor."""
        σ_t = mi.TensorXf(density.array, (*self.shape, 1))
        if attached:
            dr.enable_grad(σ_t)
        parameters = self._medium.parameters
        parameters["sigma_t.data"] = σ_t
        parameters.update()
        self._medium.refresh()
        # σ_t = γ d without a copy: the medium's scale is γ. Mitsuba's own medium is not told: its scale is part of the
        # code of every path tracer in this process, which would be compiled anew, and kept, for each γ.
        self._medium.scale = float(np.float32(self.gamma))
        self._medium.colour = None
        return self._medium.extinction

    def _sample(
        self, mode: dr.ADMode, rays: OrthographicRays | ViewpointRays, first: int, count: int, **adjoint: object
    ) -> mi.Spectrum:
        """Call the integrator for the rays of `count` views directly, without a film."""
        arguments = {"state_in": None, "δL": None, "together": rays.together(first, count)} | adjoint
        through = rays.through_pixels(first, count)
        return self._integrator.sample(mode, self._medium, None, through, active=mi.Bool(True), **arguments)[0]


def view_samples(shape: Shape, size: tuple[int, int]) -> int:
    """Bytes of the adjoint samples of one view of a grid (D, H, W), at most; `size` is (rows, columns) of the image."""
    rows, columns = size
    # The diagonal, and up to two planes of samples more at either end.
    return 4 * rows * columns * (math.ceil(math.hypot(*shape)) + 4)


@functools.lru_cache(maxsize=6)
def _medium(variant: str, shape: Shape, h: float) -> GridMedium:
    """A cached medium, since Mitsuba does not free all memory of a medium; each pass sets its own density."""
    return GridMedium(mi.load_dict(medium_description(shape, h)))


@functools.lru_cache(maxsize=64)
def _integrator(variant: str, gamma: float, quadrature: str, step: float) -> mi.ad.integrators.common.RBIntegrator:
    return mi.load_dict({"type": "emission_absorption", "gamma": gamma, "quadrature": quadrature, "step": step})
