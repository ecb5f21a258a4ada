"""The preview, the contact sheet and the plots of a sequence: what is in them, and how little is held in memory."""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image
from videos import read_back

from tnst_mi.errors import InputError
from tnst_mi.run.before_after import side_by_side
from tnst_mi.run.report import plot_sequence, write_contact_sheet, write_preview

ROWS, COLUMNS = 30, 20


def even(level: float, rows: int = ROWS, columns: int = COLUMNS) -> np.ndarray:
    """A picture of one 8-bit grey."""
    return np.full((rows, columns), level / 255, np.float32)


@pytest.mark.parametrize("rows, scale", [(30, 14), (96, 5), (400, 1), (500, 1)])
def test_side_by_side(rows: int, scale: int) -> None:
    ramp = np.repeat(np.linspace(0, 1, COLUMNS, dtype=np.float32)[None], rows, axis=0)
    both = side_by_side(ramp, 1 - ramp)
    assert both.shape == (scale * rows, scale * (2 * COLUMNS + 2))
    left, gap, right = np.split(both, [scale * COLUMNS, scale * (COLUMNS + 2)], axis=1)
    assert (gap == 1).all()
    np.testing.assert_allclose(left, 1 - right, atol=1e-6)
    assert np.diff(left.mean(0)).min() >= -1e-6 and left[:, 0].max() < 0.02


def test_the_preview_shows_before_on_the_left_and_after_on_the_right(tmp_path: Path) -> None:
    levels = [(20, 200), (60, 160), (100, 120), (140, 80), (180, 40)]
    alive = Alive()
    pairs = (alive.counted(even(before), even(after)) for before, after in levels)
    write_preview(tmp_path / "preview.mp4", pairs, frames_per_second=8.0)
    pictures, about = read_back(tmp_path / "preview.mp4")
    assert pictures.shape == (5, 14 * ROWS, 14 * (2 * COLUMNS + 2), 3)
    assert about["fps"] == 8.0
    # Away from the edges, around which the codec rings.
    left, right = pictures[:, 10:-10, 10 : 14 * COLUMNS - 10], pictures[:, 10:-10, 14 * (COLUMNS + 2) + 10 : -10]
    np.testing.assert_allclose(np.stack([left.mean((1, 2, 3)), right.mean((1, 2, 3))], 1), levels, atol=3)
    assert pictures[:, 10:-10, 14 * COLUMNS + 8 : 14 * COLUMNS + 20].min() > 235
    assert alive.most <= 4
    assert [path.name for path in tmp_path.iterdir()] == ["preview.mp4"]


def test_a_preview_that_fails_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected one size"):
        write_preview(tmp_path / "a.mp4", [(even(0), even(0)), (even(0, 40), even(0, 40))], 24.0)
    assert list(tmp_path.iterdir()) == []


class Alive:
    """Counts how many of the pictures that went through are in memory at the same time."""

    def __init__(self) -> None:
        self.seen: list[weakref.ref] = []
        self.most = 0

    def counted(self, *pictures: np.ndarray) -> tuple[np.ndarray, ...]:
        self.seen += [weakref.ref(picture) for picture in pictures]
        self.most = max(self.most, sum(reference() is not None for reference in self.seen))
        return pictures


def place(sheet: np.ndarray, level: int) -> tuple[int, int, int, int]:
    """Top, left, height and width of the picture of one grey; the letters have single pixels of any."""
    found = sheet == level
    rows, columns = (np.flatnonzero(count > count.max() / 2) for count in (found.sum(1), found.sum(0)))
    (top, bottom), (left, right) = rows[[0, -1]], columns[[0, -1]]
    assert found[top : bottom + 1, left : right + 1].all()
    return int(top), int(left), int(bottom + 1 - top), int(right + 1 - left)


def sheet_of(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("L"))


@pytest.mark.parametrize("count", [1, 2, 5, 12, 24])
def test_the_contact_sheet_shows_the_frames_in_order(tmp_path: Path, count: int) -> None:
    befores, afters = [10 + 4 * i for i in range(count)], [130 + 4 * i for i in range(count)]
    entries = ((f"f_{i:03d}", even(befores[i]), even(afters[i])) for i in range(count))
    write_contact_sheet(tmp_path / "sheet.png", entries, count)
    sheet = sheet_of(tmp_path / "sheet.png")
    assert max(sheet.shape) < 2000
    chosen = [i for i in range(count) if (sheet == befores[i]).sum() > 5000]
    assert chosen == ([0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 23] if count == 24 else list(range(count)))
    above = [place(sheet, befores[i]) for i in chosen]
    assert [place(sheet, afters[i]) for i in chosen] == [(t + h + 2, left, h, w) for t, left, h, w in above]
    assert above == sorted(above)  # row after row, from left to right
    assert len({top for top, *_ in above}) == -(-len(chosen) // 6)


@pytest.mark.parametrize("shape", [(30, 20), (20, 60), (60, 5), (300, 400), (1000, 900)])
def test_pictures_keep_their_aspect_and_names_are_below_them(tmp_path: Path, shape: tuple[int, int]) -> None:
    sheets = []
    for name in ("a", r"$\frac$", 100 * "long"):
        write_contact_sheet(tmp_path / "sheet.png", [(name, even(30, *shape), even(60, *shape))], 1)
        sheets.append(sheet_of(tmp_path / "sheet.png"))
    top, _, height, width = place(sheets[0], 60)
    assert sheets[0].shape[0] - top - height == 32 and place(sheets[0], 30)[0] == 8
    assert height / width == pytest.approx(shape[0] / shape[1], rel=0.02)
    assert width <= 240 and height <= 360 and (width == 240 or height == 360)
    for other in sheets[1:]:
        assert np.nonzero(sheets[0] != other)[0].min() >= top + height
    assert (sheets[0][top + height :] < 128).any()
    # Nothing is cut off at the borders of the sheet.
    for sheet in sheets:
        assert (sheet[-1] == 255).all() and (sheet[:, [0, -1]] == 255).all()


def test_of_a_long_sequence_only_the_chosen_frames_are_kept(tmp_path: Path) -> None:
    alive = Alive()

    def entries() -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        for i in range(500):
            yield (f"f_{i}", *alive.counted(even(i // 2), even(255)))

    write_contact_sheet(tmp_path / "sheet.png", entries(), 500)
    sheet = sheet_of(tmp_path / "sheet.png")
    shown = [2 * level for level in range(250) if (sheet == level).sum() > 5000]
    np.testing.assert_allclose(shown, np.linspace(0, 499, 12), atol=2)
    assert (shown[0], shown[-1]) == (0, 498)
    assert len(alive.seen) == 1000 and alive.most <= 2 * 12 + 2


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that were written."""
    figures = []

    def print_png(canvas: FigureCanvasAgg, path: str) -> None:
        figures.append(canvas.figure)
        Path(path).touch()

    monkeypatch.setattr(FigureCanvasAgg, "print_png", print_png)
    return figures


def test_the_plots_show_what_they_are_given(tmp_path: Path, drawn: list[Figure]) -> None:
    names = ["f_07", "f_08", "f_09", "f_10"]
    pairs = [
        {"from": "f_07", "to": "f_08", "flicker": 0.5},
        {"from": "f_08", "to": "f_09", "flicker": None},
        {"from": "f_09", "to": "f_10", "flicker": 0.8},
    ]
    plot_sequence(
        tmp_path / "a.png",
        names,
        [4, 3, None, 1],
        [-2, -3, None, -4],
        pairs,
        [0.1, None, 0.3, 0.4],
        [-0.1, 0.02, None, 0.0],
    )
    losses, flickers, sizes, kept = drawn[0].axes
    before, after = losses.lines
    np.testing.assert_array_equal(before.get_ydata(), [4, 3, np.nan, 1])
    np.testing.assert_array_equal(after.get_ydata(), [-2, -3, np.nan, -4])
    assert [text.get_text() for text in losses.get_legend().texts] == ["before", "after"]
    curve, mean = flickers.lines
    np.testing.assert_array_equal(curve.get_ydata(), [0.5, np.nan, 0.8, np.nan])
    np.testing.assert_array_equal(curve.get_xdata(), [0.5, 1.5, 2.5, 3.5])
    assert mean.get_ydata() == pytest.approx([0.65, 0.65])
    assert flickers.get_legend().texts[0].get_text() == "mean 0.650"
    np.testing.assert_array_equal(sizes.lines[0].get_ydata(), [0.1, np.nan, 0.3, 0.4])
    np.testing.assert_allclose(kept.lines[0].get_ydata(), [-10, 2, np.nan, 0])
    assert kept.get_ylim() == pytest.approx((-11, 11))
    assert [label.get_text() for label in kept.get_xticklabels()] == names
    assert all(axes.get_ylabel() for axes in drawn[0].axes) and kept.get_xlabel() == "frame"
    assert flickers.get_ylim()[0] == sizes.get_ylim()[0] == 0 and flickers.get_ylim()[1] > 0.8


@pytest.mark.parametrize("count, step", [(1, 1), (12, 1), (13, 2), (24, 2), (25, 5), (200, 20), (1000, 100)])
def test_names_along_the_axis_are_thinned(tmp_path: Path, drawn: list[Figure], count: int, step: int) -> None:
    names = [f"f_{i}" for i in range(count)]
    plot_sequence(tmp_path / "a.png", names, [1.0] * count, [0.5] * count, [], [None] * count, [0.01] * count)
    assert drawn[0].axes[-1].get_ylim() == (-5, 5), "what is kept looks kept"
    axes = drawn[0].axes[-1]
    assert [label.get_text() for label in axes.get_xticklabels()] == names[::step]
    np.testing.assert_array_equal(axes.get_xticks(), np.arange(0, count, step))
    assert drawn[0].axes[1].get_legend() is None  # no mean of nothing


def test_plots_are_pictures_whatever_the_frames_are_called(tmp_path: Path) -> None:
    names = [r"$\frac$", 300 * "long"]
    plot_sequence(tmp_path / "plots" / "a.png", names, [1.0, None], [0.5, None], [], [0.2, None], [0.1, None])
    assert sheet_of(tmp_path / "plots" / "a.png").shape == (1000, 900)
    assert [path.name for path in (tmp_path / "plots").iterdir()] == ["a.png"]
