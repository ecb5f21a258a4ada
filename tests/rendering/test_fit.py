"""Images that show all of the grid: what they add to the paper's frame, that nothing is cut off, and what is said."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from fields import smooth_noise
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import random_googlenet

import tnst_mi
from tnst_mi.cli import main
from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.views import camera_frame, common_size, fitted_size, share_cut_off

SIDE = (48, 16, 12)
"""Cells (D, H, W) of a grid that is four times as deep as wide."""

SHAPES = st.tuples(*[st.integers(2, 14)] * 3)
VIEWS = st.tuples(st.floats(-180, 180), st.floats(-90, 90))


def thin(density: np.ndarray, view: tuple[float, float], fit: bool) -> np.ndarray:
    """What little smoke absorbs nothing: the sum of the image is the mass that it shows."""
    return tnst_mi.render(density, view, gamma=1e-6, quadrature="exact", fit=fit)


def test_the_side_of_a_deep_grid_is_seen_whole() -> None:
    density = np.ones(SIDE, np.float32)
    cut, whole = (thin(density, (90, 0), fit).sum() / density.sum() for fit in (False, True))
    assert cut == pytest.approx(0.25, rel=0.01) and whole == pytest.approx(1.0, rel=0.01)
    assert share_cut_off(density, [(90.0, 0.0)], SIDE[1:]) == pytest.approx(0.75)


@given(SHAPES, VIEWS)
@settings(max_examples=40)
def test_the_paper_s_frame_is_the_middle_of_a_larger_one(
    shape: tuple[int, int, int], view: tuple[float, float]
) -> None:
    density = np.abs(smooth_noise(np.random.default_rng(1), *shape))
    plain, fitted = (tnst_mi.render(density, view, gamma=0.3, fit=fit) for fit in (False, True))
    assert fitted.shape == common_size(shape, [view])
    more = [(n - m) // 2 for n, m in zip(fitted.shape, plain.shape, strict=True)]
    assert all((n - m) % 2 == 0 for n, m in zip(fitted.shape, plain.shape, strict=True))
    # A frame may fit a view from the side with fewer columns than the front has.
    inner = [slice(max(m, 0), n - max(m, 0)) for m, n in zip(more, fitted.shape, strict=True)]
    outer = [slice(max(-m, 0), n - max(-m, 0)) for m, n in zip(more, plain.shape, strict=True)]
    np.testing.assert_allclose(fitted[tuple(inner)], plain[tuple(outer)], atol=2e-5 * max(fitted.max(), 1e-9))


@given(SHAPES, VIEWS)
@settings(max_examples=40)
def test_nothing_is_outside(shape: tuple[int, int, int], view: tuple[float, float]) -> None:
    """By the corners of the grid; and a frame with two rows or columns less would cut them off."""
    rows, columns = common_size(shape, [view])
    right, up, _ = camera_frame(*view)
    corners = np.array(list(itertools.product(*((-n / 2, n / 2) for n in shape[::-1]))))
    for axis, size in ((right, columns), (up, rows)):
        reach = 2 * np.abs(corners @ axis).max()
        assert size - 2 < reach + 1e-5 and reach <= size + 1e-5
    assert share_cut_off(np.ones(shape, np.float32), [view], (rows, columns)) == 0.0


def test_ranges_have_the_largest_of_their_views() -> None:
    sizes = [common_size(SIDE, [(azimuth, 0.0)]) for azimuth in np.linspace(-90, 90, 181)]
    assert fitted_size(SIDE, (-90.0, 90.0), (0.0, 0.0)) == tuple(np.max(sizes, axis=0)) == (16, 50)
    assert fitted_size(SIDE, (0.0, 0.0), (0.0, 0.0)) == SIDE[1:]


@given(SHAPES, VIEWS, st.integers(0, 100))
@settings(max_examples=40)
def test_what_is_cut_off_is_what_a_projection_says(
    shape: tuple[int, int, int], view: tuple[float, float], seed: int
) -> None:
    density = np.random.default_rng(seed).random(shape, np.float32)
    density[density < 0.8] = 0
    a, e = np.radians(view)
    z, y, x = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in shape), indexing="ij")
    across = x * np.cos(a) - z * np.sin(a)
    above = y * np.cos(e) - (x * np.sin(a) + z * np.cos(a)) * np.sin(e)
    outside = (np.abs(across) > shape[2] / 2 + 1e-6) | (np.abs(above) > shape[1] / 2 + 1e-6)
    expected = density[outside].sum() / density.sum() if density.any() else 0.0
    assert share_cut_off(density, [view], shape[1:]) == pytest.approx(expected, abs=1e-5)


def test_a_derivative_sees_what_a_larger_frame_shows() -> None:
    """By differences, of a cell that only the larger frame shows."""
    density = np.abs(smooth_noise(np.random.default_rng(3), *SIDE)) + 0.1
    cell, step = (2, 8, 6), 0.05

    def total(change: float) -> float:
        changed = density.copy()
        changed[cell] += change
        return float(tnst_mi.render(changed, (60, 5), gamma=0.05, fit=True).sum(dtype=np.float64))

    torch = pytest.importorskip("torch")
    leaf = torch.tensor(density, requires_grad=True)
    tnst_mi.render(leaf, (60, 5), gamma=0.05, fit=True).sum().backward()
    by_differences = (total(step) - total(-step)) / (2 * step)
    assert by_differences > 0.1
    assert float(leaf.grad[cell]) == pytest.approx(by_differences, rel=5e-3)
    cut = torch.tensor(density, requires_grad=True)
    tnst_mi.render(cut, (60, 5), gamma=0.05).sum().backward()
    assert float(cut.grad[cell]) == 0.0


@pytest.mark.parametrize("integrator", ["emission_absorption", "prbvolpath"])
def test_a_run_says_what_is_cut_off_and_fits_if_asked(
    integrator: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    random_googlenet(tmp_path / "random.safetensors", narrow=8)
    z, y, x = np.indices(SIDE)
    density = np.exp(-(((z - 24) / 12) ** 2 + ((y - 8) / 4) ** 2 + ((x - 6) / 3) ** 2)).astype(np.float32)
    keys = {"semantic": ["inception_3a/3x3:2"], "iterations": 1, "octaves": 2, "views": 2, "azimuth": [60, 100]}
    keys |= {"weights": str(tmp_path / "random.safetensors"), "integrator": integrator, "spp": 1}
    changes, warned = (
        [],
        "of the smoke is outside the images of views from the side; fit = true",
    )
    for fit in (False, True):
        result = tnst_mi.stylize(density, Recipe.from_dict(keys | {"fit": fit}), tmp_path / f"{integrator}{fit}")
        changes.append(np.abs(result.densities[0] - density)[:12].sum())
        assert (warned in capsys.readouterr().err) is not fit
        image = tmp_path / f"{integrator}{fit}" / "images" / "frame_before.png"
        assert image.exists()
    # The ends of the smoke are out of sight of the smaller frame.
    assert changes[1] > 2 * changes[0]


def test_the_command_fits_too(tmp_path: Path) -> None:
    save_frames(tmp_path / "deep.npz", Frame(np.ones(SIDE, np.float32), name="deep"))
    arguments = ["render", str(tmp_path / "deep.npz"), "--views", "90,0", "0,0"]
    assert main([*arguments, "--out", str(tmp_path / "cut")]) == 0
    assert main([*arguments, "--fit", "--out", str(tmp_path / "whole")]) == 0
    image = pytest.importorskip("PIL.Image")
    sizes = [image.open(tmp_path / folder / "deep_view_90_0.png").size for folder in ("cut", "whole")]
    assert sizes == [(12, 16), (48, 16)]
