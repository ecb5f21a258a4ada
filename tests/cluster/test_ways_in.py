"""The ways to a cluster besides `stylize --cluster`: Python, and `batch`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, run  # noqa: F401 - a fixture
from moving_smoke import moving_smoke

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.io.sequence import save_frame

pytest.importorskip("distributed", reason="needs tnst_mi[cluster]")

GOAL = {"semantic": ["inception_3a/3x3:2"], "octaves": 1, "iterations": 2, "views": 1, "window": 3, "threads": 1}


@pytest.fixture
def smoke(tmp_path: Path) -> Path:
    for frame in moving_smoke(3):
        save_frame(tmp_path / "smoke" / f"{frame.name}.npz", frame)
    return tmp_path / "smoke"


def test_python_and_batch_have_the_same_bits(smoke: Path, weights: Path, tmp_path: Path, run: Run) -> None:  # noqa: F811
    recipe = GOAL | {"weights": str(weights)}
    alone = tnst_mi.stylize(smoke, recipe, tmp_path / "alone", progress=False)
    shared = tnst_mi.stylize(smoke, recipe, tmp_path / "shared", progress=False, cluster="local:1")
    for one, other in zip(alone.densities, shared.densities, strict=True):
        np.testing.assert_array_equal(one, other)
    assert [len(history) for history in shared.history] == [2, 2, 2]
    (tmp_path / "goal.toml").write_text("\n".join(f"{key} = {json.dumps(value)}" for key, value in recipe.items()))
    ran = run("batch", tmp_path / "goal.toml", smoke, "--out", tmp_path / "batch", "--cluster", "local:1")
    assert ran.code == 0
    (density,) = (tmp_path / "batch").glob("*/*/density/s_006.npz")
    with np.load(density) as file:
        np.testing.assert_array_equal(file["density"], alone.densities[1])


def test_what_is_not_in_files_cannot_be_shared(weights: Path, tmp_path: Path) -> None:
    recipe = GOAL | {"weights": str(weights)}
    for frames, out in ((moving_smoke(3), tmp_path / "out"), (str(tmp_path), None)):
        with pytest.raises(InputError, match="cluster = 'local:2': its processes read frames from files and share"):
            tnst_mi.stylize(frames, recipe, out, cluster="local:2")
    assert not (tmp_path / "out").exists()
