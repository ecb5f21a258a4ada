"""Smoke that emits in colour: a ray shows L = Σ c_k w_k, with the colour c_k and the white share w_k of sample k.

The extinction stays a scalar. With W_k, what the samples up to k show of white smoke, w_k = W_k − W_{k−1}. Summation by
parts gives L = c_n W_n − Σ (c_k − c_{k−1}) W_{k−1}: where the colour is 1, that is W_n, the grey radiance to the bit.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.kernels import opaque
from tnst_mi.fields.stencil import ClampedStencil
from tnst_mi.fields.sums import RepeatableSum, largest_magnitude
from tnst_mi.rendering.march.back_projection import RaysTogether
from tnst_mi.rendering.march.converging import back_projection
from tnst_mi.rendering.march.grid_march import GridMarch
from tnst_mi.rendering.march.medium import GridMedium, probe_transform
from tnst_mi.rendering.march.scene_media import SceneMedia
from tnst_mi.rendering.march.segments import GridSegment


class ColourGrid:
    """The colours of a scene's only medium, from a `gridvolume` on its cells.

    Args:
        volume: the value of the integrator's property `colour`.

    Raises:
        RuntimeError: it is no `gridvolume` of three channels that interpolates linearly.
    """

    def __init__(self, volume: mi.Object) -> None:
        self.volume = volume
        self._parameters = mi.traverse(volume) if isinstance(volume, mi.Volume) else {}
        if "data" not in self._parameters or self._parameters["data"].shape[3] != 3:
            raise RuntimeError('emission_absorption: "colour" must be a `gridvolume` of three channels')
        self._transform = probe_transform(volume)

    def give_to(self, media: SceneMedia) -> None:
        """Let the medium emit in the current colours.

        Raises:
            RuntimeError: there are several media, or the cells of the only one are others, or it has three channels.
        """
        medium, colour = media.media[0], self._parameters["data"]
        if len(media.media) > 1 or not isinstance(medium, GridMedium) or medium.channels > 1:
            raise RuntimeError(
                'emission_absorption: with "colour", the scene must have one medium, `heterogeneous`, with one channel '
                "of extinction"
            )
        same = np.allclose(self._transform.matrix, medium.transform.matrix, rtol=1e-4, atol=1e-6)
        same = same and np.allclose(self._transform.centre, medium.transform.centre, rtol=1e-4, atol=1e-4)
        if tuple(colour.shape[:3]) != medium.grid_shape or not same:
            raise RuntimeError(
                f'emission_absorption: "colour" has {tuple(colour.shape[:3])} cells, the extinction '
                f"{medium.grid_shape}; both need the same resolution and the same to_world"
            )
        medium.colour = colour


class ColouredSegment(GridSegment):
    """A segment in a grid of grey extinction that emits in colour; radiances are colours."""

    def radiance(self) -> tuple[mi.Color3f, mi.Float]:
        """What the segments show in front of black, and their transmittance T."""
        march, quadrature = GridMarch(self.medium, self.lattice), self.quadrature
        h, zeros, colours = self.lattice.step, march.zeros(), self._colours()

        def emit(stencil: ClampedStencil, τ: Any, W: Any, c: Any, P: Any) -> tuple:
            σ, colour = march.extinction(march.σ_t, stencil), _colour(colours, stencil)
            τ = τ + h * σ
            return τ, quadrature.white(W, h, σ, τ), colour, P + (colour - c) * W

        state = (zeros, zeros, mi.Color3f(zeros), mi.Color3f(zeros))
        if quadrature.shows_empty_space:
            τ, W, c, P = march.visit(state, lambda _, *rest: emit(*rest), "coloured emission_absorption")
        else:
            τ, W, c, P = march.visit_smoke(state, emit, "coloured emission_absorption")
        return (c * W - P) * quadrature.unit(self.lattice), dr.exp(-τ)

    def tangent(self) -> tuple[mi.Color3f, mi.Float, mi.Float]:
        """Derivative of that radiance along the tangents of extinction and colour, T, and the derivative of T."""
        march, quadrature = GridMarch(self.medium, self.lattice), self.quadrature
        h, zeros, colours = self.lattice.step, march.zeros(), self._colours()
        with dr.resume_grad():
            σ_dot, colours_dot = dr.grad(self.medium.extinction), dr.grad(self.medium.colour).array

        def visit(_: mi.UInt32, stencil: ClampedStencil, τ: Any, τ_dot: Any, W: Any, W_dot: Any, L_dot: Any) -> tuple:
            σ, δσ = march.extinction(march.σ_t, stencil), march.extinction(σ_dot, stencil)
            c, c_dot = _colour(colours, stencil), _colour(colours_dot, stencil)
            τ, τ_dot = τ + h * σ, τ_dot + h * δσ
            after, after_dot = quadrature.white(W, h, σ, τ), quadrature.white_tangent(W_dot, h, σ, τ, δσ, τ_dot)
            return τ, τ_dot, after, after_dot, L_dot + c_dot * (after - W) + c * (after_dot - W_dot)

        state = (zeros, zeros, zeros, zeros, mi.Color3f(zeros))
        τ, τ_dot, _, _, L_dot = march.visit(state, visit, "coloured emission_absorption tangent")
        T = dr.exp(-τ)
        return L_dot * quadrature.unit(self.lattice), T, -T * τ_dot

    def scatter_adjoint(
        self, L: Any, δL: mi.Spectrum, behind: mi.Spectrum | None, together: RaysTogether | None
    ) -> None:
        """Accumulate δL · ∂L/∂σ_t and δL · ∂L/∂c into the gradients of the extinction and of the colour."""
        # `RBIntegrator` suspends derivatives around this function.
        with dr.resume_grad():
            of_extinction, of_colour = (dr.grad_enabled(x) for x in (self.medium.extinction, self.medium.colour))
        if not of_extinction and not of_colour:
            return
        L, δL = mi.Color3f(mi.Spectrum(L)), mi.Color3f(δL)
        if together is not None:
            self._back_project(L, δL, of_extinction, of_colour, together)
        else:
            self._splat(L, δL, of_extinction, of_colour)

    def _back_project(
        self, L: mi.Color3f, δL: mi.Color3f, of_extinction: bool, of_colour: bool, together: RaysTogether
    ) -> None:
        """Store the adjoints of all samples, and let each voxel gather its own: one array of values per channel."""
        count = int(of_extinction) + 3 * int(of_colour)
        projections = [back_projection(self.medium, self.lattice, together) for _ in range(count)]

        def deposit(k: mi.UInt32, _: ClampedStencil, δσ: mi.Float, δc: mi.Color3f) -> None:
            values = [*([δσ] if of_extinction else []), *(δc if of_colour else [])]
            for projection, value in zip(projections, values, strict=True):
                projection.store(k, value)

        self._adjoint(L, δL, deposit)
        totals = [dr.zeros(mi.Float, int(np.prod(self.medium.grid_shape))) for _ in projections]
        for projection, total in zip(projections, totals, strict=True):
            projection.add_to(total)
        if of_extinction:
            _accumulate(self.medium.extinction, totals[0])
        if of_colour:
            _accumulate(self.medium.colour, dr.ravel(mi.Color3f(*totals[-3:])))

    def _splat(self, L: mi.Color3f, δL: mi.Color3f, of_extinction: bool, of_colour: bool) -> None:
        """Add the adjoint of every sample to the cells around it."""
        medium, lattice, cells = self.medium, self.lattice, int(np.prod(self.medium.grid_shape))
        addends, limit = dr.width(lattice.count) * lattice.longest, self.quadrature.limit(lattice)
        brightest = dr.maximum(largest_magnitude(self._colours()), 1) * limit
        bound = dr.max(dr.sum(dr.abs(δL) * (2 * brightest + dr.abs(L))) * lattice.step) * dr.abs(opaque(medium.scale))
        extinctions = RepeatableSum(cells, bound, addends)
        colours = RepeatableSum(3 * cells, dr.max(dr.max(dr.abs(δL)) * limit), addends)

        def deposit(_: mi.UInt32, stencil: ClampedStencil, δσ: mi.Float, δc: mi.Color3f) -> None:
            if of_extinction:
                stencil.splat(extinctions, δσ)
            if of_colour:
                stencil.splat(colours, δc)

        self._adjoint(L, δL, deposit)
        if of_extinction:
            _accumulate(medium.extinction, extinctions.result())
        if of_colour:
            _accumulate(medium.colour, colours.result())

    def _adjoint(self, L: mi.Color3f, δL: mi.Color3f, deposit: Any) -> None:
        """Call `deposit(k, stencil, Σ δL ∂L/∂σ_k, δL ∂L/∂c_k)` for every sample, the sum over the channels.

        As in the grey march, ∂L/∂σ_k is what sample k emits towards the sensor minus what it absorbs of everything at
        and behind it, L − S_k; ∂L/∂c_k is its share w_k.
        """
        march, quadrature = GridMarch(self.medium, self.lattice), self.quadrature
        h, zeros, unit, colours = self.lattice.step, march.zeros(), quadrature.unit(self.lattice), self._colours()

        def visit(k: mi.UInt32, stencil: ClampedStencil, τ: Any, T: Any, W: Any, S: Any) -> tuple:
            # Empty space, too, has a derivative: it could emit and absorb.
            σ, c = march.extinction(march.σ_t, stencil), _colour(colours, stencil)
            τ = τ + h * σ
            after, white = dr.exp(-τ), quadrature.white(W, h, σ, τ)
            share = (white - W) * unit
            δσ = dr.sum(δL * (c * (quadrature.gain(T, after) * unit) + S - L)) * h * march.scale
            deposit(k, stencil, δσ, δL * share)
            return τ, after, white, S + c * share

        march.visit((zeros, zeros + 1, zeros, mi.Color3f(zeros)), visit, "coloured emission_absorption adjoint")

    def _colours(self) -> mi.Float:
        return dr.detach(self.medium.colour).array


def _colour(colours: mi.Float, stencil: ClampedStencil) -> mi.Color3f:
    return mi.Color3f(*stencil.value(stencil.read(colours, 3)))


def _accumulate(tensor: mi.TensorXf, gradient: mi.Float) -> None:
    with dr.resume_grad():
        dr.accum_grad(tensor, mi.TensorXf(gradient, tuple(tensor.shape)))
