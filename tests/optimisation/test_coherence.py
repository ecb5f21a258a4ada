"""The coherence step: the derivative of what it lessens, and that it lessens it."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from fields import blob, smooth_noise

from tnst_mi.optimisation.items.state import Current, Inputs
from tnst_mi.optimisation.parameterisation import Fields
from tnst_mi.optimisation.plan import FramePlan, plan_of
from tnst_mi.optimisation.temporal.coherence import step_towards
from tnst_mi.recipe.recipe import Recipe

SHAPE = (10, 14, 12)
H = 1.8


@pytest.fixture
def frame() -> FramePlan:
    return plan_of(Recipe(tag=("net",), lam=0.5), ["a"], [1], [1.0], [1.0], SHAPE).frames[0]


@pytest.fixture
def fields() -> Fields:
    rng = np.random.default_rng(1)
    phi, psi = 4 * smooth_noise(rng, *SHAPE, passes=3), 4 * smooth_noise(rng, *SHAPE, 3, passes=3)
    return Fields(phi=mi.TensorXf(phi), psi=mi.TensorXf(psi))


def scaled(fields: Fields, factor: float) -> Fields:
    return Fields({name: factor * field for name, field in fields.items()})


def test_change_comes_nearer_to_the_target(frame: FramePlan, fields: Fields) -> None:
    """Ten small steps from one change towards another."""
    density = mi.TensorXf(blob(SHAPE, (5.5, 6.5, 4.5), 3))
    mask = mi.TensorXf(np.ones(SHAPE, np.float32))
    stylized = frame.parameterisation.density
    target = stylized(scaled(fields, 4), density, H) - density
    fields, distances = scaled(fields, 0), []
    for _ in range(10):
        change = stylized(fields, density, H) - density
        distances.append(np.linalg.norm((change - target).numpy()))
        fields = fields - step_towards(target, Current(frame, Inputs(density, mask), fields, 0), 0.01, 14, H)
    assert (np.diff(distances) < 0).all()
    assert distances[-1] < 0.7 * distances[0]


def test_step_is_proportional_to_the_difference(frame: FramePlan, fields: Fields) -> None:
    """Its direction is normalised; its length is that of a step of the stylization times the relative difference."""
    density = mi.TensorXf(blob(SHAPE, (5.5, 6.5, 4.5), 3))
    mask = mi.TensorXf(np.ones(SHAPE, np.float32))
    now = Current(frame, Inputs(density, mask), fields, 0)
    change = frame.parameterisation.density(fields, density, H) - density
    other = mi.TensorXf(smooth_noise(np.random.default_rng(2), *SHAPE))
    steps = {}
    for share in (0.1, 0.2):
        found = step_towards(change + share * other, now, 0.02, 14, H)
        steps[share] = {name: step.numpy() for name, step in found.items()}

    def size(share: float) -> float:
        return max(np.linalg.norm(change.numpy()), np.linalg.norm((change + share * other).numpy()))

    for name in ("phi", "psi"):
        np.testing.assert_allclose(2 * steps[0.1][name] * size(0.1), steps[0.2][name] * size(0.2), rtol=1e-3, atol=1e-6)
    settled = step_towards(change, now, 0.02, 14, H)
    assert not any(step.numpy().any() for step in settled.values())
