"""Runs a small sequence again and again in children that are killed (SIGKILL) at random moments; see test_kill.py.

    python killed_runs.py WEIGHTS OUT WINDOW KILLS ORDER

ORDER is a step_order of the plain average, or empty for the default of both.

The children are forked after everything has been imported and before anything runs, which saves seconds each.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from pathlib import Path

from moving_smoke import moving_smoke

from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.job import Run
from tnst_mi.run.prepare import prepare
from tnst_mi.run.progress import ProgressBar

#: After so many that are killed while they start or iterate, children are killed while they write results.
KILLED_WRITING = 2


def run(recipe: Recipe, out: Path, pipe: int) -> None:
    """Go on with the run in `out` to its end, telling of every iteration and every frame."""
    ProgressBar.advance = lambda self, progress: os.write(pipe, b"i")
    for _ in Run(prepare(moving_smoke(4), recipe, out, resume=True), progress=False):
        os.write(pipe, b"f")


def child(recipe: Recipe, out: Path) -> tuple[int, int]:
    """Start a run; its process, and the pipe on which it tells how far it is."""
    reader, writer = os.pipe()
    process = os.fork()
    if process == 0:
        os.close(reader)
        try:
            run(recipe, out, writer)
        finally:
            os._exit(sys.exc_info()[0] is not None)
    os.close(writer)
    return process, reader


def main() -> None:
    """Kill, go on, kill, …, and let the last child end."""
    weights, out, (window, kills), order = sys.argv[1], Path(sys.argv[2]), map(int, sys.argv[3:5]), sys.argv[5]
    goal = {"semantic": ["inception_3a/3x3:2"], "octaves": 2, "iterations": 4, "views": 2}
    average = {"window_average": "plain", "step_order": order} if order else {}
    recipe = Recipe.from_dict(goal | average | {"window": window, "weights": weights, "lam": 0.5, "coherence": 1.0})
    rng = random.Random(window)
    for moment in range(kills + KILLED_WRITING):
        process, reader = child(recipe, out)
        if moment < kills:
            # Up to two iterations, or none: then it is killed while it starts.
            for _ in range(rng.randrange(3)):
                os.read(reader, 1)
            time.sleep(rng.uniform(0, 0.05))
        else:
            while os.read(reader, 1) not in (b"f", b""):
                pass
            time.sleep(rng.uniform(0, 0.02))
        os.kill(process, signal.SIGKILL)
        _, status = os.waitpid(process, 0)
        os.close(reader)
        assert os.WIFSIGNALED(status), f"kill {moment}: the run had ended before ({status})"
    process, reader = child(recipe, out)
    _, status = os.waitpid(process, 0)
    assert status == 0


if __name__ == "__main__":
    main()
