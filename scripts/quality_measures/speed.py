"""How long an iteration takes, and how many of them take equally long."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

from tnst_mi import Frame, GoogLeNet, Recipe
from tnst_mi.machine.backend import on_gpu
from tnst_mi.optimisation.result import Progress
from tnst_mi.optimisation.single_frame import optimise

#: Rounds in which variants are timed in turn, and iterations of each octave then.
_ROUNDS, ITERATIONS = 3, 6

#: Differences of the time of an iteration up to which variants count as equally fast: where much else is running,
#: those of one variant with itself are up to 0.06.
_SAME_SPEED = 0.1


def seconds_per_iteration(frame: Frame, recipes: Mapping[str, Recipe], network: GoogLeNet) -> dict[str, float]:
    """Seconds that one iteration in every octave takes, by the name of each recipe.

    They are of the clock on a GPU; on a CPU of the processor, which other work on the machine hardly changes. Recipes
    take turns, and the fastest round of each counts.

    Raises:
        KeyboardInterrupt: Ctrl-C.
    """
    clock = time.perf_counter if on_gpu() else time.process_time
    rounds: dict[str, list[float]] = {name: [] for name in recipes}
    for _ in range(_ROUNDS):
        for name, recipe in recipes.items():
            times: list[tuple[int, float]] = []

            def note(progress: Progress, times: list[tuple[int, float]] = times) -> None:
                times.append((progress.octave, clock()))

            if optimise(frame, recipe, network, on_iteration=note).interrupted:
                raise KeyboardInterrupt
            rounds[name].append(of_one_iteration(times))
    return {name: min(seconds) for name, seconds in rounds.items()}


def of_one_iteration(ends: Sequence[tuple[int, float]]) -> float:
    """The sum over all octaves of the mean time between the ends of iterations, of which there are two or more.

    What happens up to the end of the first one of an octave, in which kernels are compiled, does not count.

    Args:
        ends: octave and time of each, in order.
    """
    by_octave: dict[int, list[float]] = {}
    for octave, end in ends:
        by_octave.setdefault(octave, []).append(end)
    return sum((times[-1] - times[0]) / (len(times) - 1) for times in by_octave.values())


def equal_time(seconds: Mapping[str, float], first: str, iterations: int) -> dict[str, int]:
    """Iterations, 1 or more, by variant, that take as long as some of the first one; see `_SAME_SPEED`."""
    found = {}
    for name, of_one in seconds.items():
        ratio = seconds[first] / of_one
        found[name] = iterations if abs(ratio - 1) <= _SAME_SPEED else max(1, round(iterations * ratio))
    return found
