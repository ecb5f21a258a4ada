"""Transport and density offsets: units, octaves, and the step."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from fields import blob, smooth_noise

import tnst_mi
from tnst_mi.fields.grid import Octave, octaves
from tnst_mi.fields.resampling import resample_density
from tnst_mi.optimisation.parameterisation import DensityOffset, Transport

SHAPE = (16, 24, 20)


def pulled_back(parameters: Transport | DensityOffset, weight: np.ndarray, density: np.ndarray) -> None:
    """Give the fields the gradient of ⟨weight, density*⟩."""
    parameters.attach()
    dr.backward(dr.sum(parameters.density(mi.TensorXf(density)) * mi.TensorXf(weight), axis=None))


@pytest.mark.parametrize(("lam", "names"), [(1.0, {"phi"}), (0.0, {"psi"}), (0.5, {"phi", "psi"})])
def test_absent_potentials_are_not_stored(lam: float, names: set[str]) -> None:
    transport = Transport(lam)
    transport.enter(Octave(SHAPE, 1.0))
    assert set(transport.fields) == names
    assert not transport.velocity().numpy().any()


def test_zero_fields_leave_the_density_unchanged() -> None:
    density = blob(SHAPE, (9, 12, 8), 3)
    for parameters in (Transport(0.5), DensityOffset()):
        parameters.enter(Octave(SHAPE, 1.0))
        np.testing.assert_array_equal(parameters.density(mi.TensorXf(density)).numpy(), density)


def test_velocity_keeps_its_meaning_across_octaves() -> None:
    """Displacement in full-resolution cells: the same physical motion before and after going up."""
    coarse, full = octaves((36, 54, 36), 2)
    transport = Transport(1.0)
    transport.enter(coarse)
    d, h, w = coarse.shape
    x = (np.arange(w) - (w - 1) / 2) * coarse.cell_size
    transport.fields["phi"] = mi.TensorXf(np.broadcast_to(np.float32(1.5 * x), (d, h, w)).copy())
    before = transport.velocity().numpy()
    transport.enter(full)
    after = transport.velocity().numpy()
    np.testing.assert_allclose(before[..., 0], 1.5, atol=1e-5)
    np.testing.assert_allclose(after[4:-4, 4:-4, 4:-4, 0], 1.5, atol=1e-4)


@pytest.mark.parametrize("cell_size", [1.0, 1.8])
def test_step_has_the_size_and_the_sign_of_the_recipe(cell_size: float) -> None:
    """One step changes Φ by η (H/2) h · mask · N(g): against N(g) of the same gradient, and downhill."""
    rng = np.random.default_rng(1)
    density, weight = blob(SHAPE, (9, 12, 8), 4), smooth_noise(rng, *SHAPE)
    mask, eta, rows = rng.random(SHAPE).astype(np.float32), 1e-4, 43
    transport = Transport(1.0)
    transport.enter(Octave(SHAPE, cell_size))
    pulled_back(transport, weight, density)
    gradient = dr.grad(transport.fields["phi"])
    from tnst_mi.fields.pyramid import gaussian, normalise

    direction = normalise(gaussian(gradient, 1.2), 3).numpy()
    transport.find_steps(mi.TensorXf(mask), eta, rows, 3)
    transport.descend()
    np.testing.assert_allclose(
        transport.fields["phi"].numpy(), -eta * rows / 2 * cell_size * mask * direction, rtol=1e-4, atol=1e-7
    )
    after = transport.density(mi.TensorXf(density)).numpy()
    assert (after * weight).sum() < (density * weight).sum()


def test_step_of_a_vector_potential_is_masked_in_every_component() -> None:
    rng = np.random.default_rng(2)
    mask = np.zeros(SHAPE, np.float32)
    mask[4:12, 6:18, 5:15] = 1
    transport = Transport(0.0)
    transport.enter(Octave(SHAPE, 1.0))
    pulled_back(transport, smooth_noise(rng, *SHAPE), blob(SHAPE, (9, 12, 8), 4))
    transport.find_steps(mi.TensorXf(mask), 0.002, 24, 3)
    transport.descend()
    psi = transport.fields["psi"].numpy()
    assert not psi[mask == 0].any()
    assert (np.abs(psi[mask == 1]).max(0) > 1e-4).all()


@pytest.mark.parametrize("shape", [(12, 36, 24), (1, 36, 24)], ids=["a grid", "a plane"])
def test_density_offset_is_the_same_share_of_the_density_in_the_next_octave(shape: tuple[int, int, int]) -> None:
    coarse, fine = octaves(shape, 2, 2.0)
    full = np.ones(shape, np.float32)
    offset = DensityOffset()
    offset.enter(coarse)
    density = resample_density(full, 1.0, coarse.shape, coarse.cell_size)
    offset.fields["offset"] = mi.TensorXf(0.5 * density)
    offset.enter(fine)
    middle = tuple(n // 2 for n in shape)
    assert offset.density(mi.TensorXf(full)).numpy()[middle] == pytest.approx(1.5, abs=1e-5)


def test_density_offset_is_clamped_and_steps_by_eta() -> None:
    offset = DensityOffset()
    offset.enter(Octave(SHAPE, 1.0))
    offset.fields["offset"] = mi.TensorXf(np.full(SHAPE, -0.5, np.float32))
    density = blob(SHAPE, (9, 12, 8), 3)
    np.testing.assert_allclose(offset.density(mi.TensorXf(density)).numpy(), np.maximum(density - 0.5, 0), atol=1e-7)
    assert offset.unit_step(96) == 1.0


def test_incompressible_transport_keeps_the_mass_better_with_more_substeps() -> None:
    rng = np.random.default_rng(3)
    density, psi = blob((32, 32, 32), (16, 16, 16), 5), 20 * smooth_noise(rng, 32, 32, 32, 3, passes=6)
    v = tnst_mi.velocity(None, psi, 0.0)
    errors = [abs(tnst_mi.advect(density, v, steps=n).sum() / density.sum() - 1) for n in (1, 4, 16)]
    assert errors[2] < 0.5 * errors[0]
