"""Temporal coherence: fields of neighbouring frames, transported to one frame and averaged (paper Eq. 8 and 9).

T_i^t(f_i) transports a field from frame i to frame t along the simulation's velocities: by u_j from frame j to frame
j + 1, and by −u_j back. The transport is MacCormack without a limiter, which is linear, so that the windowed sum

    Σ_i ω_|i−t| T_i^t(f_i),    i = t − w … t + w,

can be nested: the contributions of the past are accumulated on the way to t, and so are those of the future. This takes
2w transports per frame, where a sum term by term takes w (w + 1). Vector potentials are transported component by
component, as in the paper: they move with the smoke but are neither rotated nor stretched by it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.fields.advection import step
from tnst_mi.fields.grid import Shape
from tnst_mi.fields.kernels import opaque

#: Below this share of smoke an average over smoke is meaningless, and the frame's own mask is practically 0.
_LEAST_SHARE = 1e-6

#: Mask below which there is no smoke of which there could be an average.
_LEAST_MASK = 1e-4


def transported_sums(
    own: dict[str, mi.TensorXf],
    weights: np.ndarray,
    window: range,
    frame: int,
    neighbours: Iterator[tuple[dict[str, mi.TensorXf], mi.TensorXf]],
    h: float,
) -> dict[str, mi.TensorXf]:
    """Σ_i ω_|i−t| T_i^t(f_i) over a window, nested, for fields that share their transport.

    Args:
        own: fields of frame t itself by name, (D, H, W) or (D, H, W, 3).
        weights: ω by distance, see `window_weights`.
        window: the frames i, including t.
        frame: t.
        neighbours: for each frame in `reading_order`, its fields, and the velocity (D, H, W, 3) in full-resolution
            cells per frame between it and the next frame towards t: u_i for the past, u_{i−1} for the future.
        h: size of a cell in full-resolution cells.

    Returns:
        The sums by name, in the shapes of `own`.
    """
    totals = {name: field * opaque(weights[0]) for name, field in own.items()}
    for side, direction in ((range(window.start, frame), 1.0), (range(window.stop - 1, frame, -1), -1.0)):
        carried: dict[str, mi.TensorXf] = {}
        for i in side:
            fields, velocity = next(neighbours)
            displacement = velocity * opaque(direction)
            for name, field in fields.items():
                weighted = field * opaque(weights[abs(i - frame)])
                joined = carried[name] + weighted if name in carried else weighted
                carried[name] = step(joined, displacement, "maccormack_unlimited", h, "zero")
        for name, field in carried.items():
            totals[name] = totals[name] + field
    dr.eval(totals)
    return totals


def still_fields(names: Sequence[str], channels: Mapping[str, int], shape: Shape) -> dict[str, mi.TensorXf]:
    """The fields of a frame that stays unchanged, which counts as one without smoke: 0 everywhere.

    Args:
        names: of the fields.
        channels: of those that are vectors, 3.
        shape: (D, H, W).
    """
    return {
        name: mi.TensorXf(dr.zeros(mi.TensorXf, (*shape, 3) if channels.get(name) == 3 else shape)) for name in names
    }


def averaging_gain(mask: mi.TensorXf, transported_mask: mi.TensorXf, own_weight: float) -> mi.TensorXf:
    """Factor that turns a windowed sum of masked fields into the frame's mask times their average over smoke.

    m_t / Σ_i ω_i T_i^t(m_i): where smoke appears or leaves, the frames without it do not count. The sum is clamped to
    at least the frame's own share ω_0 m_t, since overshoots of the transport could push it below.

    Args:
        mask: m_t, (D, H, W) in [0, 1].
        transported_mask: the windowed sum of the masks.
        own_weight: ω_0.
    """
    share = dr.maximum(transported_mask.array, mask.array * opaque(own_weight))
    gain = dr.select(mask.array > 0, mask.array / dr.maximum(share, opaque(_LEAST_SHARE)), mi.Float(0))
    return mi.TensorXf(gain, tuple(mask.shape))


def unmasked(gain: mi.TensorXf, mask: mi.TensorXf) -> mi.TensorXf:
    """The gain for an average over smoke that is not masked itself: 1 / Σ_i ω_i T_i^t(m_i), 0 where there is no smoke.

    Args:
        gain: see `averaging_gain`.
        mask: m_t, (D, H, W) in [0, 1].
    """
    share = gain.array / dr.maximum(mask.array, opaque(_LEAST_MASK))
    return mi.TensorXf(dr.select(mask.array > _LEAST_MASK, share, mi.Float(0)), tuple(gain.shape))
