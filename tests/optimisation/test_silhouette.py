"""The outline in the main view: how far cells inside and outside may be moved, and that the outline then stays."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from fields import blob, smooth_noise
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import random_googlenet

import tnst_mi
from tnst_mi.frame import Frame
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.parameterisation import Fields, Transport
from tnst_mi.optimisation.silhouette import displacement_allowed, distance_inside
from tnst_mi.optimisation.single_frame import optimise
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.views import camera_frame
from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

GOAL = {
    "semantic": ("inception_3a/3x3:2",),
    "lam": 1.0,
    "octaves": 2,
    "iterations": 4,
    "views": 2,
    "eta": 0.1,
    "gamma": 1.0,
}
RECIPE = Recipe(**GOAL)


@given(st.tuples(st.integers(1, 9), st.integers(1, 9)), st.integers(0, 1000), st.floats(0.1, 0.95))
@settings(max_examples=60)
def test_distances_are_those_to_the_nearest_pixel_outside(shape: tuple[int, int], seed: int, share: float) -> None:
    mask = np.random.default_rng(seed).random(shape) < share
    padded = np.pad(mask, 1)
    outside = np.argwhere(~padded)
    expected = [
        [np.hypot(*(outside - place).T).min() for place in row] for row in np.moveaxis(np.indices(padded.shape), 0, -1)
    ]
    np.testing.assert_allclose(distance_inside(mask), np.array(expected)[1:-1, 1:-1])


@pytest.mark.parametrize("view", [(0.0, 0.0, 45.0), (35.0, 20.0, 60.0), (-70.0, -10.0, 300.0)])
def test_in_perspective_no_movement_within_what_is_allowed_takes_a_cell_out_of_the_outline(
    view: tuple[float, float, float],
) -> None:
    """Oracle: every cell of a ball is moved as far as it may be in 40 directions, and projected."""
    shape, keep = (30, 40, 34), 0.5
    recipe = dataclasses.replace(RECIPE, azimuth=(0.0, 0.0), elevation=(0.0, 0.0), shots=(view,))
    density = ball(shape, 12.0)
    allowed = displacement_allowed(density, recipe, shape[1:], keep)
    assert allowed[shape[0] // 2, shape[1] // 2, shape[2] // 2] > 6.0
    freed = (allowed > keep + 1e-6) & (density > 0)
    z, y, x = np.nonzero(freed)
    cells = np.stack([x, y, z], axis=-1) - (np.array(shape[::-1]) - 1) / 2
    renderer = EmissionAbsorptionRenderer(shape, recipe.gamma, "transmittance", 1.0)
    outline = renderer.render(mi.TensorXf(density), [view]).numpy()[0] > 0.05
    right, up, towards = camera_frame(*view[:2])
    directions = np.random.default_rng(3).normal(size=(40, 3))
    for direction in directions / np.linalg.norm(directions, axis=1, keepdims=True):
        places = cells + allowed[freed][:, None] * direction
        nearness = view[2] / (view[2] - places @ towards)
        row = np.rint((shape[1] - 1) / 2 - places @ up * nearness).astype(int)
        column = np.rint((shape[2] - 1) / 2 + places @ right * nearness).astype(int)
        assert outline[row, column].all()


def ball(shape: tuple[int, int, int], radius: float) -> np.ndarray:
    z, y, x = (np.arange(n) - (n - 1) / 2 for n in shape)
    inside = np.sqrt(z[:, None, None] ** 2 + y[:, None] ** 2 + x**2) < radius
    return inside.astype(np.float32)


@pytest.mark.parametrize("view", [(0.0, 0.0), (90.0, 0.0), (35.0, 20.0)])
def test_a_cell_may_move_as_far_as_it_lies_inside_a_ball(view: tuple[float, float]) -> None:
    """From every side the outline of a ball is a circle of its radius."""
    shape, radius = (30, 40, 34), 12.0
    recipe = dataclasses.replace(RECIPE, azimuth=(view[0], view[0]), elevation=(view[1], view[1]))
    allowed = displacement_allowed(ball(shape, radius), recipe, shape[1:], 1.5)
    z, y, x = (np.arange(n) - (n - 1) / 2 for n in shape)
    a, e = np.radians(view)
    across = np.cos(a) * x - np.sin(a) * z[:, None, None] + 0 * y[:, None]
    upwards = np.cos(e) * y[:, None] - np.sin(e) * (np.sin(a) * x + np.cos(a) * z[:, None, None])
    depth = radius - np.hypot(across, upwards)
    np.testing.assert_allclose(allowed, np.maximum(depth, 1.5), atol=2.5)
    assert (allowed <= np.maximum(depth, 1.5) + 0.6).all(), "on the safe side, but for half a cell of soft edge"
    assert (allowed[depth < -1] == 1.5).all()


@given(st.integers(0, 99), st.floats(0.1, 4.0))
@settings(max_examples=15)
def test_no_cell_is_faster_than_it_may_be(seed: int, size: float) -> None:
    rng, transport, shape = np.random.default_rng(seed), Transport(0.4), (9, 12, 10)
    fields = Fields(
        {
            name: mi.TensorXf(np.float32(size) * smooth_noise(rng, *s))
            for name, s in (("phi", shape), ("psi", (*shape, 3)))
        }
    )
    allowed = np.float32(rng.uniform(0.05, 0.5, shape))
    speed = np.linalg.norm(transport.velocity(fields, 1.0).numpy(), axis=-1)
    bounded = transport.within(fields, mi.TensorXf(allowed), 1.0)
    found = np.linalg.norm(transport.velocity(bounded, 1.0).numpy(), axis=-1)
    assert (found <= allowed).all()
    if (speed <= allowed).all():
        np.testing.assert_array_equal(found, speed)


# ---------------------------------------------------------------- whole runs

SHAPE = (18, 36, 26)


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> GoogLeNet:
    """A narrow GoogLeNet with random weights."""
    path: Path = tmp_path_factory.mktemp("weights") / "random.safetensors"
    random_googlenet(path, narrow=8)
    return GoogLeNet.load(path)


def outline(density: np.ndarray) -> np.ndarray:
    return tnst_mi.render(density, gamma=1.0, quadrature="transmittance") > 0.05


def farthest_moved(before: np.ndarray, after: np.ndarray) -> float:
    """How deep any pixel that left or joined an outline lay inside or outside of it, in pixels."""
    left = distance_inside(before)[before & ~after]
    joined = distance_inside(np.pad(~before, 20, constant_values=True))[20:-20, 20:-20][after & ~before]
    return float(max([0.0, *left, *joined]))


@pytest.mark.parametrize(
    "keys", [{}, {"transport": "flow", "lam": 0.0, "eta": 0.3}, {"reach": "30%", "octaves": 3, "iterations": 8}]
)
def test_the_outline_stays_where_it_is_and_the_inside_does_not(keys: dict, network: GoogLeNet) -> None:
    rng = np.random.default_rng(3)
    cloud = blob(SHAPE, (12.5, 17, 8), 5) * (1 + 2 * np.abs(smooth_noise(rng, *SHAPE)))
    frame = Frame(np.clip(2 * cloud - 0.6, 0, 1), name="cloud")
    free, kept = (
        optimise(frame, Recipe(**GOAL | {"keep_silhouette": length} | keys), network) for length in ("off", 1.0)
    )
    before = outline(frame.density)
    # Interpolation reads a cell beyond, and a pixel changes where its opacity passes the threshold.
    assert farthest_moved(before, outline(kept.density)) <= 2.0 < farthest_moved(before, outline(free.density))
    assert np.linalg.norm(kept.density - frame.density) > 0.1 * np.linalg.norm(free.density - frame.density)
