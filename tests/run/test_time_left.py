"""The time left of a run on a simulated clock, for machines that spend their time differently."""

from __future__ import annotations

import numpy as np
import pytest

from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.time_left import OctaveSize, TimeLeft, octave_sizes

#: Three octaves of a grid of 64 x 96 x 64 cells, a factor of 1.8 apart.
SIZES = [OctaveSize(d * h * w, 9 * h * w, 20) for d, h, w in ((19, 29, 19), (35, 53, 35), (64, 96, 64))]


def test_the_sizes_of_a_recipe() -> None:
    assert octave_sizes(Recipe(tag=("a",)), (64, 96, 64)) == SIZES


class Clock:
    """Time that passes only when told."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def simulated(
    costs: tuple[float, float, float], iterations: int = 20, frames: int = 1, entering: float = 0.0, noise: float = 0.0
) -> list[tuple[int, int, float, float]]:
    """A run whose iterations cost so many seconds, per pixel and per cell at full resolution.

    Returns:
        (octave, iteration in it, estimate, truth) after every iteration.
    """
    rng, clock, each = np.random.default_rng(0), Clock(), iterations * frames
    seconds = [
        max(1e-9, costs[0] + costs[1] * size.pixels / SIZES[-1].pixels + costs[2] * size.cells / SIZES[-1].cells)
        for size in SIZES
    ]
    estimator, found = TimeLeft(SIZES, clock), []
    for octave, one in enumerate(seconds):
        for i in range(each):
            clock.now += one * (1 + noise * rng.uniform(-1, 1)) + (entering if i == 0 else 0.0)
            found.append((octave, i, estimator.after(octave, octave * each + i + 1, 3 * each), clock.now))
    return [(octave, i, estimate, clock.now - now) for octave, i, estimate, now in found]


@pytest.mark.parametrize("frames", [1, 5])
@pytest.mark.parametrize(
    "costs",
    [
        *[(1, 0, 0), (0, 1, 0), (0, 0, 1)],
        *[(0.1, 1, 0), (1, 1, 0), (0.1, 0, 1), (1, 0, 1), (0, 1, 1), (0, 0.1, 1), (0, 1, 0.1), (0.2, 1, 1), (1, 1, 1)],
    ],
)
def test_within_a_quarter_from_the_second_octave_on(costs: tuple[float, float, float], frames: int) -> None:
    """From its second iteration on, since the first tells nothing: it also compiles kernels."""
    for octave, i, estimate, truth in simulated(costs, frames=frames):
        if (octave, i) >= (1, 1) and truth > 0:
            assert abs(estimate - truth) <= 0.25 * truth, (octave, i, estimate, truth)


def test_noise_and_compilation_are_borne() -> None:
    for octave, i, estimate, truth in simulated((0.3, 1, 0.5), entering=4.0, noise=0.2):
        if (octave, i) >= (1, 4) and truth > 5:
            assert abs(estimate - truth) <= 0.25 * truth, (octave, i, estimate, truth)


def test_in_the_last_octave_it_is_what_was_measured() -> None:
    for octave, i, estimate, truth in simulated((0.3, 1, 2)):
        if octave == 2 and i >= 1:
            assert estimate == pytest.approx(truth, abs=1e-9)


def test_a_resumed_run_begins_in_a_later_octave() -> None:
    clock = Clock()
    estimator = TimeLeft(SIZES, clock)
    for done in range(50, 61):
        clock.now += 2.0
        left = estimator.after(2, done, 60)
    assert left == 0.0
    clock = Clock()
    estimator = TimeLeft(SIZES, clock)
    clock.now = 3.0
    # All that is known after one iteration.
    assert estimator.after(2, 51, 60) == pytest.approx(27.0)


def test_times_that_make_no_sense_give_a_number() -> None:
    clock = Clock()
    estimator = TimeLeft(SIZES, clock)
    for octave, seconds in enumerate((5.0, 0.0, 1.0)):
        for i in range(20):
            clock.now += seconds
            assert np.isfinite(estimator.after(octave, octave * 20 + i + 1, 60))
