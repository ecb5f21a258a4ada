"""The statistics of `tnst-mi compare --left --right`: their laws, and how often they find fault where there is none."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest

from tnst_mi.compare.bench.bench_settings import BATCHES
from tnst_mi.compare.bench.statistics.batches import Batches, comparable, difference
from tnst_mi.compare.bench.statistics.decision import FALSE_ALARMS, Family, alarms, family, holm
from tnst_mi.compare.bench.statistics.hypotheses import value_families
from tnst_mi.compare.bench.statistics.student import quantile, two_sided_tail


@pytest.mark.parametrize(
    ("degrees", "value"),
    [(1, 12.7062047364), (2, 4.3026527299), (3, 3.1824463053), (15, 2.1314495456), (30, 2.0422724563)],
)
def test_quantiles_are_those_of_the_tables(degrees: int, value: float) -> None:
    assert quantile(0.05, degrees) == pytest.approx(value, rel=1e-9)
    assert two_sided_tail(np.array(-value), np.array(degrees + 0.9)) == pytest.approx(0.05, rel=1e-9)


def test_far_tails_are_those_of_the_density_and_its_limit() -> None:
    """By the integral of the density beyond 8; for many degrees of freedom by the normal law."""
    for degrees in (7, 16, 31):
        scale = math.exp(math.lgamma((degrees + 1) / 2) - math.lgamma(degrees / 2)) / math.sqrt(degrees * math.pi)
        t = np.geomspace(8, 1e5, 400_001)
        density = scale * (1 + t**2 / degrees) ** (-(degrees + 1) / 2)
        tail = 2 * np.trapezoid(density * t, np.log(t))
        assert two_sided_tail(np.array(8.0), np.array(degrees)) == pytest.approx(tail, rel=1e-6)
    assert two_sided_tail(np.array(2.0), np.array(10**4)) == pytest.approx(2 * NormalDist().cdf(-2), rel=1e-3)
    assert two_sided_tail(np.array(np.inf), np.array(3)) == 0 and two_sided_tail(np.array(0.0), np.array(4)) == 1


def test_holm_rejects_what_its_steps_allow() -> None:
    np.testing.assert_array_equal(holm(np.array([0.02, 0.001, 0.04, 0.011]), 0.05), [True, True, True, True])
    np.testing.assert_array_equal(holm(np.array([0.03, 0.001, 0.04, 0.011]), 0.05), [False, True, False, True])
    assert not holm(np.array([0.2, 0.3]), 0.05).any() and holm(np.array([0.04]), 0.05).all()


def test_degrees_of_freedom_are_welchs() -> None:
    rng = np.random.default_rng(1)
    noisy, quiet, exact = rng.normal(0, 5, (16, 3)), rng.normal(0, 0.1, (16, 3)), np.zeros((1, 3))
    both = difference(Batches(noisy), Batches(quiet))
    assert (both.degrees >= 15).all() and (both.degrees < 15.1).all(), "the noisy one decides"
    np.testing.assert_allclose(difference(Batches(noisy), Batches(exact)).degrees, 15, rtol=1e-12)
    assert (difference(Batches(noisy), Batches(rng.normal(0, 5, (16, 3)))).degrees > 20).all()
    np.testing.assert_array_equal(difference(Batches(exact), Batches(exact)).standard_error, 0)


def test_without_noise_the_allowance_alone_decides() -> None:
    left, right = Batches(np.array([[1.0, 1.0011]])), Batches(np.ones((1, 2)))
    tests = family("means", ["a", "b"], left, right, np.array(1e-3))
    np.testing.assert_array_equal(alarms([tests])[0], [False, True])


def test_pixels_whose_paths_nearly_all_do_the_same_are_left_to_their_tile() -> None:
    """All paths of 16 batches passed, by chance: the scatter is 0, and would be taken for certainty."""
    rng = np.random.default_rng(2)
    noisy = rng.binomial(32, 0.5, (16, 4)) / 32
    left = noisy.copy()
    left[:, 1] = 1.0  # constant
    left[:, 2] = np.repeat([0.0, 1.0], 8)  # half of them equal
    left[:, 3] = np.repeat([0.0, 1.0], [7, 9])  # more than half
    exact = Batches(np.full((1, 4), 0.999))
    np.testing.assert_array_equal(comparable(Batches(left), exact), [True, False, True, False])
    np.testing.assert_array_equal(comparable(exact, Batches(left)), [True, False, True, False])
    assert comparable(Batches(left, rare=False), exact).all(), "nothing is missed by chance"
    # One that paths never reach, beside one whose paths do: a difference that is seen.
    np.testing.assert_array_equal(comparable(Batches(left), Batches(noisy)), [True, True, True, False])
    np.testing.assert_array_equal(comparable(Batches(left), Batches(left)), [True, True, True, False])
    rounded = left + rng.normal(0, 1e-7, left.shape)
    np.testing.assert_array_equal(comparable(Batches(rounded), exact), [True, False, True, False])


def test_a_side_that_is_black_is_found() -> None:
    black, lit = np.zeros((BATCHES, 1, 10, 8, 1)), np.random.default_rng(3).gamma(2, 0.1, (BATCHES, 1, 10, 8, 1))
    families = value_families("", Batches(black), Batches(lit), 1e-3)
    assert all(alarm.any() for alarm in alarms(families))


# --------------------------------------------------------------------
# False alarms
# --------------------------------------------------------------------

COMPARISONS = 2000
SHAPE = (10, 8, 1)
PATHS = 8

#: What light cannot be: less than nothing.
LIGHT = (0.0, math.inf)

Law = Callable[[np.random.Generator], np.ndarray]


def binomial(rng: np.random.Generator) -> np.ndarray:
    """Paths that pass or do not, of all transmittances: (batches, comparisons, H, W, C)."""
    transmittance = np.linspace(0.0, 1.0, math.prod(SHAPE)).reshape(SHAPE)
    return rng.binomial(PATHS, transmittance, (BATCHES, COMPARISONS, *SHAPE)) / PATHS


def skewed(rng: np.random.Generator) -> np.ndarray:
    """Radiance of long-tailed paths: exponential, so that the mean of a batch is a gamma variable."""
    return rng.gamma(
        PATHS, np.geomspace(1e-3, 1.0, math.prod(SHAPE)).reshape(SHAPE) / PATHS, (BATCHES, COMPARISONS, *SHAPE)
    )


def found(rng: np.random.Generator, pixels: tuple[int, ...] = SHAPE, comparisons: int = COMPARISONS) -> np.ndarray:
    """Light that few paths find, 15 in 100, and then as much as an exponential law says."""
    hits = rng.binomial(PATHS, 0.15, (BATCHES, comparisons, *pixels))
    return np.where(hits > 0, rng.gamma(np.maximum(hits, 1), 1 / (0.15 * PATHS)), 0.0)


def common(rng: np.random.Generator) -> np.ndarray:
    """All pixels of a batch share most of their noise, as neighbours under a wide pixel filter do."""
    shared = rng.normal(1, 1, (BATCHES, COMPARISONS, 1, 1, 1))
    return shared + 0.1 * rng.normal(0, 1, (BATCHES, COMPARISONS, *SHAPE))


def exact(rng: np.random.Generator) -> np.ndarray:
    """The mean of `binomial`, free of noise."""
    return np.broadcast_to(np.linspace(0.0, 1.0, math.prod(SHAPE)).reshape(SHAPE), (1, COMPARISONS, *SHAPE))


def exact_skewed(rng: np.random.Generator) -> np.ndarray:
    """The mean of `skewed`."""
    return np.broadcast_to(np.geomspace(1e-3, 1.0, math.prod(SHAPE)).reshape(SHAPE), (1, COMPARISONS, *SHAPE))


def exact_found(rng: np.random.Generator) -> np.ndarray:
    """The mean of `found`."""
    return np.ones((1, COMPARISONS, *SHAPE))


@functools.cache
def fake_comparisons(left: Law, right: Law) -> list[Family]:
    rng = np.random.default_rng(5)
    ends = {binomial: (0.0, 1.0), skewed: LIGHT, found: LIGHT}
    sides = [Batches(law(rng), paths=PATHS, ends=ends.get(law, (-math.inf, math.inf))) for law in (left, right)]
    return value_families("", *sides, 0.0)


def false_alarms(left: Law, right: Law, most: float) -> int:
    """How many of the comparisons find fault, each with a view of its own.

    One does if the smallest tail of any of its families is at most its share of `most`: the first step of Holm's
    procedure, without which there is no other.
    """
    families = fake_comparisons(left, right)
    alarming = np.zeros(COMPARISONS, bool)
    for tests in families:
        tails = tests.tail.reshape(COMPARISONS, -1)
        alarming |= tails.min(1) <= most / len(families) / tails.shape[1]
    return int(alarming.sum())


@pytest.mark.parametrize(
    ("left", "right"),
    [
        (binomial, binomial),
        (skewed, skewed),
        (found, found),
        (common, common),
        (exact, binomial),
        (exact_skewed, skewed),
        (exact_found, found),
    ],
)
def test_two_that_agree_raise_an_alarm_once_in_a_thousand_comparisons_at_most(left: Law, right: Law) -> None:
    """2000 comparisons of fake renders, each of its mean, tiles and pixels, with as many batches as the command has and
    as few paths in each as it has by default."""
    count = false_alarms(left, right, FALSE_ALARMS)
    # With a probability of 1 in 1000, there are more than 8 in 1 case of 4000.
    assert count <= 8, f"{count} false alarms in {COMPARISONS} comparisons"


def test_images_as_large_as_those_of_smoke_raise_none() -> None:
    """Of 20 images of 96×64 pixels, whose smallest tails are a million times as far out as those of one number."""
    rng = np.random.default_rng(11)
    shape = (96, 64, 1)
    noisy = Batches(found(rng, shape, 20), paths=PATHS, ends=LIGHT)
    families = value_families("", noisy, Batches(np.ones((1, 20, *shape))), 0.0)
    assert not any(alarm.any() for alarm in alarms(families, 20 * FALSE_ALARMS))
    without = value_families("", Batches(noisy.values, rare=False), Batches(np.ones((1, 20, *shape))), 0.0)
    assert any(alarm.any() for alarm in alarms(without, 20 * FALSE_ALARMS)), (
        "by errors that leave out that light may have been missed"
    )


@pytest.mark.parametrize(("paths", "share"), [(2, 0.5), (8, 0.05), (8, 0.15), (64, 0.15)])
def test_derivatives_that_few_paths_carry_raise_no_more_against_an_answer(paths: int, share: float) -> None:
    """20 000 of them, without known ends, at the level that one of a family of four has: 5 alarms on average."""
    rng = np.random.default_rng(12)
    hits = rng.binomial(paths, share, (BATCHES, 20_000))
    values = np.where(hits > 0, rng.gamma(np.maximum(hits, 1), 1 / (paths * share)), 0.0)
    answer = Batches(np.ones((1, 20_000)))
    tests = family(
        "derivatives", [""] * 20_000, Batches(-values), replace(answer, values=-answer.values), np.array(0.0)
    )
    # There are more than 14 in 1 case of 5000.
    assert (tests.tail <= FALSE_ALARMS / 4).sum() <= 14
    naive = family("derivatives", [""] * 20_000, Batches(values, rare=False), answer, np.array(0.0))
    assert (naive.tail <= FALSE_ALARMS / 4).sum() > 14 or paths == 64


def test_the_bound_is_close_where_tests_are_few() -> None:
    """Of 1 in 20 allowed, 2% to 6% are used: the tests are not safe by being blind."""
    assert 0.02 <= false_alarms(binomial, binomial, 0.05) / COMPARISONS <= 0.06


def test_the_normal_law_in_place_of_students_would_raise_many() -> None:
    """Why the tests are not z-tests: 160 pixels of 16 batches."""
    rng = np.random.default_rng(7)
    count = 0
    for _ in range(500):
        found = difference(Batches(rng.normal(0, 1, (16, 160))), Batches(np.zeros((1, 160))))
        z = np.abs(found.value / found.standard_error).max()
        count += 160 * 2 * NormalDist().cdf(-z) <= 1e-3
    assert count > 20


@pytest.mark.parametrize("bias", [0.03, -0.03])
def test_a_bias_too_small_for_any_pixel_is_found_in_the_mean(bias: float) -> None:
    rng = np.random.default_rng(8)
    left, right = rng.normal(1, 0.1, (BATCHES, 2, *SHAPE)), rng.normal(1 + bias, 0.1, (BATCHES, 2, *SHAPE))
    families = value_families("", Batches(left), Batches(right), 1e-3)
    found = {tests.name: alarm.any() for tests, alarm in zip(families, alarms(families), strict=True)}
    assert found["means"] and not found["pixels"]


def test_a_single_wrong_pixel_is_found_and_named() -> None:
    rng = np.random.default_rng(9)
    left, right = rng.normal(1, 0.1, (BATCHES, 2, *SHAPE)), rng.normal(1, 0.1, (BATCHES, 2, *SHAPE))
    left[:, 1, 7, 3] += 0.5
    families = value_families("γ 1", Batches(left), Batches(right), 1e-3, views=["0,0", "90,0"])
    found = dict(zip([tests.name for tests in families], alarms(families), strict=True))
    pixels = next(tests for tests in families if tests.name == "pixels")
    assert [pixels.labels[i] for i in np.flatnonzero(found["pixels"])] == ["γ 1, view 90,0, row 7, column 3"]
