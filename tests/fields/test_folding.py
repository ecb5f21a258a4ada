"""Where transport folds space: closed forms, and smoke that a step tears."""

from __future__ import annotations

import numpy as np
import pytest
from fields import smooth_noise

import tnst_mi
from tnst_mi.fields.folding import folded_share


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("steepness", "expected"), [(0.9, 0.0), (2.0, 1 / 3), (1e4, 0.5)])
def test_a_wave_folds_where_it_is_steeper_than_space(axis: int, steepness: float, expected: float) -> None:
    """x − a sin(kx) runs backwards where a k cos(kx) exceeds 1."""
    k = 2 * np.pi / 60
    v = np.zeros((3, 4, 240, 3), np.float32)
    v[..., axis] = steepness / k * np.sin(k * np.arange(240))
    # The wave runs along x, and then along the axis of its component of v.
    v = np.swapaxes(v, 2, 2 - axis)
    assert folded_share(np.ones(v.shape[:3], np.float32), v) == pytest.approx(expected, abs=0.03)
    if steepness < 1e4:
        # Paths do not cross, and here they do not come nearer to each other than cells can tell.
        assert folded_share(np.ones(v.shape[:3], np.float32), v, "flow", 16) == 0


def test_the_flow_folds_what_it_draws_out_more_finely_than_cells() -> None:
    """An eddy that turns its middle a full turn more than its rim winds up smoke in layers thinner than a cell."""
    y, x = np.mgrid[:40, :40] - 19.5
    angle = np.exp(-(x**2 + y**2) / 32)
    shares = []
    for turns in (0.05, 0.25, 4.0):
        v = np.zeros((1, 40, 40, 3), np.float32)
        v[0, ..., 0], v[0, ..., 1] = -2 * np.pi * turns * angle * y, 2 * np.pi * turns * angle * x
        shares.append(folded_share(np.ones((1, 40, 40), np.float32), v, "flow", 64))
    assert shares[0] == 0 and shares[0] <= shares[1] < 0.05 < shares[2]


def test_it_is_that_of_a_determinant_in_numpy() -> None:
    rng, shape = np.random.default_rng(1), (9, 12, 10)
    v, density = 15 * smooth_noise(rng, *shape, 3), np.abs(smooth_noise(rng, *shape))
    derivatives = [np.gradient(v[..., i].astype(np.float64), axis=(2, 1, 0)) for i in range(3)]
    jacobian = np.stack([np.stack(of, axis=-1) for of in derivatives], axis=-2)
    folded = np.linalg.det(np.eye(3) - jacobian) <= 0
    expected = density[folded].sum() / density.sum()
    assert 0.05 < expected < 0.6
    assert folded_share(density, v) == pytest.approx(expected, abs=2e-3)


def test_turns_and_stretches_do_not_fold() -> None:
    z, y, x = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in (8, 20, 22)), indexing="ij")
    density = np.ones(x.shape, np.float32)
    for v in (
        np.stack([-0.8 * y, 0.8 * x, 0 * z], -1),
        np.stack([0.6 * x, -0.6 * y, 0 * z], -1),
        np.ones((*x.shape, 3)),
    ):
        assert folded_share(density, v) == 0.0
    assert folded_share(0 * density, np.zeros((*x.shape, 3))) == 0.0


def test_a_step_that_folds_makes_smoke_twice() -> None:
    """Two pieces of one: a bar comes out in two copies where x − v(x) passes it twice."""
    density = np.zeros((1, 1, 60), np.float32)
    density[..., 28:32] = 1
    v = np.zeros((1, 1, 60, 3), np.float32)
    v[..., 0] = np.float32(14 * np.sin(2 * np.pi / 30 * (np.arange(60) - 30)))
    moved = tnst_mi.advect(density, v)
    bars = np.diff((moved[0, 0] > 0.5).astype(int)).clip(0).sum()
    assert bars > 1 and folded_share(moved, v) > 0.2
