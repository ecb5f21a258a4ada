"""Advection against Mantaflow's own step, a numpy oracle, closed forms, and finite differences."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from fields import blob, directional_error, smooth_noise

import tnst_mi
from tnst_mi.fields.advection import METHODS, revert_mask, step
from tnst_mi.fields.potentials import PotentialVelocity

SHAPE = (9, 12, 7)


def interpolate(field: np.ndarray, points: np.ndarray, outside: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Oracle: trilinear value, and the smallest and largest of the eight cells, at points (…, 3) in (x, y, z)."""
    low = np.floor(points).astype(int)
    t = points - low
    value = np.zeros(points.shape[:-1])
    corners = []
    for corner in np.ndindex(2, 2, 2):
        cell = low + corner
        last = np.array(field.shape[2::-1]) - 1
        inside = ((cell >= 0) & (cell <= last)).all(-1)
        x, y, z = np.moveaxis(np.clip(cell, 0, last), -1, 0)
        sample = field[z, y, x] * (inside if outside == "zero" else 1)
        corners.append(sample)
        value += np.prod(np.where(corner, t, 1 - t), -1) * sample
    return value, np.min(corners, 0), np.max(corners, 0)


def oracle(field: np.ndarray, v: np.ndarray, method: str, h: float, outside: str) -> np.ndarray:
    field, v = field.astype(np.float64), v.astype(np.float64)
    z, y, x = np.meshgrid(*(np.arange(n) for n in field.shape), indexing="ij")
    here = np.stack([x, y, z], -1)
    forward, low, high = interpolate(field, here - v / h, outside)
    if method == "semi_lagrangian":
        return forward
    backward, _, _ = interpolate(forward, here + v / h, outside)
    result = forward + (field - backward) / 2
    if method == "maccormack":
        result = np.where((result < low) | (result > high), forward, result)
    return result


@pytest.mark.parametrize("outside", ["zero", "edge"])
@pytest.mark.parametrize("method", METHODS)
def test_against_numpy(method: str, outside: str) -> None:
    rng = np.random.default_rng(1)
    field, v = smooth_noise(rng, *SHAPE), 2.5 * smooth_noise(rng, *SHAPE, 3)
    expected = oracle(field, v, method, 1.3, outside)
    result = tnst_mi.advect(field, v, method, 1.3, outside)
    if method == "maccormack":
        # A value within rounding of the limit may fall on either side of the switch.
        assert (np.abs(result - expected) > 1e-5).mean() < 1e-3
    else:
        np.testing.assert_allclose(result, expected, atol=2e-6)


def test_reproduces_mantaflow(asset) -> None:
    """Mantaflow's own MacCormack step (clamp mode 2), where its stored step is complete."""
    with np.load(asset("data/smokejet/exact_step.npz")) as data:
        density0, density1, v, valid = (data[k] for k in ("density0", "density1", "velocity0", "valid"))
    error = (tnst_mi.advect(density0, v, "maccormack") - density1)[valid]
    assert np.sqrt(np.mean(error**2)) <= 1e-6
    assert np.sqrt(np.mean((density0 - density1)[valid] ** 2)) > 5e-2


@pytest.mark.parametrize("method", METHODS)
def test_zero_velocity_is_the_identity(method: str) -> None:
    rng = np.random.default_rng(2)
    field = smooth_noise(rng, *SHAPE)
    np.testing.assert_array_equal(tnst_mi.advect(field, np.zeros((*SHAPE, 3)), method), field)


@pytest.mark.parametrize("method", METHODS)
def test_positive_velocity_moves_towards_positive_axes(method: str) -> None:
    """A whole-cell displacement is an exact shift, with zeros entering."""
    rng = np.random.default_rng(3)
    field = np.abs(smooth_noise(rng, *SHAPE))
    moved = tnst_mi.advect(field, np.broadcast_to([2.0, 1.0, -1.0], (*SHAPE, 3)), method)
    expected = np.zeros_like(field)
    expected[:-1, 1:, 2:] = field[1:, :-1, :-2]
    inner = (slice(2, -2), slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(moved[inner], expected[inner], atol=1e-6)


def test_maccormack_converges_at_second_order_and_semi_lagrangian_at_first() -> None:
    """Rotating a blob there and back, at a fixed CFL number: the error order in the cell size."""
    errors = {method: [] for method in METHODS}
    for n in (16, 32, 64):
        field = blob((1, n, n), (0.5 * n, 0.62 * n, 0), 0.09 * n)
        _, y, x = np.meshgrid(np.arange(1), np.arange(n), np.arange(n), indexing="ij")
        centre, speed = (n - 1) / 2, 2 * np.pi / (4 * n)
        v = np.stack([-(y - centre) * speed, (x - centre) * speed, 0 * x], -1).astype(np.float32)
        for method in METHODS:
            moved = field
            for sign in [1] * (n // 4) + [-1] * (n // 4):
                moved = tnst_mi.advect(moved, sign * v, method)
            errors[method].append(np.abs(moved - field).mean() / field.mean())
    order = {method: np.log2(e[-2] / e[-1]) for method, e in errors.items()}
    assert order["maccormack_unlimited"] > 1.7
    assert order["maccormack"] > 1.5
    assert 0.4 < order["semi_lagrangian"] < 1.4


def test_limiter_keeps_the_range_and_unlimited_is_linear() -> None:
    rng = np.random.default_rng(4)
    a, b = (rng.random(SHAPE).astype(np.float32) for _ in range(2))
    v = 2 * smooth_noise(rng, *SHAPE, 3)
    limited = tnst_mi.advect(a, v)
    assert limited.min() >= 0 and limited.max() <= a.max()
    apply = lambda f: tnst_mi.advect(f, v, "maccormack_unlimited").astype(np.float64)  # noqa: E731
    np.testing.assert_allclose(apply(2 * a - 3 * b), 2 * apply(a) - 3 * apply(b), atol=5e-6)
    assert np.abs(apply(a).clip(0, 1) - limited).max() > 1e-3


def test_vector_fields_are_advected_by_component_without_the_limiter() -> None:
    rng = np.random.default_rng(5)
    field, v = smooth_noise(rng, *SHAPE, 3), smooth_noise(rng, *SHAPE, 3)
    for method in METHODS:
        together = tnst_mi.advect(field, v, method, outside="edge")
        apart = [tnst_mi.advect(field[..., c].copy(), v, method, outside="edge") for c in range(3)]
        np.testing.assert_allclose(together, np.stack(apart, -1), atol=1e-6)


def test_steps_are_full_steps_of_a_part_of_the_velocity() -> None:
    rng = np.random.default_rng(6)
    field, v = smooth_noise(rng, *SHAPE), 3 * smooth_noise(rng, *SHAPE, 3)
    expected = field
    for _ in range(3):
        expected = tnst_mi.advect(expected, v / 3)
    np.testing.assert_allclose(tnst_mi.advect(field, v, steps=3), expected, atol=1e-6)
    fastest = np.linalg.norm(v, axis=-1).max()
    for h in (1.0, 1.8):
        count = int(np.ceil(fastest / h))
        np.testing.assert_array_equal(
            tnst_mi.advect(field, v, h=h, steps="auto"), tnst_mi.advect(field, v, h=h, steps=count)
        )


@pytest.mark.parametrize("steps", [1, 3])
@pytest.mark.parametrize("outside", ["zero", "edge"])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("channels", [1, 3])
def test_backward_is_the_transpose_of_forward(channels: int, method: str, outside: str, steps: int) -> None:
    rng = np.random.default_rng(7)
    shape = SHAPE if channels == 1 else (*SHAPE, 3)
    values, v_values = smooth_noise(rng, *shape), 2 * smooth_noise(rng, *SHAPE, 3)
    tangents = smooth_noise(rng, *shape), smooth_noise(rng, *SHAPE, 3)
    w = smooth_noise(rng, *shape)

    field, v = mi.TensorXf(values), mi.TensorXf(v_values)
    dr.enable_grad(field, v)
    result = tnst_mi.advect(field, v, method, 1.3, outside, steps)
    dr.backward(dr.sum(result * mi.TensorXf(w), axis=None))
    adjoint = (dr.grad(field).numpy() * tangents[0]).sum() + (dr.grad(v).numpy() * tangents[1]).sum()

    field, v = mi.TensorXf(values), mi.TensorXf(v_values)
    dr.enable_grad(field, v)
    dr.set_grad(field, mi.TensorXf(tangents[0]))
    dr.set_grad(v, mi.TensorXf(tangents[1]))
    tangent = dr.forward_to(tnst_mi.advect(field, v, method, 1.3, outside, steps)).numpy()
    assert (tangent * w).sum() == pytest.approx(adjoint, rel=2e-5, abs=2e-5)


@pytest.mark.parametrize("wrt", ["field", "velocity"])
@pytest.mark.parametrize("method", ["semi_lagrangian", "maccormack"])
def test_gradient_against_central_differences(method: str, wrt: str) -> None:
    """16 random smooth directions; the limiter's choice is held at the base point."""
    rng = np.random.default_rng(8)
    shape = (12, 16, 12)
    field, v = smooth_noise(rng, *shape), 1.5 * smooth_noise(rng, *shape, 3, passes=4)
    w = smooth_noise(rng, *shape)
    reverted = revert_mask(mi.TensorXf(field), mi.TensorXf(v)) if method == "maccormack" else None

    def objective(point: np.ndarray) -> float:
        f, u = (point, v) if wrt == "field" else (field, point)
        result = step(mi.TensorXf(f), mi.TensorXf(u), method, reverted=reverted)
        return float((result.numpy().astype(np.float64) * w).sum())

    leaf = mi.TensorXf(field if wrt == "field" else v)
    dr.enable_grad(leaf)
    operands = (leaf, mi.TensorXf(v)) if wrt == "field" else (mi.TensorXf(field), leaf)
    dr.backward(dr.sum(step(*operands, method, reverted=reverted) * mi.TensorXf(w), axis=None))
    directions = [smooth_noise(rng, *leaf.shape, passes=4) for _ in range(16)]
    error = directional_error(objective, dr.grad(leaf).numpy(), leaf.numpy(), directions, 4e-3)
    assert error <= 1e-2
    if reverted is not None:
        assert 0.005 < reverted.numpy().mean() < 0.5


def smoke_in_air(rng: np.random.Generator, shape: tuple[int, int, int]) -> np.ndarray:
    """A ball of noise with nothing around it."""
    density = np.zeros(shape, np.float32)
    inner = tuple(slice(n // 4, -(n // 4)) for n in shape)
    density[inner] = np.abs(smooth_noise(rng, *density[inner].shape))
    return density


@pytest.mark.parametrize("outside", ["zero", "edge"])
def test_air_that_is_left_out_has_no_part_in_the_gradient(outside: str) -> None:
    """∂/∂v is computed near smoke only; with the limiter's choice given, or the field differentiated, everywhere."""
    rng = np.random.default_rng(10)
    shape = (16, 20, 14)
    density, v = smoke_in_air(rng, shape), 1.5 * smooth_noise(rng, *shape, 3)
    w = mi.TensorXf(smooth_noise(rng, *shape))
    reverted = revert_mask(mi.TensorXf(density), mi.TensorXf(v), 1.0, outside)
    results = []
    for choice, field_varies in ((None, False), (None, True), (reverted, False)):
        d, u = mi.TensorXf(density), mi.TensorXf(v)
        dr.enable_grad(u, *([d] if field_varies else []))
        result = step(d, u, "maccormack", 1.0, outside, choice)
        dr.backward(dr.sum(result * w, axis=None))
        results.append((result.numpy(), dr.grad(u).numpy()))
    (moved, gradient), *everywhere = results
    for expected, expected_gradient in everywhere:
        np.testing.assert_array_equal(moved, expected)
        np.testing.assert_allclose(gradient, expected_gradient, atol=2e-6 * np.abs(gradient).max())
    assert 0.1 < gradient.any(-1).mean() < 0.9


@pytest.mark.parametrize("value", [0.0, 0.7])
def test_a_constant_field_stays_and_its_velocity_has_no_gradient(value: float) -> None:
    v_values = 2 * smooth_noise(np.random.default_rng(11), *SHAPE, 3)
    for field_varies in (False, True):
        field, v = mi.TensorXf(np.full(SHAPE, value, np.float32)), mi.TensorXf(v_values)
        dr.enable_grad(v, *([field] if field_varies else []))
        moved = tnst_mi.advect(field, v, outside="edge")
        np.testing.assert_array_equal(moved.numpy(), np.float32(value))
        dr.backward(dr.sum(moved, axis=None))
        assert not dr.grad(v).numpy().any()
    assert dr.grad(field).numpy().sum() == pytest.approx(np.prod(SHAPE), rel=1e-5)


@pytest.mark.parametrize("names", [("phi",), ("psi",), ("phi", "psi")])
def test_velocity_of_potentials_need_not_be_stored(names: tuple[str, ...]) -> None:
    """The step that differentiates the potentials itself, in both directions, against `velocity` and `advect`."""
    rng = np.random.default_rng(12)
    density, lam, h = smoke_in_air(rng, SHAPE), 0.4, 1.3
    values = {name: 4 * smooth_noise(rng, *SHAPE, *([3] if name == "psi" else [])) for name in names}
    w, tangent = smooth_noise(rng, *SHAPE), smooth_noise(rng, *SHAPE)

    def through(fused: bool) -> tuple[list[np.ndarray], np.ndarray]:
        def moved(potentials: dict[str, mi.TensorXf]) -> mi.TensorXf:
            phi, psi = potentials.get("phi"), potentials.get("psi")
            if fused:
                return step(mi.TensorXf(density), PotentialVelocity(phi, psi, lam, h), h=h)
            return tnst_mi.advect(mi.TensorXf(density), tnst_mi.velocity(phi, psi, lam, h), h=h)

        potentials = {name: mi.TensorXf(value) for name, value in values.items()}
        dr.enable_grad(potentials)
        result = moved(potentials)
        dr.backward(dr.sum(result * mi.TensorXf(w), axis=None))
        arrays = [result.numpy(), *(dr.grad(potential).numpy() for potential in potentials.values())]

        potentials = {name: mi.TensorXf(value) for name, value in values.items()}
        dr.enable_grad(potentials)
        first = potentials[names[0]]
        dr.set_grad(first, mi.TensorXf(tangent if names[0] == "phi" else np.stack([tangent] * 3, -1)))
        return arrays, dr.forward_to(moved(potentials)).numpy()

    (fused, fused_tangent), (stored, stored_tangent) = through(True), through(False)
    for ours, expected in zip([*fused, fused_tangent], [*stored, stored_tangent], strict=True):
        np.testing.assert_allclose(ours, expected, atol=5e-6 * np.abs(expected).max())
        assert np.abs(expected).max() > 1e-3


def test_gradient_has_the_same_bits_in_every_run() -> None:
    rng = np.random.default_rng(9)
    shape = (32, 48, 32)
    field, v = rng.random(shape).astype(np.float32), 3 * smooth_noise(rng, *shape, 3)
    results = set()
    for _ in range(10):
        f, u = mi.TensorXf(field), mi.TensorXf(v)
        dr.enable_grad(f, u)
        dr.backward(dr.sum(dr.square(tnst_mi.advect(f, u, steps=2)), axis=None))
        results.add(dr.grad(f).numpy().tobytes() + dr.grad(u).numpy().tobytes())
    assert len(results) == 1


@pytest.mark.parametrize(
    "change",
    [
        {"method": "upwind"},
        {"outside": "wrap"},
        {"h": 0.0},
        {"steps": 0},
        {"steps": "many"},
        {"steps": True},
        {"field": np.zeros((3, 3, 4))},
        {"v": np.zeros((3, 3, 3, 2))},
    ],
)
def test_bad_arguments_are_named(change: dict) -> None:
    arguments = {"field": np.zeros((3, 3, 3)), "v": np.zeros((3, 3, 3, 3))} | change
    with pytest.raises(tnst_mi.InputError, match=r"advect: .*expected"):
        tnst_mi.advect(**arguments)


@pytest.mark.parametrize("channels", [(), (3,)])
def test_processing_all_cells_gives_what_processing_those_that_vary_gives(
    channels: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a GPU, and as on a CPU; most cells are empty."""
    rng = np.random.default_rng(18)
    field = smooth_noise(rng, *SHAPE, *channels)
    field = np.maximum(field - np.quantile(field, 0.8), 0)
    v, weights = 2.5 * smooth_noise(rng, *SHAPE, 3), smooth_noise(rng, *SHAPE, *channels)
    found = {}
    for everywhere in (False, True):
        monkeypatch.setattr("tnst_mi.fields.maccormack.on_gpu", lambda everywhere=everywhere: everywhere)
        velocity = mi.TensorXf(v)
        dr.enable_grad(velocity)
        result = step(mi.TensorXf(field), velocity)
        dr.set_grad(result, mi.TensorXf(weights))
        dr.enqueue(dr.ADMode.Backward, result)
        dr.traverse(dr.ADMode.Backward)
        found[everywhere] = dr.detach(result).numpy(), dr.grad(velocity).numpy()
    for one, other in zip(found[False], found[True], strict=True):
        np.testing.assert_array_equal(one, other)
