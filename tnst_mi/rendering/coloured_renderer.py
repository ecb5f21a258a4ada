"""Renders smoke that emits in colour, differentiable with respect to the density and the colour."""

from __future__ import annotations

import math
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.kernels import opaque_int
from tnst_mi.machine.garbage import collection_paused
from tnst_mi.machine.turns import turn
from tnst_mi.rendering.cameras.camera import Viewpoint
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer


class ColouredRenderer(EmissionAbsorptionRenderer):
    """Smoke that emits in colour and absorbs alike in all channels: I = Σ_k c_k w_k, with the grey image Σ_k w_k.

    Where the colour is white, each channel is the grey image to the bit.
    """

    #: Of the density and of three channels.
    samples_per_ray = 4

    def render_colour(
        self,
        density: mi.TensorXf,
        colour: mi.TensorXf,
        views: Sequence[Viewpoint],
        known: mi.TensorXf | None = None,
    ) -> mi.TensorXf:
        """Images (V, H, W, 3) of a density (D, H, W) and its colour (D, H, W, 3), linear RGB, differentiable in both.

        Row 0 is at the top. `known` are the same images without derivatives, if they have been rendered before for
        others: nothing is marched for them again.
        """
        varied = (dr.grad_enabled(density), dr.grad_enabled(colour))
        return dr.custom(_RenderColour, density, colour, self, tuple(views), varied, known)

    def colour_images(self, density: mi.TensorXf, colour: mi.TensorXf, views: Sequence[Viewpoint]) -> mi.TensorXf:
        """The images, without derivatives."""
        self._place(density)
        self._medium.colour = colour
        return self._as_images(self._sample(dr.ADMode.Primal, self._rays(views), 0, len(views)), views)

    def colour_tangent(
        self,
        density: mi.TensorXf,
        colour: mi.TensorXf,
        views: Sequence[Viewpoint],
        density_change: mi.TensorXf,
        colour_change: mi.TensorXf,
    ) -> mi.TensorXf:
        """The derivative of the images along changes of the density and of the colour."""
        with dr.resume_grad():
            σ_t, tinted = self._place_both(density, colour, (True, True))
            dr.set_grad(σ_t, mi.TensorXf(density_change.array, tuple(σ_t.shape)))
            dr.set_grad(tinted, colour_change)
            with dr.suspend_grad():
                return self._as_images(self._sample(dr.ADMode.Forward, self._rays(views), 0, len(views)), views)

    def colour_gradient(
        self,
        density: mi.TensorXf,
        colour: mi.TensorXf,
        views: Sequence[Viewpoint],
        varied: tuple[bool, bool],
        images: mi.TensorXf,
        image_gradient: mi.TensorXf,
    ) -> tuple[mi.TensorXf, mi.TensorXf]:
        """Pull a gradient with respect to the images back to the density (D, H, W) and the colour (D, H, W, 3).

        `varied` says of which of the two it is wanted; the other is 0.
        """
        rays, pixels, at_once = self._rays(views), math.prod(self.size), self._views_at_once(len(views))
        with dr.resume_grad():
            σ_t, tinted = self._place_both(density, colour, varied)
            with dr.suspend_grad():
                for first in range(0, len(views), at_once):
                    count = min(at_once, len(views) - first)
                    pixel = dr.arange(mi.UInt32, count * pixels) + mi.UInt32(opaque_int(first * pixels))
                    L, δL = (dr.gather(mi.Color3f, image.array, pixel) for image in (images, image_gradient))
                    self._sample(dr.ADMode.Backward, rays, first, count, state_in=L, δL=δL)
            return mi.TensorXf(dr.grad(σ_t).array, self.shape), dr.grad(tinted)

    def _place_both(
        self, density: mi.TensorXf, colour: mi.TensorXf, varied: tuple[bool, bool]
    ) -> tuple[mi.TensorXf, mi.TensorXf]:
        """Set the medium's density and colour, attached where they are varied; returns the medium's tensors."""
        σ_t, tinted = self._place(density, attached=varied[0]), mi.TensorXf(colour)
        if varied[1]:
            dr.enable_grad(tinted)
        self._medium.colour = tinted
        return σ_t, tinted

    def _as_images(self, L: mi.Spectrum, views: Sequence[Viewpoint]) -> mi.TensorXf:
        return mi.TensorXf(dr.ravel(mi.Color3f(L)), (len(views), *self.size, 3))


class _RenderColour(dr.CustomOp):
    """density, colour → images."""

    def eval(
        self,
        density: mi.TensorXf,
        colour: mi.TensorXf,
        renderer: ColouredRenderer,
        views: tuple[Viewpoint, ...],
        varied: tuple[bool, bool],
        known: mi.TensorXf | None,
    ) -> mi.TensorXf:
        self.renderer, self.varied = renderer, varied
        self.arguments = (dr.detach(density), dr.detach(colour), views)
        with turn(), dr.suspend_grad(), collection_paused():
            self.images = renderer.colour_images(*self.arguments) if known is None else mi.TensorXf(known)
            # Evaluated now: the adjoint needs them again and should not march for them.
            dr.eval(self.images)
        return self.images

    def forward(self) -> None:
        changes = [
            mi.TensorXf(self.grad_in(name).array if varied else dr.zeros(mi.Float, dr.prod(given.shape)), given.shape)
            for name, varied, given in zip(("density", "colour"), self.varied, self.arguments[:2], strict=True)
        ]
        with turn(), collection_paused():
            self.set_grad_out(self.renderer.colour_tangent(*self.arguments, *changes))

    def backward(self) -> None:
        with turn(), collection_paused():
            gradients = self.renderer.colour_gradient(*self.arguments, self.varied, self.images, self.grad_out())
            for name, varied, gradient in zip(("density", "colour"), self.varied, gradients, strict=True):
                if varied:
                    self.set_grad_in(name, gradient)

    def name(self) -> str:
        return "render coloured views"
