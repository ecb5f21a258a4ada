"""Sequences: by what a frame is moved to the next one, and what is written of it."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import numpy as np
import pytest
from render_views import write_views

import tnst_mi
from tnst_mi.io import open_frames
from tnst_mi.reconstruction.motion import MotionDescent
from tnst_mi.reconstruction.reconstruct import reconstruct

GAMMA = 0.3
QUICK = {"iterations": 16, "motion_iterations": 16, "levels": 1, "batch": 3}


@pytest.fixture(scope="module")
def simulation(cloud) -> list[tnst_mi.Frame]:
    """Smoke that moves by 2 cells to +y in every frame."""
    velocity = np.zeros((*cloud.shape, 3), np.float32)
    velocity[..., 1] = 2
    frames = []
    for number in range(3):
        density = np.zeros_like(cloud)
        density[:, 2 * number :] = cloud[:, : cloud.shape[1] - 2 * number]
        frames.append(tnst_mi.Frame(density, velocity, name=f"frame_{number:04d}", number=number))
    return frames


@pytest.fixture(scope="module")
def pictures(simulation, renderer, tmp_path_factory) -> Path:
    return write_views(tmp_path_factory.mktemp("pictures"), simulation, renderer, (6, 2), 0.0, GAMMA)


def run(pictures: Path, out: Path, **others):
    return reconstruct(pictures, out, QUICK, frames="0:2", progress=False, **others)


def distances(found: tnst_mi.Reconstruction, simulation: list[tnst_mi.Frame]) -> list[float]:
    pairs = zip(found.densities, simulation, strict=True)
    return [float(np.linalg.norm(np.load(file)["density"] - frame.density)) for file, frame in pairs]


def test_the_next_frame_starts_from_where_the_smoke_has_moved(pictures, simulation, tmp_path):
    tnst_mi.save_frames(tmp_path / "simulation", simulation)
    estimated = run(pictures, tmp_path / "estimated")
    known = run(pictures, tmp_path / "known", velocities=tmp_path / "simulation")
    none = run(pictures, tmp_path / "none", velocities="none")
    for frame in (1, 2):
        e, k, n = (distances(found, simulation)[frame] for found in (estimated, known, none))
        assert k < e < 0.6 * n
    assert [remark for remark in estimated.remarks if "--velocities none" in remark]
    assert not [remark for remark in (*known.remarks, *none.remarks) if "velocities" in remark]
    report = json.loads((tmp_path / "estimated" / "report.json").read_text())
    told = [frame.get("velocity") for frame in report["frames"]]
    assert told[2] is None and told[0]["source"] == "estimated" and 1 < told[0]["mean_in_smoke"] < 3
    assert [record.get("velocity") for record in none.records] == [None] * 3


@pytest.mark.parametrize("format", ["npz", "vdb"])
def test_frames_are_written_with_their_velocities(pictures, simulation, tmp_path, format):
    found = run(pictures, tmp_path / "out", format=format)
    frames = list(open_frames(tmp_path / "out" / "density"))
    assert [frame.number for frame in frames] == [0, 1, 2]
    smoke = simulation[0].density > 0.3
    assert frames[0].velocity[smoke].mean(axis=0) == pytest.approx([0, 2, 0], abs=0.5)
    assert frames[2].velocity is None and len(found.densities) == 3


def test_what_was_stopped_goes_on_to_the_same_bits(pictures, tmp_path, monkeypatch):
    whole = run(pictures, tmp_path / "whole")
    step, taken = MotionDescent.step, []

    def stopped_now_and_then(motion):
        loss = step(motion)
        taken.append(motion.done)
        if len(taken) in (1, 9, 16, 20):  # of 16: also after the last of the first velocity
            signal.raise_signal(signal.SIGINT)
        return loss

    monkeypatch.setattr(MotionDescent, "step", stopped_now_and_then)
    for attempt in range(4):
        assert run(pictures, tmp_path / "parts", resume=attempt > 0).interrupted
    parts = run(pictures, tmp_path / "parts", resume=True)
    assert not parts.interrupted and len(taken) == 32
    for a, b in zip(whole.densities, parts.densities, strict=True):
        with np.load(a) as first, np.load(b) as second:
            assert sorted(first) == sorted(second)
            assert all(np.array_equal(first[name], second[name]) for name in first)
    with pytest.raises(tnst_mi.InputError, match="with other settings, cameras or frames"):
        run(pictures, tmp_path / "parts", velocities="none", resume=True)


def test_frames_without_a_known_velocity_are_told_of(pictures, simulation, tmp_path):
    tnst_mi.save_frames(tmp_path / "simulation", simulation[:1])
    known = run(pictures, tmp_path / "out", velocities=tmp_path / "simulation")
    assert known.records[0]["velocity"]["source"] == "known" and known.records[1]["velocity"] is None
    assert any("has no frame 1" in remark for remark in known.remarks)
