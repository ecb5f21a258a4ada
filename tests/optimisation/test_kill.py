"""kill -9 at ten random moments and while results are written: the resumed run ends with the bits of one left alone."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import killed_runs
import numpy as np
import pytest
from moving_smoke import moving_smoke
from networks import random_googlenet

import tnst_mi
from tnst_mi.recipe.recipe import Recipe


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize(("window", "kills", "order"), [(1, 3, ""), (3, 10, ""), (3, 3, "align_first")])
def test_killed_runs_end_with_the_same_bits(window: int, kills: int, order: str, tmp_path: Path) -> None:
    weights, out = tmp_path / "random.safetensors", tmp_path / "out"
    random_googlenet(weights, narrow=8)
    script = Path(killed_runs.__file__)
    command = [sys.executable, script, weights, out, str(window), str(kills), order]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr

    recipe = Recipe.from_toml(out / "recipe.toml")
    expected = tnst_mi.stylize(moving_smoke(4), recipe, tmp_path / "alone", progress=False)
    run = json.loads((out / "run.json").read_text())
    assert [frame["name"] for frame in run["frames"]] == [frame["name"] for frame in expected.run["frames"]]
    assert run["status"] == "done" and run["sequence"] == expected.run["sequence"]
    for kind, arrays in (("density", expected.densities), ("velocity", expected.velocities)):
        for frame, array in zip(expected.frames, arrays, strict=True):
            with np.load(out / kind / f"{frame.name}.npz") as file:
                assert file[kind].tobytes() == array.tobytes()
    files = [{str(path.relative_to(folder)) for path in folder.rglob("*")} for folder in (out, tmp_path / "alone")]
    assert files[0] == files[1], "nothing unfinished is left"
    losses = [
        [{key: value for key, value in json.loads(line).items() if key != "seconds"} for line in lines.splitlines()]
        for lines in ((folder / "metrics.jsonl").read_text() for folder in (out, tmp_path / "alone"))
    ]
    assert losses[0] == losses[1]
