"""images/ while a run goes on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import tiny_weights
from moving_smoke import moving_smoke
from PIL import Image

import tnst_mi
from tnst_mi.optimisation.glimpse import Glimpses
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.driving import main_view
from tnst_mi.run.job import Run
from tnst_mi.run.live_pictures import PAUSE, LivePictures
from tnst_mi.run.prepare import prepare
from tnst_mi.run.report import on_sheet

__all__ = ["tiny_weights"]

SHAPE = (10, 14, 12)
SIZE = (8, 6)
COARSE, VIEW = np.zeros((4, 3), np.float32), np.zeros(SIZE, np.float32)


class Rendered:
    """Glimpses that note for which frames they were asked."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self.asked: list[list[int]] = []

    def of(self, indices: Sequence[int], colours: Any) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        self.asked.append(list(indices))
        return ((self._names[index], COARSE, COARSE) for index in indices)


class Gallery:
    """Notes what is written."""

    def __init__(self) -> None:
        self.written: list[str] = []
        self.sheets: list[list[str]] = []
        self.read: list[str] = []

    def main_views(self, names: Sequence[str]) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        self.read += names
        return ((name, VIEW, VIEW) for name in names)

    def write_glimpse(self, name: str, before: np.ndarray, after: np.ndarray) -> None:
        self.written.append(name)

    def write_contact_sheet(self, entries: Sequence[tuple[str, np.ndarray, np.ndarray]]) -> None:
        assert {image.shape for _, *images in entries for image in images} == {SIZE}
        self.sheets.append([name for name, _, _ in entries])


class Clock:
    """Time that passes only when told."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_long_sequences_show_twelve_frames_at_most_every_thirty_seconds() -> None:
    names, gallery, clock = [f"f_{i:03d}" for i in range(100)], Gallery(), Clock()
    live, rendered = LivePictures(gallery, dict(enumerate(names)), SIZE, clock=clock), Rendered(names)
    live.octave_done(rendered)
    clock.now = PAUSE - 1
    live.octave_done(rendered)
    assert [len(asked) for asked in rendered.asked] == [12]
    assert rendered.asked[0][0] == 0 and rendered.asked[0][-1] == 99
    clock.now = PAUSE
    live.octave_done(rendered)
    assert [len(asked) for asked in rendered.asked] == [12, 12]
    assert len(gallery.written) == 24 and gallery.sheets == [gallery.written[:12]] * 2


def test_finished_frames_take_their_places_on_the_sheet() -> None:
    names, gallery, clock = ["a", "b", "c"], Gallery(), Clock()
    live, rendered = LivePictures(gallery, dict(enumerate(names)), SIZE, finished=["a"], clock=clock), Rendered(names)
    live.octave_done(rendered)
    assert rendered.asked == [[1, 2]]
    live.frame_done("b", (VIEW, VIEW))
    assert gallery.sheets == [["a", "b", "c"]], "not again within the pause, and with what an earlier run has finished"
    clock.now = PAUSE
    live.frame_done("c", (VIEW, VIEW))
    assert len(gallery.sheets) == 1, "all are finished: the results have a sheet of their own"


def test_a_sheet_shows_finished_frames_beside_others() -> None:
    names, gallery, clock = ["a", "b", "c"], Gallery(), Clock()
    live = LivePictures(gallery, dict(enumerate(names)), SIZE, clock=clock)
    live.octave_done(Rendered(names))
    clock.now = PAUSE
    live.frame_done("b", (VIEW, VIEW))
    assert gallery.sheets == [["a", "b", "c"]] * 2


def test_a_single_frame_is_shown_after_every_octave_and_has_no_sheet() -> None:
    gallery = Gallery()
    live = LivePictures(gallery, {0: "a"}, SIZE, clock=Clock())
    for _ in range(3):
        live.octave_done(Rendered(["a"]))
    assert gallery.written == ["a"] * 3 and gallery.sheets == []


def test_what_is_shown_is_the_draft(tiny_weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After the first of two octaves: what a run of this octave alone ends with, seen on its grid; and no bit of the
    result depends on having looked."""
    keys: dict[str, Any] = {"semantic": ["inception_3a/3x3:2"], "weights": str(tiny_weights), "octaves": 2}
    keys |= {"iterations": 3, "views": 2, "eta": 0.004, "density_scale": 1.0, "fit": False}
    (frame,), seen = moving_smoke(1, SHAPE), []
    of = Glimpses.of

    def noted(self: Glimpses, indices: Sequence[int], colours: Any) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        for name, before, after in of(self, indices, colours):
            seen.append((name, before, after, self._items))
            yield name, before, after

    monkeypatch.setattr(Glimpses, "of", noted)
    result = tnst_mi.stylize(frame, keys, tmp_path / "out", progress=False)
    blind = tnst_mi.stylize(frame, keys, progress=False)
    assert np.array_equal(result.densities[0], blind.densities[0])
    ((name, before, after, items),) = seen
    assert name == frame.name and before.shape == after.shape == items.octave.size == (7, 6)
    assert np.abs(after - before).max() > 1e-3

    draft = tnst_mi.stylize(frame, keys | {"quality": "draft"}, progress=False)
    exposure = result.run["frames"][0]["exposure"]
    views = [exposure * main_view(d, Recipe.from_dict(keys), SHAPE[1:]) for d in (frame.density, draft.densities[0])]
    change, expected = after - before, (views[1] - views[0]).reshape(7, 2, 6, 2).mean((1, 3))
    assert np.corrcoef(change.ravel(), expected.ravel())[0, 1] > 0.9


def test_pictures_are_there_after_the_first_octave(tiny_weights: Path, tmp_path: Path) -> None:
    """Of a sequence, with the contact sheet, before any frame is finished."""
    keys: dict[str, Any] = {"semantic": ["inception_3a/3x3:2"], "weights": str(tiny_weights), "octaves": 2}
    frames, out = moving_smoke(2, SHAPE), tmp_path / "out"
    recipe = Recipe.from_dict(keys | {"iterations": 1, "views": 1, "window": 3})
    run = Run(prepare(frames, recipe, out), progress=False)
    octaves: list[list[str]] = []
    advance = run._bar.advance

    def noted(progress: Any) -> None:
        octaves.append(sorted(path.name for path in (out / "images").glob("*")))
        advance(progress)

    run._bar.advance = noted  # type: ignore[method-assign]
    list(run)
    shown = [
        "contact_sheet.png",
        *(f"s_00{i}_{what}.png" for i in (5, 6) for what in ("after", "before", "comparison")),
    ]
    assert octaves[0] == [] and octaves[2] == sorted(shown)
    with Image.open(out / "images" / "s_005_after.png") as after:
        assert after.size == (SHAPE[2], SHAPE[1]), "in the end the results have taken their places"


def test_pictures_are_read_only_of_frames_on_the_sheet() -> None:
    names, gallery = [f"{number:02d}" for number in range(40)], Gallery()
    live = LivePictures(gallery, dict(enumerate(names)), SIZE, clock=Clock())
    for name in names:
        live.frame_done(name)
    assert gallery.read == [names[place] for place in on_sheet(40)] and len(gallery.read) == 12
