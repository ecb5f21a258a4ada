"""Velocity from potentials: closed forms, incompressibility, and the transposed stencil."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import torch
from fields import smooth_noise

import tnst_mi

SHAPE = (6, 9, 7)


def difference(field: np.ndarray, axis: int) -> np.ndarray:
    """The oracle: central differences, one-sided in the end cells, as numpy defines them."""
    return np.gradient(field, axis=axis, edge_order=1)


def test_linear_potential_moves_every_cell_alike() -> None:
    """Φ = a·x gives the velocity a everywhere, the end cells included (in full-resolution units for any h)."""
    h = 1.8
    z, y, x = np.meshgrid(*(np.arange(n) * h for n in SHAPE), indexing="ij")
    v = tnst_mi.velocity(0.5 * x - 2.0 * y + 3.0 * z, None, 1.0, h)
    np.testing.assert_allclose(v, np.broadcast_to([0.5, -2.0, 3.0], v.shape), atol=2e-5)


def test_against_numpy_gradient_and_curl() -> None:
    rng = np.random.default_rng(1)
    phi, psi, lam, h = smooth_noise(rng, *SHAPE), smooth_noise(rng, *SHAPE, 3), 0.3, 1.7
    grad = np.stack([difference(phi, axis) for axis in (2, 1, 0)], -1)
    dx, dy, dz = (lambda f, axis=axis: difference(f, axis) for axis in (2, 1, 0))
    px, py, pz = np.moveaxis(psi, -1, 0)
    curl = np.stack([dy(pz) - dz(py), dz(px) - dx(pz), dx(py) - dy(px)], -1)
    expected = (lam * grad + (1 - lam) * curl) / h
    np.testing.assert_allclose(tnst_mi.velocity(phi, psi, lam, h), expected, atol=1e-6)


def test_curl_has_no_divergence() -> None:
    """In velocity's own stencil the divergence of ∇×Ψ vanishes to rounding, in every cell and at the border."""
    rng = np.random.default_rng(2)
    v = tnst_mi.velocity(None, smooth_noise(rng, 12, 15, 10, 3, passes=0), 0.0).astype(np.float64)
    terms = [difference(v[..., c], 2 - c) for c in range(3)]
    assert np.abs(sum(terms)).max() <= 1e-6 * np.abs(terms).max()
    assert np.abs(terms).max() > 0.5


@pytest.mark.parametrize(("shape", "axis"), [((1, 8, 5), 2), ((8, 1, 5), 1), ((5, 8, 1), 0)])
def test_nothing_leaves_a_plane(shape: tuple[int, int, int], axis: int) -> None:
    """Along an axis of one cell there is no velocity, and what is left of ∇×Ψ has no divergence."""
    v = tnst_mi.velocity(None, smooth_noise(np.random.default_rng(7), *shape, 3), 0.0).astype(np.float64)
    assert not v[..., axis].any() and np.abs(v).max() > 0.05
    divergence = sum(difference(v[..., c], 2 - c) for c in range(3) if c != axis)
    assert np.abs(divergence).max() < 1e-6


def test_gradient_has_no_curl_for_lambda_one() -> None:
    rng = np.random.default_rng(3)
    v = tnst_mi.velocity(smooth_noise(rng, *SHAPE), None, 1.0)
    assert np.abs(difference(v[..., 1], 2) - difference(v[..., 0], 1)).max() < 1e-6


@pytest.mark.parametrize("lam", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("shape", [SHAPE, (1, 8, 5), (2, 2, 2), (3, 1, 4)])
def test_backward_is_the_transpose_of_forward(lam: float, shape: tuple[int, int, int]) -> None:
    """⟨J x, w⟩ = ⟨x, Jᵀ w⟩: the gather-form adjoint against the map itself, also on axes of one and two cells."""
    rng = np.random.default_rng(4)
    phi, psi = mi.TensorXf(smooth_noise(rng, *shape)), mi.TensorXf(smooth_noise(rng, *shape, 3))
    w = rng.standard_normal((*shape, 3)).astype(np.float32)
    dr.enable_grad(phi, psi)
    v = tnst_mi.velocity(phi, psi, lam, 1.3)
    dr.backward(dr.sum(v * mi.TensorXf(w), axis=None))
    left = (v.numpy().astype(np.float64) * w).sum()
    right = (dr.grad(phi).numpy() * phi.numpy()).sum() + (dr.grad(psi).numpy() * psi.numpy()).sum()
    assert left == pytest.approx(right, rel=1e-5, abs=1e-5)


def test_forward_mode_is_the_map_of_the_tangent() -> None:
    rng = np.random.default_rng(5)
    phi, tangent = mi.TensorXf(smooth_noise(rng, *SHAPE)), smooth_noise(rng, *SHAPE)
    dr.enable_grad(phi)
    dr.set_grad(phi, mi.TensorXf(tangent))
    v = tnst_mi.velocity(phi, None, 1.0)
    np.testing.assert_array_equal(dr.forward_to(v).numpy(), tnst_mi.velocity(tangent, None, 1.0))


def test_torch_tensors_are_differentiated_by_torch() -> None:
    rng = np.random.default_rng(6)
    values = smooth_noise(rng, *SHAPE)
    phi = torch.tensor(values, requires_grad=True)
    tnst_mi.velocity(phi, None, 1.0).square().sum().backward()
    other = mi.TensorXf(values)
    dr.enable_grad(other)
    dr.backward(dr.sum(dr.square(tnst_mi.velocity(other, None, 1.0)), axis=None))
    np.testing.assert_array_equal(phi.grad.numpy(), dr.grad(other).numpy())


@pytest.mark.parametrize(
    ("phi", "psi", "lam", "h"),
    [
        (None, None, 1.0, 1.0),
        (np.zeros((3, 3)), None, 1.0, 1.0),
        (np.zeros((3, 3, 3)), np.zeros((3, 3, 4, 3)), 1.0, 1.0),
        (np.zeros((3, 3, 3)), None, 1.5, 1.0),
        (np.zeros((3, 3, 3)), None, 1.0, 0.0),
    ],
)
def test_bad_arguments_are_named(phi: object, psi: object, lam: float, h: float) -> None:
    with pytest.raises(tnst_mi.InputError, match=r"velocity: .*expected"):
        tnst_mi.velocity(phi, psi, lam, h)
