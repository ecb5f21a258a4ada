"""Transport and density offsets: units, octaves, and the step."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from fields import blob, smooth_noise

import tnst_mi
from tnst_mi.fields.grid import Octave, octaves
from tnst_mi.fields.pyramid import gaussian, normalise
from tnst_mi.fields.resampling import resample_density
from tnst_mi.optimisation.parameterisation import (
    LARGEST_DERIVATIVE,
    DensityOffset,
    Fields,
    Parameterisation,
    Transport,
    limited,
    normalised_step,
)

SHAPE = (16, 24, 20)
OCTAVE = Octave(SHAPE, 1.0)


def pulled_back(parameterisation: Parameterisation, weight: np.ndarray, density: np.ndarray, h: float = 1.0) -> Fields:
    """The gradient of ⟨weight, density*⟩ with respect to fields that are 0."""
    fields = parameterisation.zeros(Octave(SHAPE, h))
    _, pull_back = parameterisation.density_with_pullback(fields, mi.TensorXf(density), h)
    return pull_back(mi.TensorXf(weight))


@pytest.mark.parametrize(("lam", "names"), [(1.0, {"phi"}), (0.0, {"psi"}), (0.5, {"phi", "psi"})])
def test_absent_potentials_are_not_stored(lam: float, names: set[str]) -> None:
    fields = Transport(lam).zeros(OCTAVE)
    assert set(fields) == names
    assert not Transport(lam).velocity(fields, 1.0).numpy().any()


def test_zero_fields_leave_the_density_unchanged() -> None:
    density = blob(SHAPE, (9, 12, 8), 3)
    for parameterisation in (Transport(0.5), DensityOffset()):
        stylized = parameterisation.density(parameterisation.zeros(OCTAVE), mi.TensorXf(density), 1.0)
        np.testing.assert_array_equal(stylized.numpy(), density)


def test_velocity_keeps_its_meaning_across_octaves() -> None:
    """Displacement in full-resolution cells: the same physical motion before and after going up."""
    coarse, full = octaves((36, 54, 36), 2)
    transport = Transport(1.0)
    d, h, w = coarse.shape
    x = (np.arange(w) - (w - 1) / 2) * coarse.cell_size
    fields = Fields(phi=mi.TensorXf(np.broadcast_to(np.float32(1.5 * x), (d, h, w)).copy()))
    before = transport.velocity(fields, coarse.cell_size).numpy()
    after = transport.velocity(transport.carried(fields, coarse, full), full.cell_size).numpy()
    np.testing.assert_allclose(before[..., 0], 1.5, atol=1e-5)
    np.testing.assert_allclose(after[4:-4, 4:-4, 4:-4, 0], 1.5, atol=1e-4)


@pytest.mark.parametrize("cell_size", [1.0, 1.8])
def test_step_has_the_size_and_the_sign_of_the_recipe(cell_size: float) -> None:
    """One step changes Φ by η (H/2) h · mask · N(g): against N(g) of the same gradient, and downhill."""
    rng = np.random.default_rng(1)
    density, weight = blob(SHAPE, (9, 12, 8), 4), smooth_noise(rng, *SHAPE)
    mask, eta, rows = rng.random(SHAPE).astype(np.float32), 1e-4, 43
    transport = Transport(1.0)
    gradient = pulled_back(transport, weight, density, cell_size)
    direction = normalise(gaussian(gradient["phi"], 1.2), 3).numpy()
    step = normalised_step(gradient, mi.TensorXf(mask), eta * transport.unit_step(rows, cell_size), 3)
    fields = transport.zeros(Octave(SHAPE, cell_size)) - step
    np.testing.assert_allclose(
        fields["phi"].numpy(), -eta * rows / 2 * cell_size * mask * direction, rtol=1e-4, atol=1e-7
    )
    after = transport.density(fields, mi.TensorXf(density), cell_size).numpy()
    assert (after * weight).sum() < (density * weight).sum()


def test_step_of_a_vector_potential_is_masked_in_every_component() -> None:
    rng = np.random.default_rng(2)
    mask = np.zeros(SHAPE, np.float32)
    mask[4:12, 6:18, 5:15] = 1
    transport = Transport(0.0)
    gradient = pulled_back(transport, smooth_noise(rng, *SHAPE), blob(SHAPE, (9, 12, 8), 4))
    step = normalised_step(gradient, mi.TensorXf(mask), 0.002 * transport.unit_step(24, 1.0), 3)
    psi = (transport.zeros(OCTAVE) - step)["psi"].numpy()
    assert not psi[mask == 0].any()
    assert (np.abs(psi[mask == 1]).max(0) > 1e-4).all()


FLOW = {"trace": "flow", "stages": 3}


@pytest.mark.parametrize("keys", [{"substeps": 2}, FLOW, FLOW | {"conservative": True}])
@pytest.mark.parametrize("lam", [1.0, 0.4])
def test_pullback_is_the_transpose_of_the_tangent(lam: float, keys: dict) -> None:
    """⟨w, ∂d*/∂fields · δ⟩ = ⟨pull-back of w, δ⟩ by central differences, around fields that are not 0."""
    rng, transport = np.random.default_rng(4), Transport(lam, **keys)
    density = mi.TensorXf(blob(SHAPE, (9, 12, 8), 4))
    shapes = {name: SHAPE if c == 1 else (*SHAPE, c) for name, c in transport.channels.items()}
    fields, change = (
        Fields({name: mi.TensorXf(size * smooth_noise(rng, *shape, passes=4)) for name, shape in shapes.items()})
        for size in (2.0, 1.0)
    )
    weight = smooth_noise(rng, *SHAPE)
    _, pull_back = transport.density_with_pullback(fields, density, 1.0)
    found = pull_back(mi.TensorXf(weight))
    predicted = sum(float((found[name] * change[name]).numpy().astype(np.float64).sum()) for name in fields)

    def objective(size: float) -> float:
        moved = Fields({name: field + size * change[name] for name, field in fields.items()})
        return float((transport.density(moved, density, 1.0).numpy().astype(np.float64) * weight).sum())

    eps = 2e-3
    assert (objective(eps) - objective(-eps)) / (2 * eps) == pytest.approx(predicted, rel=3e-2)


def test_a_step_leaves_the_fields_it_starts_from_alone() -> None:
    transport = Transport(0.5)
    fields = transport.zeros(OCTAVE)
    ones = Fields({name: dr.ones(mi.TensorXf, field.shape) for name, field in fields.items()})
    after = fields - ones
    assert all(not field.numpy().any() for field in fields.values())
    assert all((field.numpy() == -1).all() for field in after.values())


@pytest.mark.parametrize("shape", [(12, 36, 24), (1, 36, 24)], ids=["a grid", "a plane"])
def test_density_offset_is_the_same_share_of_the_density_in_the_next_octave(shape: tuple[int, int, int]) -> None:
    coarse, fine = octaves(shape, 2, 2.0)
    full, offset = np.ones(shape, np.float32), DensityOffset()
    density = resample_density(full, 1.0, coarse.shape, coarse.cell_size)
    fields = offset.carried(Fields(offset=mi.TensorXf(0.5 * density)), coarse, fine)
    middle = tuple(n // 2 for n in shape)
    assert offset.density(fields, mi.TensorXf(full), 1.0).numpy()[middle] == pytest.approx(1.5, abs=1e-5)


def test_density_offset_is_clamped_and_steps_by_eta() -> None:
    fields = Fields(offset=mi.TensorXf(np.full(SHAPE, -0.5, np.float32)))
    density = blob(SHAPE, (9, 12, 8), 3)
    stylized = DensityOffset().density(fields, mi.TensorXf(density), 1.0)
    np.testing.assert_allclose(stylized.numpy(), np.maximum(density - 0.5, 0), atol=1e-7)
    assert DensityOffset().unit_step(96, 1.8) == 1.0


@pytest.mark.parametrize("keys", [{}, {"substeps": 3}, FLOW, FLOW | {"conservative": True}])
def test_a_given_velocity_moves_the_density_as_the_fields_would(keys: dict) -> None:
    """What the finish does where a solid changes the velocity of the fields, at the octave's own size of cells."""
    rng, transport, h = np.random.default_rng(5), Transport(0.5, **keys), 1.8
    fields = Fields(phi=mi.TensorXf(9 * smooth_noise(rng, *SHAPE)), psi=mi.TensorXf(9 * smooth_noise(rng, *SHAPE, 3)))
    density = mi.TensorXf(blob(SHAPE, (9, 12, 8), 4))
    by_fields = transport.density(fields, density, h).numpy()
    by_velocity = transport.around_solids(density, transport.velocity(fields, h), h).numpy()
    np.testing.assert_allclose(by_velocity, by_fields, atol=2e-5)
    assert np.abs(by_fields - density.numpy()).max() > 0.05


def test_incompressible_transport_keeps_the_mass_better_with_more_substeps() -> None:
    rng = np.random.default_rng(3)
    density, psi = blob((32, 32, 32), (16, 16, 16), 5), 20 * smooth_noise(rng, 32, 32, 32, 3, passes=6)
    v = tnst_mi.velocity(None, psi, 0.0)
    errors = [abs(tnst_mi.advect(density, v, steps=n).sum() / density.sum() - 1) for n in (1, 4, 16)]
    assert errors[2] < 0.5 * errors[0]


@pytest.mark.parametrize("shape", [(5, 6, 7), (5, 6, 7, 3)])
def test_outliers_are_limited_by_the_mean_of_what_is_not_zero(shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(0).standard_normal(shape).astype(np.float32)
    values[:2] = 0
    values[3, 2, 1] = 1e6
    values[4, 1, 2] = -1e6
    bound = 3 * np.abs(values[values != 0]).mean(dtype=np.float64)
    found = np.array(limited(mi.TensorXf(values), 3.0))
    np.testing.assert_allclose(found, np.clip(values, -bound, bound), rtol=1e-5)
    np.testing.assert_array_equal(np.array(limited(mi.TensorXf(np.zeros(shape, np.float32)), 3.0)), 0)


def test_a_step_along_the_flow_takes_no_outliers() -> None:
    """Where smoke is stretched e-fold many times, a few cells have hundreds of times the mean derivative."""
    waves = [np.sin(np.arange(n, dtype=np.float32) / 2) for n in (16, 24, 16)]
    phi = 40 * waves[0][:, None, None] * waves[1][:, None] * waves[2]
    density = np.zeros(phi.shape, np.float32)
    density[4:12, 6:18, 4:12] = np.random.default_rng(1).random((8, 12, 8))
    weight, transport = (
        np.random.default_rng(2).standard_normal(phi.shape).astype(np.float32),
        Transport(1.0, trace="flow"),
    )
    _, pull_back = transport.density_with_pullback(Fields(phi=mi.TensorXf(phi)), mi.TensorXf(density), 1.0)
    exact = pull_back(mi.TensorXf(weight))["phi"].numpy()
    assert transport.largest_derivative == LARGEST_DERIVATIVE and Transport(1.0).largest_derivative is None
    bound = LARGEST_DERIVATIVE * np.abs(exact[exact != 0]).mean(dtype=np.float64)
    assert np.abs(exact).max() > 20 * bound
    mask = mi.TensorXf(np.ones_like(exact))
    found = normalised_step(Fields(phi=mi.TensorXf(exact)), mask, 1.0, 3, largest=LARGEST_DERIVATIVE)["phi"]
    clipped = Fields(phi=mi.TensorXf(np.clip(exact, -bound, bound).astype(np.float32)))
    np.testing.assert_allclose(
        found.numpy(), normalised_step(clipped, mask, 1.0, 3)["phi"].numpy(), rtol=2e-3, atol=2e-4
    )
