"""Jobs of a batch system, which a stand-in for its commands runs at once."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from moving_smoke import moving_smoke

import tnst_mi
from tnst_mi.io.sequence import save_frame

# Not imported here: it would take Ctrl-C for itself.
if importlib.util.find_spec("dask_jobqueue") is None:
    pytest.skip("needs tnst_mi[cluster]", allow_module_level=True)

SBATCH = """#!/usr/bin/env bash
cat "$1" >> "$NOTES/script"
cp "$1" "$NOTES/job.$$"
setsid bash "$NOTES/job.$$" > /dev/null 2>&1 &
echo $! >> "$NOTES/jobs"
echo "Submitted batch job $!"
"""

SCANCEL = """#!/usr/bin/env bash
kill -- "-$1" 2> /dev/null; true
"""


def test_a_run_on_slurm(weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (tmp_path / "bin").mkdir(exist_ok=True)
        (tmp_path / "bin" / name).write_text(text)
        (tmp_path / "bin" / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{os.environ['PATH']}")
    monkeypatch.setenv("NOTES", str(tmp_path))
    for frame in moving_smoke(3):
        save_frame(tmp_path / "smoke" / f"{frame.name}.npz", frame)
    (tmp_path / "slurm.toml").write_text(
        f'jobs = 2\nmemory = "4GB"\nqueue = "smoke"\npython = "{sys.executable}"\n'
        f'local_directory = "{tmp_path}"\nlog_directory = "{tmp_path}"\njob_script_prologue = [": module load here"]\n'
    )
    recipe = {"semantic": ["inception_3a/3x3:2"], "octaves": 1, "iterations": 2, "views": 1, "window": 3, "threads": 1}
    recipe |= {"weights": str(weights)}
    alone = tnst_mi.stylize(tmp_path / "smoke", recipe, tmp_path / "alone", progress=False)
    address = f"slurm:{tmp_path / 'slurm.toml'}"
    shared = tnst_mi.stylize(tmp_path / "smoke", recipe, tmp_path / "shared", progress=False, cluster=address)
    for one, other in zip(alone.densities, shared.densities, strict=True):
        np.testing.assert_array_equal(one, other)
    script = (tmp_path / "script").read_text()
    assert "export DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED=False" in script and "module load here" in script
    assert "#SBATCH -p smoke" in script and "--nthreads 1" in script and "--memory-limit 0" in script
    assert len((tmp_path / "jobs").read_text().split()) == 2
    (session,) = shared.run["cluster"]
    assert session["address"] == address and session["workers"]
