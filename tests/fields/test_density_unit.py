"""The unit of density: what the reference is, that it follows the input's units, and that it takes bounded memory."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tnst_mi.fields.density_unit import ReferenceDensity, scaled


def reference(*densities: np.ndarray) -> float:
    found = ReferenceDensity()
    for density in densities:
        found.add(density.astype(np.float32))
    return found.value


def plume(seed: int, shape: tuple[int, int, int] = (12, 20, 14)) -> np.ndarray:
    """Smoke with a smooth range of densities, in a haze of tiny values over the whole grid."""
    generator = np.random.default_rng(seed)
    density = generator.random(shape).astype(np.float32) * 1e-9
    density[3:9, 4:15, 3:11] = generator.random((6, 11, 8))
    return density


def test_the_reference_is_a_high_percentile_of_the_smoky_cells() -> None:
    densities = [plume(0), plume(1), plume(2)]
    smoky = np.concatenate([density[density > 0.1] for density in densities])
    # But for four cells of each frame, which may be stray.
    assert reference(*densities) == pytest.approx(np.percentile(smoky, 99), rel=0.01)
    assert reference(np.full((2, 3, 4), 0.05)) == pytest.approx(0.05, rel=1e-7)
    assert reference(np.zeros((2, 3, 4))) == 0.0


def test_hot_cells_and_haze_do_not_count() -> None:
    calm = reference(plume(0))
    hot = plume(0)
    hot[5, 6, 5], hot[4, 8, 9] = 1e6, 1e9
    assert reference(hot) == pytest.approx(calm, rel=0.02)
    clear = np.where(plume(0) > 1e-6, plume(0), 0)
    assert reference(clear) == pytest.approx(calm, rel=0.01)


@pytest.mark.parametrize("edge", [1, 3, 6, 12, 30])
@pytest.mark.parametrize("haze", [1e-12, 1e-9, 1e-6])
def test_a_puff_of_any_size_is_told_from_the_haze_around_it(edge: int, haze: float) -> None:
    """From 27 cells of a grid of 96,000 to a quarter of it; a single cell may be stray, and is not smoke."""
    density = (haze * np.random.default_rng(1).random((40, 60, 40))).astype(np.float32)
    middle = slice(20 - (edge + 1) // 2, 20 + edge // 2)
    density[middle, 30 - (edge + 1) // 2 : 30 + edge // 2, middle] = 1 - 0.5 * np.random.default_rng(2).random(
        (edge,) * 3
    )
    if edge > 1:
        assert 0.8 < reference(density) <= 1.0
        assert 0.8 < reference(0 * density, density, (haze * (density < 0.5)).astype(np.float32)) <= 1.0
    else:
        assert reference(density) <= haze


@given(st.integers(-100, 100), st.integers(0, 5))
def test_a_power_of_two_gives_the_same_bits(exponent: int, seed: int) -> None:
    densities = [plume(seed), plume(seed + 1)]
    expected = [scaled(d, 1 / reference(*densities)) for d in densities]
    others = [np.ldexp(d, exponent) for d in densities]
    assert reference(*others) == np.ldexp(reference(*densities), exponent)
    for one, other in zip(expected, others, strict=True):
        # Haze below the range of float32 has lost bits already.
        kept = np.ldexp(one, exponent) > 1e-37
        np.testing.assert_array_equal(scaled(other, 1 / reference(*others))[kept], one[kept])


@given(st.floats(1e-6, 1e6), st.integers(0, 5))
def test_another_factor_gives_nearly_the_same(factor: float, seed: int) -> None:
    densities = [plume(seed), plume(seed + 1)]
    other = reference(*(np.float32(factor) * density for density in densities))
    assert other / factor == pytest.approx(reference(*densities), rel=4e-5)


def test_a_frame_with_little_smoke_counts_little() -> None:
    first = np.zeros((12, 20, 14), np.float32)
    first[5, 5, 5:8] = 1000
    alone = reference(plume(0), plume(1))
    assert reference(first, plume(0), plume(1)) == pytest.approx(alone, rel=0.02)


@pytest.mark.parametrize("factor", [1e-45, 1e-30, 0.3, 1e30, 1e44])
def test_scaling_by_factors_beyond_float32(factor: float) -> None:
    value = 1 / factor if 1e-38 < 1 / factor < 1e38 else np.ldexp(1.0, -120 if factor > 1 else 120)
    density = np.full((1, 2, 2), value, np.float32)
    expected = density.astype(np.float64) * factor
    np.testing.assert_allclose(scaled(density, factor), expected, rtol=2e-7)


def test_the_factor_may_be_given() -> None:
    found = ReferenceDensity()
    found.add(np.full((2, 2, 2), 0.25, np.float32))
    assert (found.scale(), found.scale("auto"), found.scale(3.0)) == (4.0, 4.0, 3.0)
    assert ReferenceDensity().scale() == 1.0
