"""Public functions answer in the array kind they were given, and stay differentiable in it."""

from __future__ import annotations

import inspect
from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import torch
from fields import smooth_noise

import tnst_mi
from tnst_mi.machine import backend

SHAPE = (5, 7, 6)
VIEWS = [(0.0, 0.0), (20.0, -10.0)]

_rng = np.random.default_rng(1)
SCALAR = np.abs(smooth_noise(_rng, *SHAPE)) + 0.1
VECTOR = smooth_noise(_rng, *SHAPE, 3)

#: Each public function as a function of one scalar and one vector field.
FUNCTIONS: dict[str, Callable] = {
    "velocity": lambda scalar, vector: tnst_mi.velocity(scalar, vector, 0.3),
    "advect": lambda scalar, vector: tnst_mi.advect(scalar, vector, steps=2),
    "render": lambda scalar, vector: tnst_mi.render(scalar, VIEWS, 0.5),
}


@pytest.fixture(params=FUNCTIONS)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


def reference(name: str) -> np.ndarray:
    return FUNCTIONS[name](SCALAR, VECTOR)


def weights(name: str) -> np.ndarray:
    return smooth_noise(np.random.default_rng(2), *reference(name).shape)


def drjit_gradients(name: str) -> list[np.ndarray]:
    leaves = [mi.TensorXf(SCALAR), mi.TensorXf(VECTOR)]
    dr.enable_grad(leaves)
    dr.backward(dr.sum(FUNCTIONS[name](*leaves) * mi.TensorXf(weights(name)), axis=None))
    return [dr.grad(leaf).numpy() for leaf in leaves]


def to_torch(array: np.ndarray, **options: object) -> torch.Tensor:
    return torch.tensor(array, device=backend.torch_device(), **options)


# --------------------------------------------------------------------
# numpy
# --------------------------------------------------------------------


def test_numpy_gives_numpy(name: str) -> None:
    result = reference(name)
    assert type(result) is np.ndarray
    assert result.dtype == np.float32
    assert np.abs(result).max() > 0.01


@pytest.mark.parametrize(
    "convert",
    [
        lambda a: a.astype(np.float64),
        np.asfortranarray,
        lambda a: np.repeat(a, 2, 1)[:, ::2],
        lambda a: a[::-1].copy()[::-1],
        lambda a: a.astype(">f4"),
        lambda a: a.tolist(),
        np.ma.array,
    ],
    ids=["float64", "Fortran order", "strided", "negative stride", "big endian", "lists", "subclass"],
)
def test_any_memory_layout_gives_the_same_result(name: str, convert: Callable) -> None:
    result = FUNCTIONS[name](convert(SCALAR), convert(VECTOR))
    assert type(result) is np.ndarray
    np.testing.assert_array_equal(result, reference(name))


def test_arguments_are_left_as_they_were(name: str) -> None:
    scalar, vector = SCALAR.copy(), VECTOR.copy()
    result = FUNCTIONS[name](scalar, vector)
    np.testing.assert_array_equal(scalar, SCALAR)
    np.testing.assert_array_equal(vector, VECTOR)
    before = result.copy()
    scalar[:] = vector[:] = 0
    np.testing.assert_array_equal(result, before)


# --------------------------------------------------------------------
# Dr.Jit
# --------------------------------------------------------------------


def test_drjit_gives_drjit_and_stays_attached(name: str) -> None:
    scalar, vector = mi.TensorXf(SCALAR), mi.TensorXf(VECTOR)
    detached = FUNCTIONS[name](scalar, vector)
    assert type(detached) is mi.TensorXf
    assert not dr.grad_enabled(detached)
    np.testing.assert_array_equal(detached.numpy(), reference(name))
    dr.enable_grad(scalar)
    assert dr.grad_enabled(FUNCTIONS[name](scalar, vector))


def test_a_drjit_and_a_numpy_array_together_give_drjit() -> None:
    v = mi.TensorXf(VECTOR)
    dr.enable_grad(v)
    result = tnst_mi.advect(SCALAR, v, steps=2)
    assert type(result) is mi.TensorXf
    assert dr.grad_enabled(result)
    np.testing.assert_array_equal(result.numpy(), reference("advect"))


def test_a_drjit_tensor_of_doubles_is_taken_in_single_precision() -> None:
    double = dr.float64_array_t(mi.TensorXf)(SCALAR.astype(np.float64))
    result = tnst_mi.render(double, VIEWS, 0.5)
    assert type(result) is mi.TensorXf
    np.testing.assert_array_equal(result.numpy(), reference("render"))


# --------------------------------------------------------------------
# torch
# --------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_torch_gives_torch(name: str, dtype: torch.dtype) -> None:
    scalar = to_torch(SCALAR, dtype=dtype)
    result = FUNCTIONS[name](scalar, to_torch(VECTOR, dtype=dtype))
    assert type(result) is torch.Tensor
    assert (result.dtype, result.device, result.requires_grad) == (torch.float32, scalar.device, False)
    np.testing.assert_array_equal(result.cpu().numpy(), reference(name))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_torch_autograd_gives_drjit_s_gradient(name: str, dtype: torch.dtype) -> None:
    leaves = [to_torch(array, dtype=dtype, requires_grad=True) for array in (SCALAR, VECTOR)]
    result = FUNCTIONS[name](*leaves)
    assert result.requires_grad
    (result * to_torch(weights(name))).sum().backward()
    for leaf, expected in zip(leaves, drjit_gradients(name), strict=True):
        if leaf.grad is None:  # `render` does not read the vector field.
            assert not expected.any()
            continue
        assert leaf.grad.dtype == dtype
        np.testing.assert_allclose(leaf.grad.cpu().numpy(), expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_a_strided_torch_tensor_has_its_gradient_in_its_own_layout() -> None:
    leaf = to_torch(np.ascontiguousarray(SCALAR.T), requires_grad=True)
    result = tnst_mi.render(leaf.permute(2, 1, 0), VIEWS, 0.5)
    np.testing.assert_array_equal(result.detach().cpu().numpy(), reference("render"))
    (result * to_torch(weights("render"))).sum().backward()
    expected = drjit_gradients("render")[0]
    np.testing.assert_allclose(leaf.grad.cpu().numpy().T, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_gradients_only_where_torch_asks_for_them() -> None:
    field, v = to_torch(SCALAR), to_torch(VECTOR, requires_grad=True)
    tnst_mi.advect(field, v).sum().backward()
    assert field.grad is None
    assert v.grad.abs().max() > 0
    with torch.no_grad():
        assert not tnst_mi.advect(field, v).requires_grad


def test_a_torch_chain_runs_through_all_three_functions() -> None:
    """The gradient of ∫ image over velocity and advection, against Dr.Jit's own chain."""
    phi = to_torch(SCALAR, requires_grad=True)
    field = to_torch(SCALAR)
    tnst_mi.render(tnst_mi.advect(field, tnst_mi.velocity(phi, None, 1.0)), VIEWS, 0.5).sum().backward()

    leaf = mi.TensorXf(SCALAR)
    dr.enable_grad(leaf)
    moved = tnst_mi.advect(mi.TensorXf(SCALAR), tnst_mi.velocity(leaf, None, 1.0))
    dr.backward(dr.sum(tnst_mi.render(moved, VIEWS, 0.5), axis=None))
    expected = dr.grad(leaf).numpy()
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(phi.grad.cpu().numpy(), expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_an_absent_potential_is_none_in_every_kind() -> None:
    expected = tnst_mi.velocity(None, VECTOR, 0.0)
    np.testing.assert_array_equal(tnst_mi.velocity(None, mi.TensorXf(VECTOR), 0.0).numpy(), expected)
    np.testing.assert_array_equal(tnst_mi.velocity(None, to_torch(VECTOR), 0.0).cpu().numpy(), expected)


def test_the_decorated_functions_keep_their_names_and_signatures() -> None:
    for name, parameters in (
        ("velocity", ["phi", "psi", "lam", "h"]),
        ("advect", ["field", "v", "method", "h", "outside", "steps", "trace", "stages", "conservative"]),
        ("render", ["density", "view", "gamma", "quadrature", "h", "fit", "camera", "size", "colour"]),
    ):
        function = getattr(tnst_mi, name)
        assert function.__name__ == name
        assert list(inspect.signature(function).parameters) == parameters
        assert "Args:" in function.__doc__
