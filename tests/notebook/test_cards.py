"""Frames, recipes and results show themselves in notebooks: the right pictures, escaped, bounded, whatever happens."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import pytest
from jobs import SHAPE, FakeOptimiser, optimiser
from moving_smoke import moving_smoke
from shown_html import ShownHtml

import tnst_mi
from tnst_mi.frame import Frame
from tnst_mi.geometry.placement import Placement
from tnst_mi.io.pictures.png import eight_bits
from tnst_mi.losses.pictures import read_image, resized
from tnst_mi.machine import notebook_display
from tnst_mi.recipe.paths import located
from tnst_mi.rendering import driving
from tnst_mi.run.inputs import reference_density

__all__ = ["optimiser"]

HOSTILE = '<script>alert("1")<b>&\'"'

RECIPE = {"style": ["spirals"], "weights": "patterns", "octaves": 1, "iterations": 1, "views": 1}


def cloud(number: int = 7, name: str = "cloud", shape: tuple[int, int, int] = SHAPE) -> Frame:
    density = np.random.default_rng(number).uniform(0.0, 2.0, shape)
    return Frame(density, name=name, number=number)


def test_a_frame_shows_its_main_view_and_what_is_in_it() -> None:
    frame = moving_smoke(1)[0]
    frame = replace(frame, obstacle=frame.density > 0.9, grids={"heat": frame.density}, reading="y up")
    shown = ShownHtml(frame._repr_html_())
    unit = frame.density / reference_density([frame]).value
    expected = tnst_mi.render(unit, view=(0.0, 0.0), gamma=0.1, quadrature="paper")
    (picture,) = shown.pictures
    assert picture.max() == 255 and len(np.unique(picture)) > 20
    # The public function has the division of the density elsewhere.
    assert np.abs(picture.astype(int) - eight_bits(expected / expected.max())).max() <= 1
    assert "8 × 12 × 10" in shown.text and f"{frame.mass:.6g}" in shown.text
    assert "heat" in shown.text and "y up" in shown.text and "s_005" in shown.text
    fastest = np.linalg.norm(frame.velocity, axis=-1).max()
    assert f"up to {fastest:.3g} cells per frame" in shown.text


def test_an_empty_frame_is_black() -> None:
    (picture,) = ShownHtml(Frame(np.zeros(SHAPE))._repr_html_()).pictures
    assert picture.shape == SHAPE[1:] and not picture.any()


def test_names_are_text(optimiser: FakeOptimiser) -> None:
    frame = Frame(cloud().density, name=HOSTILE, grids={HOSTILE: np.ones(SHAPE)}, reading=HOSTILE)
    result = tnst_mi.stylize(frame, RECIPE, progress=False)
    recipe = tnst_mi.Recipe(tag=(HOSTILE,), style=(HOSTILE,))
    for card in (frame, result, recipe):
        shown = ShownHtml(card._repr_html_())
        assert "script" not in shown.tags
        assert HOSTILE in shown.text


def test_large_pictures_are_reduced_and_small_ones_are_only_shown_larger() -> None:
    large, small = cloud(shape=(1, 500, 30)), cloud(shape=(2, 30, 20))
    shown = ShownHtml(large._repr_html_())
    assert shown.pictures[0].shape == (400, 24)
    shown = ShownHtml(small._repr_html_())
    assert shown.pictures[0].shape == (30, 20)
    (image,) = shown.attributes["img"]
    assert (image["width"], image["height"]) == ("260", "390")


def test_a_recipe_shows_its_pictures_and_what_differs_from_the_default(tmp_path: Path) -> None:
    recipe = tnst_mi.Recipe(style=("spirals",), content=("net",), octaves=2, gamma={1: 0.1, 5: 0.4})
    shown = ShownHtml(recipe._repr_html_())
    first, second = shown.pictures
    for picture, name in ((first, "spirals"), (second, "net")):
        (file,) = located("style", (name,), "", tmp_path)
        expected = eight_bits(resized(read_image(file).grey, 160, 160))
        np.testing.assert_array_equal(picture, expected)
    cells = [text for text in shown.texts if text.strip()]
    assert cells[cells.index("octaves") + 1] == "2"
    assert cells[cells.index("style") + 1] == "spirals"
    assert "0.4" in cells[cells.index("gamma") + 1]
    assert "iterations" not in cells
    meanings = {cell["title"] for cell in shown.attributes["td"] if cell.get("title")}
    assert any(meaning.startswith("Number of resolutions") for meaning in meanings)
    assert "every key as by default" in ShownHtml(tnst_mi.Recipe()._repr_html_()).text


def test_a_recipe_without_its_picture_says_so() -> None:
    shown = ShownHtml(tnst_mi.Recipe(style=("gone.png",), octaves=2)._repr_html_())
    assert "img" not in shown.tags
    assert "no picture: " in shown.text and "gone.png" in shown.text
    assert "octaves" in shown.text


def test_pictures_of_a_recipe_are_bounded_in_number() -> None:
    targets = tuple({"style": ["net" if i % 2 else "flames"], "mask": {"height": [0.0, 1.0]}} for i in range(3))
    assert len(ShownHtml(tnst_mi.Recipe(target=targets)._repr_html_()).pictures) == 2


def test_a_result_shows_before_and_after(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    """The optimiser doubles the density; the picture of before is exposed like that of after."""
    frame = cloud()
    result = tnst_mi.stylize(frame, RECIPE, tmp_path / "out", progress=False)
    shown = ShownHtml(result._repr_html_())
    before, after = shown.pictures
    record, scale = result.run["frames"][0], np.float32(result.run["density_scale"])
    for picture, density in ((before, frame.density), (after, 2 * frame.density)):
        expected = record["exposure"] * tnst_mi.render(scale * density, gamma=record["gamma"])
        np.testing.assert_array_equal(picture, eight_bits(expected))
    assert after.mean() > 1.3 * before.mean()
    assert "loss 4 → 3, mass +100.0%" in shown.text and "5 cells at most" in shown.text
    assert str(tmp_path / "out") in shown.text


@pytest.mark.parametrize(
    "keys",
    [{}, {"gamma": {"5": 0.1, "6": 0.6}}, {"fit": True, "azimuth": [40, 60]}, {"camera": "shot.json"}],
    ids=["plain", "keyframes", "fit", "camera"],
)
def test_pictures_that_no_file_has_are_those_of_a_run_with_files(keys: dict[str, object], tmp_path: Path) -> None:
    frames = [replace(frame, placement=Placement(0.1, (0.0, 0.0, 0.0))) for frame in moving_smoke(2)]
    shots = {
        str(number): {"position": [azimuth, -6, 2], "target": [0.5, 0.4, 0.6], "fov": 30.0, "aspect": 1.25}
        for number, azimuth in ((5, 3.0), (6, -2.0))
    }
    (tmp_path / "shot.json").write_text(json.dumps({"up_axis": "z", "frames": shots}), "utf-8")
    recipe = tnst_mi.Recipe.from_dict(RECIPE | keys, folder=tmp_path)
    in_memory = ShownHtml(tnst_mi.stylize(frames, recipe, progress=False)._repr_html_()).pictures
    in_files = ShownHtml(tnst_mi.stylize(frames, recipe, tmp_path / "out", progress=False)._repr_html_()).pictures
    assert len(in_memory) == 4
    for one, other in zip(in_memory, in_files, strict=True):
        np.testing.assert_array_equal(one, other)
    assert (in_memory[0] != in_memory[1]).any() and (in_memory[0] != in_memory[2]).any()


def test_of_a_sequence_twelve_frames_are_shown(optimiser: FakeOptimiser) -> None:
    result = tnst_mi.stylize([cloud(n, f"f_{n}") for n in range(15)], RECIPE, progress=False)
    html = result._repr_html_()
    shown = ShownHtml(html)
    assert len(shown.pictures) == 24 and len(html) < 100_000
    assert "15 frames, of which 12 are shown" in shown.text
    assert "f_0, before" in shown.text and "f_14, before" in shown.text


def test_a_result_whose_files_are_gone_shows_its_numbers(optimiser: FakeOptimiser, tmp_path: Path) -> None:
    result = tnst_mi.stylize(cloud(), RECIPE, tmp_path / "out", progress=False)
    (tmp_path / "out" / "images" / "cloud_after.exr").unlink()
    shown = ShownHtml(result._repr_html_())
    assert "img" not in shown.tags
    assert "no picture: " in shown.text and "cloud_after.exr" in shown.text and "5 cells at most" in shown.text


def test_what_cannot_be_shown_is_text_with_the_reason(
    optimiser: FakeOptimiser, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = replace(tnst_mi.stylize(cloud(), RECIPE, progress=False), run={})
    shown = ShownHtml(result._repr_html_())
    assert shown.tags == ["pre"]
    assert "Result(" in shown.text and "not shown as a picture: 'frames'" in shown.text
    assert len(shown.text) < 3000

    def broken(density: np.ndarray, recipe: object) -> np.ndarray:
        raise RuntimeError("no <device>")

    monkeypatch.setattr("tnst_mi.notebook.main_views.main_view", broken)
    shown = ShownHtml(cloud()._repr_html_())
    assert "no picture: no <device>" in shown.text and "4 × 6 × 5" in shown.text


def test_an_object_whose_text_cannot_be_made_is_its_type() -> None:
    class Broken(notebook_display.NotebookDisplay):
        def __repr__(self) -> str:
            raise ValueError("broken")

    shown = ShownHtml(Broken()._repr_html_())
    assert "Broken object at" in shown.text and "expected a frame, a recipe or a result" in shown.text


def test_the_variant_of_others_is_put_back(variant: str) -> None:
    mi.set_variant("scalar_rgb")
    try:
        (picture,) = ShownHtml(cloud()._repr_html_()).pictures
        assert picture.any() and mi.variant() == "scalar_rgb"
    finally:
        mi.set_variant(variant)


def test_path_traced_results_are_shown_with_few_paths(monkeypatch: pytest.MonkeyPatch) -> None:
    """A notebook does not wait for stills of 256 paths a pixel."""
    asked: list[int | None] = []

    def renderer(recipe: object, shape: object, h: float, spp: int | None = None, size: object = None) -> object:
        asked.append(spp)
        image = SimpleNamespace(numpy=lambda: np.full((1, *SHAPE[1:]), 0.5))
        return SimpleNamespace(render=lambda density, views, seeds: image)

    frame, recipe = cloud(), tnst_mi.Recipe(integrator="prbvolpath")
    record = {
        "name": "cloud",
        "exposure": 1.0,
        "note": None,
        "loss_before": None,
        "loss_after": None,
        "mass_before": 1.0,
        "mass_after": 1.0,
        "largest_displacement": 0.0,
    }
    run = {"status": "done", "density_scale": 1.0, "frames": [record], "weights": {"flavour": "none"}}
    result = tnst_mi.Result([frame.density], [], [], [frame], [], run, None, recipe)
    monkeypatch.setattr(driving, "driving_renderer", renderer)
    shown = ShownHtml(result._repr_html_())
    assert asked == [16, 16] and [picture.mean() for picture in shown.pictures] == [128.0, 128.0]
    assert "after: unchanged" in shown.text
