"""Grids of any proportions: whole runs end, with finite results, previews and all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tnst_mi
from tnst_mi.frame import Frame
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.before_after import side_by_side


def puff(shape: tuple[int, int, int], number: int) -> Frame:
    """Smoke that fills the middle third of a grid and drifts along x."""
    density = np.ones(shape, np.float32)
    for axis, n in enumerate(shape):
        position = (np.arange(n) - (n - 1) / 2 - (0.3 * number if axis == 2 else 0)) / max(n / 3, 1)
        density = density * np.exp(-np.square(position)).reshape([-1 if i == axis else 1 for i in range(3)])
    velocity = np.zeros((*shape, 3), np.float32)
    velocity[..., 0] = 0.3
    return Frame(density, velocity=velocity, name=f"puff_{number}", number=number)


@pytest.mark.parametrize(
    "shape", [(48, 12, 48), (50, 2, 50), (30, 1, 30), (4, 4, 120), (4, 120, 4), (1, 60, 3), (1, 1, 1)]
)
def test_a_run_ends_whatever_the_proportions(shape: tuple[int, int, int], weights: Path, tmp_path: Path) -> None:
    recipe = Recipe(semantic=("inception_3a/3x3:2",), weights=str(weights), octaves=3, iterations=1, views=1, window=3)
    frames = [puff(shape, number) for number in range(3)]
    result = tnst_mi.stylize(frames, recipe, out=tmp_path / "out", progress=False)
    for density, frame in zip(result.densities, frames, strict=True):
        assert density.shape == shape and np.isfinite(density).all() and density.min() >= 0
        assert np.linalg.norm(density - frame.density) < np.linalg.norm(frame.density)
    assert (tmp_path / "out" / "images" / "contact_sheet.png").exists()


def random_shapes(count: int) -> list[tuple[int, int, int]]:
    """Grids of 1 to 200 cells along each axis, one up to 40 times as long as another, of bounded size."""
    generator, shapes = np.random.default_rng(7), []
    while len(shapes) < count:
        shape = tuple(int(n) for n in np.exp(generator.uniform(0, np.log(200.5), 3)))
        if max(shape) <= 40 * min(shape) and np.prod(shape) <= 60_000:
            shapes.append(shape)
    return shapes


@pytest.mark.parametrize(("shape", "window"), list(zip(random_shapes(20), [1, 3] * 10, strict=True)), ids=str)
def test_random_proportions(shape: tuple[int, int, int], window: int, weights: Path, tmp_path: Path) -> None:
    """Whole runs end, say nothing untrue, and change smoke; whatever the octaves make of thin axes."""
    recipe = Recipe(
        style=("net",),
        style_layers={"conv2/3x3": 1.0},
        weights=str(weights),
        # On a line, nothing can move without divergence.
        lam=0.5,
        iterations=1,
        views=2,
        window=window,
    )
    result = tnst_mi.stylize([puff(shape, number) for number in range(3)], recipe, out=tmp_path / "out", progress=False)
    for density, frame in zip(result.densities, result.frames, strict=True):
        assert np.isfinite(density).all() and density.min() >= 0
        assert np.linalg.norm(density - frame.density) < np.linalg.norm(frame.density)
    assert [frame["note"] for frame in result.run["frames"]] == [None] * 3
    assert (tmp_path / "out" / "images" / "contact_sheet.png").exists()


@pytest.mark.parametrize(
    ("picture", "joined"),
    [
        ((64, 48), (448, 98 * 7)),
        ((2, 50), (36, 102 * 18)),
        ((1, 1), (400, 4 * 400)),
        ((500, 300), (500, 602)),
        ((300, 3000), (300, 6002)),
        ((1000, 10_000), (410, 8192)),
    ],
)
def test_pictures_side_by_side_are_enlarged_as_far_as_they_fit(
    picture: tuple[int, int], joined: tuple[int, int]
) -> None:
    image = np.zeros(picture, np.float32)
    assert side_by_side(image, image).shape == joined
