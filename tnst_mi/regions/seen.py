"""Smoke and regions as they are seen in images: how opaque a pixel is, and whose smoke that is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.kernels import opaque
from tnst_mi.rendering.cameras.views import View
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

#: Opacity that is added to that of a pixel before it divides: the faintest smoke counts as less than all of a pixel.
_FAINT = 1e-3


class Seen(NamedTuple):
    """Images (V, rows, columns) of what is seen of smoke, in [0, 1].

    Attributes:
        opacity: 1 − T, with the transmittance T through all of the smoke.
        shares: for each mask, the share of a pixel's light that comes from its region.
    """

    opacity: mi.TensorXf
    shares: list[mi.TensorXf]


def seen_in_views(
    density: mi.TensorXf, masks: Sequence[mi.TensorXf], views: Sequence[View], renderer: EmissionAbsorptionRenderer
) -> Seen:
    """The opacity Σ a_k, a_k = T_k (1 − exp(−γ h d_k)), and for each mask m the shares Σ m_k a_k / (Σ a_k + 0.001).

    a_k is the light of sample k that reaches the camera, times γ: what the samples of the exact quadrature add up to.
    Nothing is differentiated.

    Args:
        density: (D, H, W).
        masks: (D, H, W) each, in [0, 1].
        views: V pairs (azimuth, elevation) in degrees.
        renderer: of the images.
    """
    with dr.suspend_grad():
        march, step = renderer.march(dr.detach(density), views)
        sums = [march.zeros() for _ in masks]

        def visit(stencil, T, opacity, *sums):  # noqa: ANN202
            passed = T * dr.exp(-step * march.extinction(march.σ_t, stencil))
            light = T - passed
            of_masks = [
                total + light * stencil.value(stencil.read(mask.array, 1))[0]
                for total, mask in zip(sums, masks, strict=True)
            ]
            return passed, opacity + light, *of_masks

        state = (march.zeros() + 1, march.zeros(), *sums)
        _, opacity, *sums = march.visit_smoke(state, visit, "seen")
        size = len(views), *renderer.size
        shares = [mi.TensorXf(total / (opacity + opaque(_FAINT)), size) for total in sums]
        dr.eval(opacity, shares)
        return Seen(mi.TensorXf(opacity, size), shares)
