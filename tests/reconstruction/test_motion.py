"""The velocity between two frames from their pictures: motions that are known, none, and where there is no smoke."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from render_views import write_views

import tnst_mi
from tnst_mi.reconstruction.fitting.motion import GRADIENT, MotionDescent
from tnst_mi.reconstruction.one_frame import FrameReconstruction
from tnst_mi.reconstruction.preparation import NONE, prepare
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

GAMMA, SHAPE = 0.3, (16, 20, 16)


def ball(z: float, y: float, x: float, radius: float = 4.0) -> np.ndarray:
    """A soft ball whose centre is so many cells from that of the grid."""
    places = np.indices(SHAPE, np.float32) - (np.array(SHAPE, np.float32)[:, None, None, None] - 1) / 2
    far = np.sqrt(sum((places[axis] - centre) ** 2 for axis, centre in enumerate((z, y, x))))
    return np.clip(1.5 * (1 - far / radius), 0, 1).astype(np.float32)


def found(before: np.ndarray, after: np.ndarray, folder: Path, steps: int = 25, noise: float = 0.0) -> np.ndarray:
    """The velocity from one density to the other, by pictures of the latter from 6 views."""
    renderer = EmissionAbsorptionRenderer(SHAPE, GAMMA, "exact", 1.0, size=(20, 20))
    prepared = prepare(
        write_views(folder, [tnst_mi.Frame(after)], renderer, (6, 0), noise, GAMMA), {"levels": 2}, None, NONE
    )
    frame = FrameReconstruction(
        prepared.settings, prepared.levels, prepared.photographs(None), 1 / GAMMA, 0.0, before * GAMMA, 1
    )
    motion = None
    for level in range(2):
        motion = MotionDescent(frame.descent(level, None), None, SHAPE, motion, frame.noise, 6 * 400, steps)
        for _ in range(steps):
            motion.step()
    assert motion is not None
    return motion.velocity(SHAPE)


def test_a_ball_that_moves_is_followed(tmp_path):
    shift = (1.5, -2, 1)
    before, after = ball(0, 0, 0), ball(*shift)
    u = found(before, after, tmp_path, 50)
    mean = np.average(u.reshape(-1, 3), axis=0, weights=before.ravel())
    assert mean == pytest.approx(shift[::-1], abs=0.2)  # x, y, z
    moved = tnst_mi.advect(before, u, trace="flow")
    assert np.linalg.norm(moved - after) < 0.15 * np.linalg.norm(after)
    assert moved.sum() == pytest.approx(before.sum(), rel=0.02)  # no smoke is made nor lost


def test_smoke_that_turns_is_followed(tmp_path):
    """Two balls of different sizes go round each other by 20°."""
    angle = np.radians(20)
    c, s = 5 * np.cos(angle), 5 * np.sin(angle)
    before = ball(0, 0, 5, 3.0) + ball(0, 0, -5, 2.5)
    after = ball(s, 0, c, 3.0) + ball(-s, 0, -c, 2.5)
    u = found(before, after, tmp_path)
    for side, turned in ((slice(8, None), 1), (slice(None, 8), -1)):
        smoke = before[:, :, side]
        mean = np.average(u[:, :, side].reshape(-1, 3), axis=0, weights=smoke.ravel())
        assert mean == pytest.approx([turned * (c - 5), 0, turned * s], abs=0.35)
    moved = tnst_mi.advect(before, u, trace="flow")
    assert np.linalg.norm(moved - after) < 0.4 * np.linalg.norm(before - after)


def test_smoke_that_rests_has_no_velocity(tmp_path):
    u = found(ball(0, 0, 0), ball(0, 0, 0), tmp_path, 15)
    assert np.abs(u[ball(0, 0, 0) > 0]).mean() < 0.03
    assert np.abs(u).max() < 0.2  # also far from it, where pictures decide nothing


def test_noise_does_not_make_velocities_explode(tmp_path):
    """Thin smoke that rests, in pictures whose noise is a fifth as bright: ∇u stays as small as it is taken to be."""
    thin = ball(0, 0, 0) * 0.05
    u = found(thin, thin, tmp_path, 15, noise=0.2)
    gradient = sum((np.diff(u, axis=axis) ** 2).mean() for axis in range(3)) * 3
    assert gradient < 0.5 * GRADIENT**2 and np.abs(u).max() < 0.5
