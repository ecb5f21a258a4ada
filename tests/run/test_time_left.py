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
    estimator, found = TimeLeft(SIZES, 0, 0, clock), []
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
    estimator = TimeLeft(SIZES, 0, 0, clock)
    for done in range(50, 61):
        clock.now += 2.0
        left = estimator.after(2, done, 60)
    assert left == 0.0
    clock = Clock()
    estimator = TimeLeft(SIZES, 0, 0, clock)
    clock.now = 3.0
    # All that is known after one iteration.
    assert estimator.after(2, 51, 60) == pytest.approx(27.0)


def test_times_that_make_no_sense_give_a_number() -> None:
    clock = Clock()
    estimator = TimeLeft(SIZES, 0, 0, clock)
    for octave, seconds in enumerate((5.0, 0.0, 1.0)):
        for i in range(20):
            clock.now += seconds
            assert np.isfinite(estimator.after(octave, octave * 20 + i + 1, 60))


def with_results(frames: int, window: bool, cells: int, results: float, speed: float) -> list[tuple[int, float, float]]:
    """A run of typical proportions, each of whose frames takes a while to be written.

    Returns:
        (octave, estimate, truth) after every iteration but the first one of the second octave.
    """
    clock, iterations, done = Clock(), 20, 0
    estimator, found = TimeLeft(SIZES, cells, frames, clock), []
    for octave, size in enumerate(SIZES):
        for i in range(frames * iterations):
            clock.now += speed * size.typical
            done += 1
            left = estimator.after(octave, done, 3 * frames * iterations)
            if octave > 0 and i > 0:
                found.append((octave, left, clock.now))
            if octave == 2 and not window and (i + 1) % iterations == 0:
                clock.now += results
                estimator.frame_done()
    for _ in range(frames if window else 0):
        clock.now += results
        estimator.frame_done()
    clock.now += 0.6 + 0.1 * frames if frames > 1 else 0.0
    return [(octave, left, clock.now - now) for octave, left, now in found]


@pytest.mark.parametrize("window", [False, True])
@pytest.mark.parametrize("frames", [1, 4])
@pytest.mark.parametrize("speed", [0.5, 1.0, 3.0])
def test_the_results_are_counted_in(frames: int, window: bool, speed: float) -> None:
    """On a grid of 128×192×128 cells, and a machine of any speed."""
    cells = 128 * 192 * 128
    for octave, left, truth in with_results(frames, window, cells, 0.35 + 0.55e-6 * cells, speed):
        assert left == pytest.approx(truth, rel=0.25), octave


def test_results_that_take_longer_are_learnt_from_the_first_frame() -> None:
    entries = with_results(4, False, 0, 5.0, 1.0)
    later = [(left, truth) for octave, left, truth in entries if octave == 2][20:]
    assert len(later) > 50
    assert all(left == pytest.approx(truth, rel=0.01) for left, truth in later)


@pytest.mark.parametrize("shape", [(8, 12, 8), (16, 24, 16)])
def test_on_tiny_grids_the_first_octave_knows_that_others_take_no_longer(shape: tuple[int, int, int]) -> None:
    """There an iteration takes the same time in every octave; by pixels, the last would take 10 times as long."""
    clock = Clock()
    estimator = TimeLeft(octave_sizes(Recipe(tag=("a",), views=3), shape), 0, 0, clock)
    clock.now = 5.0
    for done in range(1, 11):
        clock.now += 0.05
        left = estimator.after(0, done, 60)
    assert left == pytest.approx(0.05 * 50, rel=0.25)
