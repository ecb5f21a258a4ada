"""The view of smoke in colour: which colours are seen, and that grey smoke looks as it did."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jobs import FakeOptimiser, optimiser

from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.job import Run
from tnst_mi.run.prepare import prepare
from tnst_mi.studio.view import opened as opened_module
from tnst_mi.studio.view.lit import LitPainter
from tnst_mi.studio.view.opened import AFTER, BEFORE, opened
from tnst_mi.studio.view.overlay import tinted
from tnst_mi.studio.view.painting import SightPainter
from tnst_mi.studio.view.sight import Sight

__all__ = ["optimiser"]

SHAPE = (10, 12, 8)
RED, BLUE = np.float32([1, 0, 0]), np.float32([0, 0, 1])
RECIPE = Recipe(style=("spirals",), gamma=0.3, octaves=1, iterations=1)
FRONT = Sight(mode=BEFORE, height=SHAPE[1], rows=SHAPE[1], columns=SHAPE[2])


def frame(**grids: np.ndarray) -> Frame:
    density = np.zeros(SHAPE, np.float32)
    density[3:7, 3:9, 2:6] = np.random.default_rng(0).random((4, 6, 4), np.float32) + 0.5
    return Frame(density, name="f", grids=grids)


def halves() -> np.ndarray:
    """Red on the left, and blue."""
    return np.broadcast_to(np.where((np.arange(SHAPE[2]) < 4)[:, None], RED, BLUE), (*SHAPE, 3))


def painter(path: Path, **grids: np.ndarray) -> SightPainter:
    save_frames(path, [frame(**grids)])
    return SightPainter(opened(path))


def test_smoke_is_seen_in_its_colours(tmp_path: Path) -> None:
    shown, grey = painter(tmp_path / "a", Cd=halves()), painter(tmp_path / "b")
    assert shown.opened.coloured and not grey.opened.coloured
    picture, plain = shown.paint(FRONT, RECIPE), grey.paint(FRONT, RECIPE)
    assert picture.shape == (*plain.shape, 3)
    assert picture[:, :3, 2].max() == 0 == picture[:, 5:, 0].max()
    # Linear interpolation of two colours whose sum is 1 has this sum everywhere.
    np.testing.assert_allclose(picture.sum(2)[plain < 1], plain[plain < 1], atol=1e-5)
    np.testing.assert_array_equal(shown.paint(replace(FRONT, coloured=False), RECIPE), plain)
    white = painter(tmp_path / "c", Cd=np.ones((*SHAPE, 3), np.float32)).paint(FRONT, RECIPE)
    np.testing.assert_array_equal(white, np.stack([plain] * 3, axis=-1))
    cut = shown.paint(replace(FRONT, cut=("z", 0.5)), RECIPE)
    np.testing.assert_array_equal(cut.sum(2), grey.paint(replace(FRONT, cut=("z", 0.5)), RECIPE))
    assert cut[:, :4, 0].max() > 0.5 and cut[:, :4, 2].max() == 0


def test_while_the_camera_moves_colours_count_by_their_smoke(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opened_module, "_COARSE_CELLS", 200)
    # Green beyond the smoke.
    colour = np.where(frame().density[..., None] > 0, RED, np.float32([0, 1, 0]))
    coarse = painter(tmp_path / "a", Cd=colour).opened.frame(BEFORE, 0).coarse
    assert coarse.colour is not None and coarse.colour.shape == (*coarse.density.shape, 3) and coarse.h == 2
    np.testing.assert_allclose(coarse.colour[coarse.density > 0], np.broadcast_to(RED, (24, 3)), atol=1e-4)
    np.testing.assert_allclose(coarse.colour.sum(-1), 1, atol=1e-5)


@pytest.mark.parametrize("colour", ["keep", "off"])
def test_runs_are_seen_in_colour_before_and_after(colour: str, tmp_path: Path, optimiser: FakeOptimiser) -> None:
    save_frames(tmp_path / "in", [frame(Cd=halves())])
    list(Run(prepare(tmp_path / "in", replace(RECIPE, colour=colour), tmp_path / "run"), progress=False))
    turned = frame(Cd=halves()[:, :, ::-1])
    save_frames(tmp_path / "run" / "density", [replace(turned, density=2 * turned.density)])
    shown = SightPainter(opened(tmp_path / "run"))
    before, after = (shown.paint(replace(FRONT, mode=side), RECIPE) for side in (BEFORE, AFTER))
    assert before[:, 2, 0].max() > 0.1 and after[:, 2, 2].max() > 0.1
    assert before[:, 2, 2].max() == after[:, 2, 0].max() == 0
    difference = shown.paint(replace(FRONT, mode="difference"), RECIPE)
    assert difference[:, 2].max() > 0.5 and difference[:, 2, 1].max() == 0
    grey = shown.paint(replace(FRONT, mode="difference", coloured=False), RECIPE)
    assert grey[:, 2, 0].max() > 0.5
    np.testing.assert_allclose(grey[:, 2, 1], 0.55 * grey[:, 2, 0], atol=1e-6)


def test_what_is_in_a_mask_has_its_colour_in_place_of_its_own() -> None:
    picture = np.broadcast_to(BLUE, (2, 2, 3))
    found = tinted(picture, np.array([[0.0, 1.0], [0.5, 0.0]]))
    np.testing.assert_array_equal(found[0, 0], BLUE)
    assert found[0, 1].argmax() == 0 and found[0, 1].max() == 1
    np.testing.assert_allclose(found[1, 0], (found[0, 1] + BLUE) / 2)


def test_lit_smoke_has_its_colours(tmp_path: Path) -> None:
    save_frames(tmp_path / "s", [frame(Cd=np.broadcast_to(RED, (*SHAPE, 3)))])
    sight = Sight(mode=BEFORE, look="thick", lit=True, height=14, rows=14, columns=10)
    found = opened(tmp_path / "s")
    red, grey = (LitPainter(found).paint(replace(sight, coloured=coloured)) for coloured in (True, False))
    middle = red[5:9, 4:6].mean((0, 1)), grey[5:9, 4:6].mean((0, 1))
    assert middle[0][2] < 0.6 * middle[0][0] and middle[1][2] > 0.8 * middle[1][0]
