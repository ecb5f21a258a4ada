"""The coherence step: the derivative of what it lessens, and that it lessens it."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from fields import blob, smooth_noise

from tnst_mi.fields.grid import Octave
from tnst_mi.optimisation.coherence import coherence_steps
from tnst_mi.optimisation.parameterisation import Transport

SHAPE = (10, 14, 12)


@pytest.fixture
def transport() -> Transport:
    transport = Transport(0.5)
    transport.enter(Octave(SHAPE, 1.8))
    rng = np.random.default_rng(1)
    transport.fields = {
        "phi": mi.TensorXf(4 * smooth_noise(rng, *SHAPE, passes=3)),
        "psi": mi.TensorXf(4 * smooth_noise(rng, *SHAPE, 3, passes=3)),
    }
    return transport


def test_change_comes_nearer_to_the_target(transport: Transport) -> None:
    """Ten small steps from one change towards another."""
    density = mi.TensorXf(blob(SHAPE, (5.5, 6.5, 4.5), 3))
    mask = mi.TensorXf(np.ones(SHAPE, np.float32))
    transport.fields = {name: 4 * field for name, field in transport.fields.items()}
    target = transport.density(density) - density
    transport.fields = {name: 0 * field for name, field in transport.fields.items()}
    distances = []
    for _ in range(10):
        change = transport.density(density) - density
        distances.append(np.linalg.norm((change - target).numpy()))
        transport.steps = coherence_steps(transport, density, mask, target, 0.01, 14, 3)
        transport.descend()
    assert (np.diff(distances) < 0).all()
    assert distances[-1] < 0.7 * distances[0]


def test_step_is_proportional_to_the_difference(transport: Transport) -> None:
    """Its direction is normalised; its length is that of a step of the stylization times the relative difference."""
    density = mi.TensorXf(blob(SHAPE, (5.5, 6.5, 4.5), 3))
    mask = mi.TensorXf(np.ones(SHAPE, np.float32))
    change = transport.density(density) - density
    other = mi.TensorXf(smooth_noise(np.random.default_rng(2), *SHAPE))
    steps = {}
    for share in (0.1, 0.2):
        found = coherence_steps(transport, density, mask, change + share * other, 0.02, 14, 3)
        steps[share] = {name: step.numpy() for name, step in found.items()}

    def size(share: float) -> float:
        return max(np.linalg.norm(change.numpy()), np.linalg.norm((change + share * other).numpy()))

    for name in ("phi", "psi"):
        np.testing.assert_allclose(2 * steps[0.1][name] * size(0.1), steps[0.2][name] * size(0.2), rtol=1e-3, atol=1e-6)
    settled = coherence_steps(transport, density, mask, change, 0.02, 14, 3)
    assert not any(step.numpy().any() for step in settled.values())
