"""Regions as they are seen in images: the share of a pixel's light that comes from the smoke of a region."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from tnst_mi.fields.kernels import opaque
from tnst_mi.rendering.cameras.views import View
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

#: Opacity that is added to that of a pixel before it divides: the faintest smoke counts as less than all of a pixel.
_FAINT = 1e-3


def seen_shares(
    density: mi.TensorXf, masks: Sequence[mi.TensorXf], views: Sequence[View], renderer: EmissionAbsorptionRenderer
) -> list[mi.TensorXf]:
    """For each mask m the images (V, rows, columns) of Σ m_k a_k / (Σ a_k + 0.001), a_k = T_k (1 − exp(−γ h d_k)).

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
        shares = [mi.TensorXf(total / (opacity + opaque(_FAINT)), (len(views), *renderer.size)) for total in sums]
        dr.eval(shares)
        return shares
