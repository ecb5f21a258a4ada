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
from tnst_mi.reconstruction.fitting.motion import MotionDescent
from tnst_mi.reconstruction.reconstruct import reconstruct
from tnst_mi.reconstruction.velocities import FoundFrames
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

GAMMA = 0.3
QUICK = {"iterations": 16, "motion_iterations": 25, "levels": 2, "batch": 4}
BRIEF = {"iterations": 2, "motion_iterations": 2, "levels": 1, "batch": 4}


@pytest.fixture(scope="module")
def simulation(cloud) -> list[tnst_mi.Frame]:
    """Smoke that moves by 2 cells to +y in every frame, with room to do so."""
    room = np.pad(cloud, ((0, 0), (0, 4), (0, 0)))
    velocity = np.zeros((*room.shape, 3), np.float32)
    velocity[..., 1] = 2
    return [
        tnst_mi.Frame(np.roll(room, 2 * number, axis=1), velocity, name=f"frame_{number:04d}", number=number)
        for number in range(3)
    ]


@pytest.fixture(scope="module")
def pictures(simulation, tmp_path_factory) -> Path:
    """Pictures of it from 8 views and 2 that judge."""
    renderer = EmissionAbsorptionRenderer(simulation[0].density.shape, GAMMA, "exact", 1.0, size=(20, 20))
    return write_views(tmp_path_factory.mktemp("pictures"), simulation, renderer, (8, 2), 0.0, GAMMA)


@pytest.fixture(scope="module")
def estimated(pictures, tmp_path_factory) -> tnst_mi.Reconstruction:
    """What is found of them where nothing else is said."""
    return run(pictures, tmp_path_factory.mktemp("estimated"))


def run(pictures: Path, out: Path, frames: str = "0:2", keys=QUICK, **others) -> tnst_mi.Reconstruction:
    return reconstruct(pictures, out, keys, frames=frames, progress=False, **others)


def distance(found: tnst_mi.Reconstruction, frame: tnst_mi.Frame) -> float:
    """The relative L2 distance of the second density that was found."""
    return float(np.linalg.norm(np.load(found.densities[1])["density"] - frame.density) / np.linalg.norm(frame.density))


def test_the_next_frame_starts_from_where_the_smoke_has_moved(pictures, simulation, estimated, tmp_path):
    tnst_mi.save_frames(tmp_path / "simulation", simulation)
    known = run(pictures, tmp_path / "known", "0:1", velocities=tmp_path / "simulation")
    none = run(pictures, tmp_path / "none", "0:1", velocities="none")
    e, k, n = (distance(found, simulation[1]) for found in (estimated, known, none))
    assert max(k, e) < 0.85 * n
    assert any("--velocities none" in remark for remark in estimated.remarks)
    assert not any("velocities" in remark for remark in (*known.remarks, *none.remarks))
    report = json.loads((estimated.densities[0].parents[1] / "report.json").read_text())
    told = [frame.get("velocity") for frame in report["frames"]]
    assert told[2] is None and told[0]["source"] == "estimated" and told[0]["rms"] < 0.02
    page, none_page = (found.densities[0].parents[1].joinpath("report.html").read_text() for found in (estimated, none))
    assert page.count("<td>estimated</td>") == 2 and f"<td>{100 * told[0]['rms']:.2g}%</td>" in page
    assert "Velocities" not in none_page
    assert [record.get("velocity") for record in none.records] == [None] * 2


def test_frames_are_read_with_their_velocities(simulation, estimated):
    frames = list(open_frames(estimated.densities[0].parent))
    assert [frame.number for frame in frames] == [0, 1, 2] and frames[2].velocity is None
    smoke = simulation[0].density
    mean = np.average(frames[0].velocity.reshape(-1, 3), axis=0, weights=smoke.ravel())
    assert mean == pytest.approx([0, 2, 0], abs=0.1)


def test_the_bits_of_a_density_stay_when_its_velocity_is_added(pictures, tmp_path, monkeypatch):
    """In a file of both, and in a scene whose z is up: its axes are not those of the grid."""
    pictures.with_name("z_up.toml").write_text(pictures.read_text().replace('up_axis = "y"', 'up_axis = "z"'))
    before, add = [], FoundFrames.add_velocity

    def noted(found, record, velocity):
        before.append(open_frames(tmp_path / "out" / record["density"])[0].density)
        return add(found, record, velocity)

    monkeypatch.setattr(FoundFrames, "add_velocity", noted)
    found = run(pictures.with_name("z_up.toml"), tmp_path / "out", "0:1", BRIEF, format="vdb")
    frame = open_frames(found.densities[0])[0]
    assert np.array_equal(frame.density, before[0]) and frame.velocity.shape == (*frame.density.shape, 3)
    assert frame.placement.up == "z"


def test_what_was_stopped_goes_on_to_the_same_bits(pictures, estimated, tmp_path, monkeypatch):
    step, taken = MotionDescent.step, []

    def stopped_now_and_then(motion):
        loss = step(motion)
        taken.append(motion.done)
        if len(taken) in (1, 25, 40, 50):  # on both grids, and after the last of the first velocity
            signal.raise_signal(signal.SIGINT)
        return loss

    monkeypatch.setattr(MotionDescent, "step", stopped_now_and_then)
    for attempt in range(4):
        assert run(pictures, tmp_path / "parts", resume=attempt > 0).interrupted
    parts = run(pictures, tmp_path / "parts", resume=True)
    assert not parts.interrupted and len(taken) == 100
    for a, b in zip(estimated.densities, parts.densities, strict=True):
        with np.load(a) as first, np.load(b) as second:
            assert sorted(first) == sorted(second)
            assert all(np.array_equal(first[name], second[name]) for name in first)
    with pytest.raises(tnst_mi.InputError, match="with other settings, cameras or frames"):
        run(pictures, tmp_path / "parts", velocities="none", resume=True)


def test_frames_without_a_known_velocity_are_told_of(pictures, simulation, tmp_path):
    tnst_mi.save_frames(tmp_path / "simulation", simulation[:1])
    known = run(pictures, tmp_path / "out", keys=BRIEF, velocities=tmp_path / "simulation")
    assert [record.get("velocity", {}) and "known" for record in known.records] == ["known", None, {}]
    assert any("has no frame 1" in remark for remark in known.remarks)
