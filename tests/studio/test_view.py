"""What the view shows: the images of the stylizer, from everywhere; cuts; before, after and what lies between."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jobs import FakeOptimiser, optimiser
from PIL import Image
from studios import Studio, running

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering import looks
from tnst_mi.rendering.driving import main_view
from tnst_mi.run.job import Run
from tnst_mi.run.prepare import prepare
from tnst_mi.studio.view import opened as opened_module
from tnst_mi.studio.view.opened import AFTER, BEFORE, opened, pooled
from tnst_mi.studio.view.painting import SightPainter
from tnst_mi.studio.view.sight import Sight
from tnst_mi.studio.view.wheel import coloured

__all__ = ["optimiser"]

SHAPE = (10, 12, 8)
RECIPE = Recipe(style=("spirals",), gamma=0.3, octaves=1, iterations=1, azimuth=(0, 40), elevation=(0, 10))


def smoke(number: int, density: float = 1.0) -> Frame:
    """A box of smoke left of the middle, in the upper half and near the viewer."""
    values = np.zeros(SHAPE, np.float32)
    values[6:9, 7:11, 1:3] = density
    return Frame(values, name=f"f_{number:02d}", number=number)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    save_frames(tmp_path / "smoke", [smoke(1), smoke(2, 0.5)])
    return tmp_path / "smoke"


@pytest.fixture
def run_folder(source: Path, tmp_path: Path, optimiser: FakeOptimiser) -> Path:
    """A run whose results are twice as dense, with v* = (3, 4, 0)."""
    list(Run(prepare(source, RECIPE, tmp_path / "run"), progress=False))
    return tmp_path / "run"


def centre(picture: np.ndarray) -> tuple[float, float]:
    """Where the light of a picture is, from 0 to 1: to the right, and upwards."""
    rows, columns = picture.shape
    y, x = (np.arange(n) + 0.5 for n in picture.shape)
    return float(picture.sum(0) @ x / picture.sum() / columns), 1 - float(picture.sum(1) @ y / picture.sum() / rows)


def test_the_main_view_is_what_the_network_sees(source: Path) -> None:
    shown = opened(source)
    azimuth, elevation = RECIPE.main_view[:2]
    sight = Sight(azimuth=azimuth, elevation=elevation, height=SHAPE[1], rows=SHAPE[1], columns=SHAPE[2])
    expected = main_view(shown.frame(BEFORE, 0).full.density, RECIPE)
    picture = SightPainter(shown).paint(sight, RECIPE)
    darker = (expected > 0.1 * expected.max()) & (picture < 1)
    exposure = picture[darker][0] / expected[darker][0]
    assert darker.sum() > 5 and exposure > 0.2
    np.testing.assert_allclose(picture, np.minimum(exposure * expected, 1.0), atol=2e-4)


def test_all_frames_and_sides_have_one_exposure(run_folder: Path) -> None:
    painter = SightPainter(opened(run_folder))
    thin = Recipe(gamma=1e-4)
    before, after = (painter.paint(Sight(mode=side, rows=24, columns=24, height=24), thin) for side in (BEFORE, AFTER))
    # Of thin smoke twice as much is twice as bright, up to what the display can show.
    assert before.max() > 0.5 and after.max() == 1.0
    np.testing.assert_allclose(after, np.minimum(2 * before, 1), atol=1e-3)
    second = painter.paint(Sight(frame=1, mode=BEFORE, rows=24, columns=24, height=24), thin)
    np.testing.assert_allclose(second, before / 2, atol=1e-3)


def test_a_run_is_shown_with_the_exposure_that_its_network_saw(run_folder: Path, tmp_path: Path) -> None:
    record = json.loads((run_folder / "run.json").read_text())
    assert len({frame["exposure"] for frame in record["frames"]}) == 1
    # As if each frame had a γ of its own.
    record["frames"][1]["exposure"] *= 0.25
    (run_folder / "run.json").write_text(json.dumps(record))
    shown = opened(run_folder)
    azimuth, elevation = RECIPE.main_view[:2]
    for index, of_frame in enumerate(record["frames"]):
        for side in (BEFORE, AFTER):
            sight = Sight(index, side, azimuth=azimuth, elevation=elevation, height=12, rows=12, columns=8)
            expected = of_frame["exposure"] * main_view(shown.frame(side, index).full.density, RECIPE)
            np.testing.assert_allclose(SightPainter(shown).paint(sight, RECIPE), np.minimum(expected, 1), atol=2e-4)
    # Of another thickness, of a look, and of smoke that nobody has stylized, it is measured, for all frames alike.
    painter = SightPainter(shown)
    for sight, recipe in ((Sight(), Recipe(gamma=0.2)), (Sight(look="thick"), RECIPE)):
        assert painter.exposure(sight, recipe) == painter.exposure(replace(sight, frame=1), recipe)
    assert painter.exposure(Sight(), RECIPE) == 4 * painter.exposure(Sight(frame=1), RECIPE)


@pytest.mark.parametrize("exposure", [None, "bright", float("nan"), -1.0, 0])
def test_a_damaged_exposure_is_measured(run_folder: Path, exposure: object) -> None:
    record = json.loads((run_folder / "run.json").read_text())
    record["frames"][0]["exposure"] = exposure
    (run_folder / "run.json").write_text(json.dumps(record))
    picture = SightPainter(opened(run_folder)).paint(Sight(mode=BEFORE, height=12), RECIPE)
    assert picture.max() > 0.5


def test_of_path_traced_runs_the_page_says_what_the_view_shows(studio: Studio, run_folder: Path, source: Path) -> None:
    studio.post("/open", path="run")
    assert studio.session.state()["physics"] is None
    recipe = (run_folder / "recipe.toml").read_text().replace("emission_absorption", "prbvolpath")
    assert 'integrator = "prbvolpath"' in recipe
    (run_folder / "recipe.toml").write_text(recipe)
    record = json.loads((run_folder / "run.json").read_text())
    del record["recipe"]  # its digest
    (run_folder / "run.json").write_text(json.dumps(record))
    assert studio.post("/open", path="run").status == 200
    assert "The view shows emission and absorption" in studio.session.state()["physics"]
    # Its images had another brightness, which says nothing of these.
    assert opened(run_folder).exposure(0) is None


@pytest.mark.parametrize(
    ("sight", "expected"),
    [
        ({}, (0.25, 0.7)),
        ({"azimuth": 180}, (0.75, 0.7)),
        ({"azimuth": 90}, (0.3, 0.7)),  # from the right, what is near the front is on the left
        ({"elevation": 90}, (0.25, 0.3)),  # from above, it is below
        ({"cut": ("z", 0.75)}, (0.25, 0.7)),
        ({"cut": ("x", 0.25)}, (0.25, 0.7)),
        ({"cut": ("y", 0.75)}, (0.25, 0.25)),
        ({"pan": (2.0, -3.0)}, (0.05, 0.95)),
    ],
)
def test_right_is_right_and_up_is_up(source: Path, sight: dict[str, object], expected: tuple[float, float]) -> None:
    picture = SightPainter(opened(source)).paint(Sight(height=12, rows=96, columns=96, **sight), Recipe())
    assert centre(picture) == pytest.approx(expected, abs=0.16)
    quadrant = [place > 0.5 for place in expected]
    assert [place > 0.5 for place in centre(picture)] == quadrant


def test_what_is_nearer_is_larger_in_perspective_alone(source: Path) -> None:
    painter = SightPainter(opened(source))

    def lit(azimuth: float, perspective: bool) -> float:
        sight = Sight(azimuth=azimuth, height=14, rows=140, columns=140, perspective=perspective)
        return float((painter.paint(sight, Recipe()) > 0.2).sum())

    assert lit(0, False) == pytest.approx(lit(180, False), rel=0.02)
    assert lit(0, True) > 1.05 * lit(180, True)


def test_looks_have_the_gamma_of_the_studio(source: Path) -> None:
    painter = SightPainter(opened(source))
    gammas = [painter.optics(Sight(look=look), RECIPE)[0] for look in ("network", "thin", "medium", "thick")]
    assert gammas[0] == pytest.approx(0.3)
    assert gammas[1:] == [looks.gamma(look, SHAPE) for look in ("thin", "medium", "thick")]
    assert gammas[1] < gammas[2] < gammas[3]


def test_difference_and_movement_are_of_runs(source: Path, run_folder: Path) -> None:
    for mode in ("difference", "movement"):
        with pytest.raises(InputError, match="open one"):
            SightPainter(opened(source)).paint(Sight(mode=mode), Recipe())
    painter = SightPainter(opened(run_folder))
    for cut in (None, ("z", 0.75)):
        sight = {"height": 12.0, "rows": 48, "columns": 48, "cut": cut}
        brighter = painter.paint(Sight(mode="difference", **sight), Recipe(gamma=1e-4))
        assert brighter.shape == (48, 48, 3)
        moved = painter.paint(Sight(mode="movement", **sight), Recipe())
        place = np.unravel_index(moved.sum(2).argmax(), (48, 48))
        # (3, 4) is 53 degrees up from the right: between red and yellow.
        red, green, blue = moved[place]
        assert red > green > 0.8 * red and blue == pytest.approx(0.0, abs=0.02)


def test_movement_turns_with_the_camera(run_folder: Path) -> None:
    painter = SightPainter(opened(run_folder))
    sights = [
        Sight(mode="movement", azimuth=azimuth, height=12, rows=48, columns=48, perspective=perspective)
        for azimuth in (0, 180)
        for perspective in (False, True)
    ]
    front, front_too, back, back_too = (painter.paint(sight, Recipe()).max((0, 1)) for sight in sights)
    np.testing.assert_allclose(front, front_too, atol=0.03)
    np.testing.assert_allclose(back, back_too, atol=0.03)
    # From behind, x runs to the left: red has become green.
    assert front[0] > front[1] and back[1] > back[0]


def test_the_wheel() -> None:
    def colour(right: float, up: float, brightness: float = 1.0) -> list[float]:
        return coloured(np.array([[right]]), np.array([[up]]), np.array([[brightness]]), 2.0)[0, 0].tolist()

    assert colour(2, 0) == pytest.approx([1, 0, 0])
    assert colour(-2, 0) == pytest.approx([0, 1, 1])
    assert colour(0, 2) == pytest.approx([0.5, 1, 0])
    assert colour(0, -2) == pytest.approx([0.5, 0, 1])
    assert colour(0, 0, 0.3) == pytest.approx([0.3, 0.3, 0.3])
    assert colour(1, 0) == pytest.approx([1, 0.5, 0.5])
    assert coloured(np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1)), 0.0).tolist() == [[[1, 1, 1]]]


def test_coarse_grids_hold_the_same_smoke(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opened_module, "_COARSE_CELLS", 200)
    frame = opened(source).frame(BEFORE, 0)
    assert frame.coarse.density.shape == (5, 6, 4) and frame.coarse.h == 2.0
    assert 8 * frame.coarse.density.sum() == pytest.approx(frame.full.density.sum())
    fine, coarse = (
        SightPainter(opened(source)).paint(Sight(height=12, rows=96, columns=96, coarse=coarse), Recipe(gamma=0.01))
        for coarse in (False, True)
    )
    assert coarse.sum() == pytest.approx(fine.sum(), rel=0.1)
    assert centre(coarse) == pytest.approx(centre(fine), abs=0.02)


def test_pooling_fills_up_evenly() -> None:
    values = np.ones((3, 4, 6), np.float32)
    assert pooled(values, 4).shape == (1, 1, 2)
    assert pooled(values, 4).sum() * 64 == pytest.approx(72)
    assert pooled(values, 4)[0, 0, 0] == pooled(values, 4)[0, 0, 1]


def test_frames_in_memory_are_bounded(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opened_module, "free_memory", lambda: 0)
    shown = opened(source)
    first = shown.frame(BEFORE, 0)
    assert shown.frame(BEFORE, 0) is first
    shown.frame(BEFORE, 1)
    assert shown.frame(BEFORE, 0) is not first
    assert shown.frame(AFTER, 1) is shown.frame(BEFORE, 1)  # densities have one side


# ---------------------------------------------------------------- through the server


@pytest.fixture
def studio(source: Path, tmp_path: Path) -> Iterator[Studio]:
    with running(tmp_path, tmp_path / "out") as started:
        yield started


def test_nothing_is_shown_before_something_is_opened(studio: Studio) -> None:
    assert "nothing is opened" in studio.get("/view").error
    assert studio.session.state()["opened"] is None


def test_a_picture_comes_as_it_was_asked_for(studio: Studio, source: Path) -> None:
    assert studio.post("/open", path="smoke").status == 200
    reply = studio.get("/view", rows=40, columns=64, height=12, azimuth=725, coarse=1)
    assert reply.status == 200 and reply.headers["Content-Type"] == "image/jpeg"
    with Image.open(io.BytesIO(reply.body)) as picture:
        assert picture.size == (64, 40) and picture.mode == "L"
        assert np.asarray(picture).max() > 200
    state = studio.session.state()["opened"]
    assert state == state | {"title": "smoke", "path": "smoke", "run": False, "after": False, "shape": list(SHAPE)}
    assert state["names"] == ["f_01", "f_02"]


def test_a_run_brings_its_recipe_and_its_input(studio: Studio, run_folder: Path, source: Path) -> None:
    studio.post("/open", path="run")
    assert studio.session.recipe().gamma == 0.3
    assert studio.session.source.path == source
    state = studio.session.state()
    assert state["opened"]["after"] and state["opened"]["main_view"] == [20, 5]
    assert state["goals"] == [{"key": "style", "goal": "spirals"}]


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ({"frame": 2}, "from 0 to 1"),
        ({"frame": "0.5"}, "a whole number"),
        ({"rows": 100000}, "from 8 to 2160"),
        ({"columns": 0}, "from 8 to 2160"),
        ({"azimuth": "nan"}, "azimuth"),
        ({"height": "inf"}, "height"),
        ({"height": 0}, "height"),
        ({"elevation": 91}, "elevation"),
        ({"mode": "nothing"}, "expected one of before"),
        ({"look": "nice"}, "expected one of network"),
        ({"cut": "w"}, "expected one of none"),
        ({"at": "1e999", "cut": "x"}, "at"),
        ({"mode": "movement"}, "open one"),
    ],
)
def test_sights_that_cannot_be_are_refused(studio: Studio, query: dict[str, object], message: str) -> None:
    studio.post("/open", path="smoke")
    refused = studio.get("/view", **query)
    assert refused.status == 400 and message in refused.error


def test_what_cannot_be_opened_leaves_what_is(studio: Studio, tmp_path: Path) -> None:
    studio.post("/open", path="smoke")
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 broken")
    refused = studio.post("/open", path="broken.npz")
    assert refused.status == 400 and "broken.npz" in refused.error
    assert studio.session.state()["opened"]["title"] == "smoke"
