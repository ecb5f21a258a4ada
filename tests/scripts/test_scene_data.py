"""The bundled frames: their format, their size, and that the velocities carry the densities."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

CHECKOUT = Path(__file__).resolve().parents[2]
SCENES = CHECKOUT / "scenes"
FRAMES = {
    "suzanne": ([10], (64, 96, 64)),
    "smokejet": (list(range(57, 66)), (48, 72, 48)),
}


def load(scene: str, frame: int) -> tuple[np.ndarray, np.ndarray]:
    with np.load(SCENES / scene / f"frame_{frame:04d}.npz", allow_pickle=False) as arrays:
        assert set(arrays) == {"density", "velocity"}
        return arrays["density"], arrays["velocity"]


def trilinear(field: np.ndarray, z: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Oracle: interpolate at cell-centred index positions, 0 outside the grid."""
    padded = np.pad(np.float64(field), 1)
    positions = [np.clip(p + 1, 0, n - 1.001) for p, n in zip((z, y, x), padded.shape, strict=True)]
    lower = [p.astype(int) for p in positions]
    result = np.zeros(z.shape)
    for corner in np.ndindex(2, 2, 2):
        weight = 1.0
        for p, i, c in zip(positions, lower, corner, strict=True):
            weight = weight * ((p - i) if c else 1.0 - (p - i))
        result += weight * padded[tuple(i + c for i, c in zip(lower, corner, strict=True))]
    return result


def carried(density: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Oracle: one semi-Lagrangian step by a velocity (x, y, z) in cells per frame."""
    z, y, x = np.indices(density.shape)
    vx, vy, vz = np.moveaxis(np.float64(velocity), -1, 0)
    return trilinear(density, z - vz, y - vy, x - vx)


@pytest.mark.parametrize("scene", FRAMES)
def test_frames_have_the_documented_format(scene: str) -> None:
    frames, shape = FRAMES[scene]
    assert sorted(path.name for path in (SCENES / scene).glob("*.npz")) == [f"frame_{f:04d}.npz" for f in frames]
    for frame in frames:
        density, velocity = load(scene, frame)
        assert density.shape == shape and density.dtype == np.float32
        assert velocity.shape == (*shape, 3) and velocity.dtype == np.float16
        assert np.isfinite(density).all() and np.isfinite(velocity).all()
        assert density.min() == 0.0 and 0.9 < density.max() <= 1.0
        assert 1.0 < np.abs(velocity).max() < 8.0, "cells per frame"


@pytest.mark.parametrize("scene", FRAMES)
def test_meta_describes_the_frames(scene: str) -> None:
    frames, shape = FRAMES[scene]
    meta = json.loads((SCENES / scene / "meta.json").read_text(encoding="utf-8"))
    assert meta["frames"] == frames and meta["shape_dhw"] == list(shape)
    assert "MIT" in meta["licence"]
    np.testing.assert_allclose(meta["domain_size_m_xyz"], meta["cell_size_m"] * np.array(shape)[::-1])


def test_both_scenes_together_stay_small() -> None:
    assert sum(path.stat().st_size for path in SCENES.rglob("*") if path.is_file()) < 7e6


@pytest.mark.parametrize("frame", FRAMES["smokejet"][0][:-1])
def test_velocity_carries_each_jet_frame_to_the_next(frame: int) -> None:
    density, velocity = load("smokejet", frame)
    following, _ = load("smokejet", frame + 1)
    inside = np.s_[2:-2, 2:-2, 2:-2]

    def error(estimate: np.ndarray) -> float:
        return float(np.sqrt(np.square(estimate - following)[inside].mean()))

    assert error(carried(density, velocity)) < 0.6 * error(density)
    for wrong in (-velocity, velocity[..., ::-1], 0.5 * velocity, 2.0 * velocity):
        assert error(carried(density, velocity)) < error(carried(density, wrong))


def make_scenes() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_scenes", CHECKOUT / "scripts" / "make_scenes.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_averaging_keeps_constants_and_the_total_and_takes_exact_overlaps() -> None:
    matrix = make_scenes().averaging_matrix(4, 3)
    np.testing.assert_allclose(matrix, np.array([[3, 1, 0, 0], [0, 2, 2, 0], [0, 0, 1, 3]]) / 4, atol=1e-15)
    field = np.random.default_rng(0).random((8, 12, 16, 3))
    coarse = make_scenes().averaged_down(field, 0.75)
    assert coarse.shape == (6, 9, 12, 3)
    np.testing.assert_allclose(coarse.mean((0, 1, 2)), field.mean((0, 1, 2)), rtol=1e-12)


def test_the_script_makes_exactly_the_bundled_frames(asset, tmp_path: Path) -> None:
    script = make_scenes()
    script.make_suzanne(asset("data/suzanne"), tmp_path / "suzanne")
    script.make_smokejet(asset("data/smokejet"), tmp_path / "smokejet")
    for path in tmp_path.rglob("*.npz"):
        bundled = load(path.parent.name, int(path.stem[-4:]))
        with np.load(path) as made:
            np.testing.assert_array_equal(made["density"], bundled[0])
            np.testing.assert_array_equal(made["velocity"], bundled[1])
