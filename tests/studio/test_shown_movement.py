"""v* in the view: arrows and depth, against movements that are known."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.studio.view.movement import MOST_ARROWS
from tnst_mi.studio.view.opened import Opened, opened
from tnst_mi.studio.view.painting import SightPainter
from tnst_mi.studio.view.sight import Sight
from tnst_mi.studio.view.wheel import coloured_by_depth

SHAPE = (12, 16, 20)


@pytest.fixture
def moved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[np.ndarray], SightPainter]:
    """Paints a block of smoke in the middle of a grid, as if a run had moved it by a velocity (x, y, z) in cells."""
    density = np.zeros(SHAPE, np.float32)
    density[3:9, 4:12, 5:15] = 1.0
    save_frames(tmp_path / "smoke", [Frame(density, name="smoke")])

    def painter(velocity: np.ndarray) -> SightPainter:
        field = np.broadcast_to(np.asarray(velocity, np.float32), (*SHAPE, 3))
        monkeypatch.setattr(Opened, "has_after", property(lambda self: True))
        monkeypatch.setattr(Opened, "velocity", lambda self, index: field)
        monkeypatch.setattr(Opened, "_source", lambda self, side: self.results.frames)
        return SightPainter(opened(tmp_path / "smoke"))

    return painter


@pytest.mark.parametrize(
    ("azimuth", "elevation", "expected"),
    [
        (0, 0, (2.0, 3.0)),  # from the front: x to the right, y up
        (90, 0, (1.0, 3.0)),  # from the right: z, which is (2, 3, -1)'s third component, to the left
        (180, 0, (-2.0, 3.0)),
        (0, 90, (2.0, 1.0)),  # from above: z downwards
    ],
)
def test_arrows_point_where_the_smoke_goes(
    moved: Callable[[np.ndarray], SightPainter], azimuth: float, elevation: float, expected: tuple[float, float]
) -> None:
    sight = Sight(azimuth=azimuth, elevation=elevation, height=32, rows=320, columns=480)
    found = moved(np.array([2, 3, -1])).arrows(sight)
    assert found.cell == 10.0 and found.usual == pytest.approx(math.sqrt(14))
    assert 20 < len(found.steps) < MOST_ARROWS
    np.testing.assert_allclose(found.steps, np.broadcast_to(10 * np.array(expected), found.steps.shape), atol=0.05)


def test_arrows_begin_in_the_smoke_and_are_few(moved: Callable[[np.ndarray], SightPainter]) -> None:
    painter = moved(np.array([1, 0, 0]))
    for rows, columns, pan in ((320, 480, 0.0), (1080, 1260, 0.0), (400, 111, 0.0), (90, 1900, 0.0), (320, 480, 4.0)):
        found = painter.arrows(Sight(height=16, pan=(pan, 0.0), rows=rows, columns=columns))
        assert 0 < len(found.places) <= MOST_ARROWS
        # The block is 10 cells wide and 8 high, and fades over half a cell around it. The camera moves, so it goes the
        # other way.
        x = (found.places[:, 0] - columns / 2) / found.cell + pan
        y = (found.places[:, 1] - rows / 2) / found.cell
        assert np.abs(x).max() < 5.5 and np.abs(y).max() < 4.5
        if columns > 400:
            spacing = found.spacing / found.cell
            assert np.abs(x.mean()) < spacing and np.abs(x).max() > 5 - spacing


def test_arrows_are_means_over_the_smoke_along_rays(moved: Callable[[np.ndarray], SightPainter]) -> None:
    velocity = np.zeros((*SHAPE, 3), np.float32)
    velocity[3:6, ..., 0] = 4.0  # of six cells of smoke along a ray, three
    found = moved(velocity).arrows(Sight(height=16, rows=160, columns=160))
    middle = np.hypot(*(found.places - 80).T) < 30
    assert middle.any()
    np.testing.assert_allclose(found.steps[middle], np.broadcast_to([20.0, 0.0], found.steps[middle].shape), atol=0.3)


@pytest.mark.parametrize(
    ("azimuth", "elevation", "cut", "towards"),
    [
        (0, 0, None, 1),  # +z comes towards who looks from the front
        (180, 0, None, -1),
        (90, 0, None, 0),
        (0, 0, ("z", 0.5), 1),
        (0, 0, ("x", 0.5), 0),
    ],
)
@pytest.mark.parametrize("perspective", [False, True])
def test_depth_is_orange_towards_the_eye_and_blue_away(
    moved: Callable[[np.ndarray], SightPainter],
    azimuth: float,
    elevation: float,
    cut: tuple[str, float] | None,
    towards: int,
    perspective: bool,
) -> None:
    sight = Sight(
        mode="depth",
        azimuth=azimuth,
        elevation=elevation,
        cut=cut,
        perspective=perspective,
        height=16,
        rows=64,
        columns=64,
    )
    red, _, blue = moved(np.array([0, 0, 2])).paint(sight, Recipe())[32, 32]
    if towards == 0:
        assert red == pytest.approx(blue, abs=0.03) and red > 0.1
    else:
        assert (red - blue) * towards > 0.1


def test_in_cuts_x_and_y_come_towards_the_eye(moved: Callable[[np.ndarray], SightPainter]) -> None:
    for axis, velocity in (("x", (2, 0, 0)), ("y", (0, 2, 0))):
        for sign in (1, -1):
            sight = Sight(mode="depth", cut=(axis, 0.5), rows=64, columns=64)
            red, _, blue = moved(sign * np.array(velocity)).paint(sight, Recipe())[32, 32]
            assert (red - blue) * sign > 0.5


def test_the_colours_of_depth() -> None:
    def colour(towards: float, brightness: float = 1.0) -> list[float]:
        return coloured_by_depth(np.array([[towards]]), np.array([[brightness]]), 2.0)[0, 0].tolist()

    assert colour(2) == pytest.approx([1, 0.55, 0.1]) and colour(9) == colour(2)
    assert colour(-2) == pytest.approx([0.15, 0.5, 1])
    assert colour(0, 0.4) == pytest.approx([0.4, 0.4, 0.4])
    assert colour(1) == pytest.approx([1, 0.775, 0.55])


def test_arrows_are_of_runs_and_not_of_cuts(
    moved: Callable[[np.ndarray], SightPainter], monkeypatch: pytest.MonkeyPatch
) -> None:
    painter = moved(np.array([1, 0, 0]))
    with pytest.raises(InputError, match="take the cut away"):
        painter.arrows(Sight(cut=("x", 0.5)))
    monkeypatch.setattr(Opened, "has_after", property(lambda self: False))
    for act in (lambda: painter.arrows(Sight()), lambda: painter.paint(Sight(mode="depth"), Recipe())):
        with pytest.raises(InputError, match="open one"):
            act()
