"""`PathTracer` against closed forms: transmittances, derivatives, and what a tight majorant does to them."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from fields import blob, smooth_noise

from tnst_mi.compare.closed_form import column_density
from tnst_mi.compare.path_tracing import PathTracer, smoke_region
from tnst_mi.errors import InputError

SHAPE = (8, 12, 9)
VIEWS = [(0.0, 0.0), (35.0, 12.0)]
GAMMA = 0.4


def smoke() -> np.ndarray:
    """A density that does not vanish at the walls."""
    return np.abs(smooth_noise(np.random.default_rng(2), *SHAPE)) + 0.05


def transmittance(density: np.ndarray) -> np.ndarray:
    return np.exp(-GAMMA * np.stack([column_density(density, view) for view in VIEWS]))


@pytest.mark.parametrize("slack", [1.1, 2.0])
@pytest.mark.parametrize("density", [smoke(), blob(SHAPE, (3.0, 6.0, 4.0), 0.8) * (blob(SHAPE, (3, 6, 4), 1) > 0.2)])
def test_transmittance_is_unbiased(density: np.ndarray, slack: float) -> None:
    """The sum of z² over pixels has its expectation, and so has the sum of z: also where empty space is cut away."""
    spp, exact = 1024, transmittance(density)
    traced = PathTracer(density, VIEWS, GAMMA, slack).transmittance(spp, seed=3)
    assert traced.shape == (len(VIEWS), *SHAPE[1:])
    # Multiples of 1/spp; the weights of a GPU's paths are quotients with an error in their last bit.
    exact_quotients = mi.variant().startswith("llvm")
    np.testing.assert_allclose(traced * spp, np.rint(traced * spp), rtol=0 if exact_quotients else 2.0**-22, atol=0)
    testable = spp * exact * (1 - exact) >= 5
    assert testable.sum() > 20
    z = (traced - exact)[testable] / np.sqrt(exact * (1 - exact) / spp)[testable]
    assert abs(z.mean()) < 3.5 / np.sqrt(len(z))
    assert abs((z**2).mean() - 1) < 3.5 * np.sqrt(2 / len(z))
    assert np.abs(traced - exact)[~testable].max(initial=0) < 20 / spp


@pytest.mark.parametrize(("density", "gamma"), [(smoke(), 0.4), (blob(SHAPE, (4.0, 6.0, 4.0), 2.0), 1.0)])
def test_gradient_is_unbiased(density: np.ndarray, gamma: float) -> None:
    """The derivative of Σ w (1 − T)/γ along v is Σ w T ∫v: of any slack's estimate, the error is within its noise."""
    rng = np.random.default_rng(4)
    weights = smooth_noise(rng, *SHAPE[1:], len(VIEWS)).transpose(2, 0, 1)
    tracer = PathTracer(density, VIEWS, gamma)
    estimates = np.array([tracer.gradient(weights, 64, seed).astype(np.float64) for seed in range(16)])
    exact = np.exp(-gamma * np.stack([column_density(density, view) for view in VIEWS]))
    scores = []
    for _ in range(8):
        direction = np.zeros(SHAPE, np.float32)
        direction[tracer.region] = smooth_noise(rng, *SHAPE)[tracer.region]
        columns = np.stack([column_density(direction, view) for view in VIEWS])
        derivatives = (estimates * direction).sum((1, 2, 3))
        scores.append((derivatives.mean() - (weights * exact * columns).sum()) / (derivatives.std(ddof=1) / 4))
    assert np.abs(scores).max() < 4
    assert np.sqrt(np.mean(np.square(scores))) < 2


def test_a_tight_majorant_loses_the_gradient() -> None:
    """Why the majorant needs slack: null collisions alone carry the derivative, and uniform smoke has none."""
    density, weights = np.full(SHAPE, 0.5, np.float32), np.ones((1, *SHAPE[1:]), np.float32)
    expected = SHAPE[1] * SHAPE[2] * SHAPE[0] * np.exp(-GAMMA * 0.5 * SHAPE[0])
    tight, slack = (
        PathTracer(density, VIEWS[:1], GAMMA, slack).gradient(weights, 512, 0).sum(dtype=np.float64)
        for slack in (1.0, 2.0)
    )
    assert slack == pytest.approx(expected, rel=0.05)
    assert abs(tight) < 0.1 * expected


def test_seeds_decide_the_paths() -> None:
    tracer = PathTracer(smoke(), VIEWS, GAMMA)
    first, again, other = (tracer.transmittance(16, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.3


def test_the_region_holds_the_smoke_and_two_cells_around_it() -> None:
    density = np.zeros((10, 12, 14))
    density[4, 1:11, 6:8] = 1
    assert smoke_region(density) == (slice(2, 7), slice(0, 12), slice(4, 10))
    with pytest.raises(InputError, match="0 everywhere, expected smoke"):
        smoke_region(np.zeros(SHAPE))
