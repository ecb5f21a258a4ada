"""Visual reports: the loss of a frame; of a sequence a preview video, a contact sheet, and plots over the frames."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tnst_mi.io.atomic import written_whole
from tnst_mi.io.pictures.png import eight_bits
from tnst_mi.io.pictures.video import open_video
from tnst_mi.losses.pictures import resized
from tnst_mi.run.before_after import side_by_side

#: Frames on a contact sheet, and in one row of it.
_ON_SHEET, _IN_ROW = 12, 6

#: Maximum columns and rows of a picture on the contact sheet.
_TILE = (240, 360)

#: White pixels around the pictures of a frame, and for the captions below and on the left.
_MARGIN, _CAPTION = 8, 24

#: Minimum width of a column of the contact sheet: room for a name, however narrow the pictures are.
_LEAST_COLUMN = 120

#: Pixels per inch of the contact sheet: a power of two, so that inches convert back to whole pixels.
_RESOLUTION = 128

#: Least range of the axis of mass on either side, in percent, so that what is kept looks kept.
_LEAST_MASS_AXIS = 5.0

#: Maximum number of frame names along the axis of a plot, and of characters in one.
_NAMES, _LETTERS = 12, 16


def write_preview(path: Path, pairs: Iterable[tuple[np.ndarray, np.ndarray]], frames_per_second: float) -> None:
    """Write an mp4 video of the smoke before, on the left, and after.

    Args:
        path: the file, ending in .mp4.
        pairs: for each frame the two pictures (H, W) or (H, W, 3) in [0, 1], one frame or more; consumed one by one.
        frames_per_second: how fast it plays.

    Raises:
        InputError: the pictures differ in size.
    """
    with open_video(path, frames_per_second) as video:
        for before, after in pairs:
            video.add(side_by_side(before, after))


def write_contact_sheet(path: Path, entries: Iterable[tuple[str, np.ndarray, np.ndarray]], count: int) -> None:
    """Write a PNG of up to 12 frames, evenly spread: each before above after, with its name below.

    Args:
        path: the file, ending in .png.
        entries: name and the two pictures of every frame, each (H, W) or (H, W, 3) in [0, 1]; consumed one by one.
        count: number of entries, at least 1.
    """
    chosen = set(on_sheet(count))
    tiles = [(name, _tile(before, after)) for i, (name, before, after) in enumerate(entries) if i in chosen]
    height, width = tiles[0][1].shape[:2]
    row, column = height + _MARGIN + _CAPTION, max(width, _LEAST_COLUMN) + _MARGIN
    in_row = min(_IN_ROW, len(tiles))
    sheet = np.ones((_MARGIN + row * -(-len(tiles) // in_row), _CAPTION + column * in_row, 3), np.float32)
    rows, columns = sheet.shape[:2]
    figure = Figure(figsize=(columns / _RESOLUTION, rows / _RESOLUTION), dpi=_RESOLUTION)

    def write(text: str, x: float, y: float, **style: Any) -> None:
        figure.text(x / columns, 1 - y / rows, text, ha="center", fontsize=7, parse_math=False, **style)

    for i, (name, tile) in enumerate(tiles):
        top = _MARGIN + row * (i // in_row)
        left = _CAPTION + column * (i % in_row) + (column - _MARGIN - width) // 2
        sheet[top : top + height, left : left + width] = tile
        write(_shortened(name, column // 8), left + width / 2, top + height + _MARGIN / 2, va="top")
        if i % in_row == 0:
            write("before", _CAPTION / 2, top + height / 4, va="center", rotation=90)
            write("after", _CAPTION / 2, top + 3 * height / 4, va="center", rotation=90)
    figure.figimage(eight_bits(sheet))
    with written_whole(path) as temporary:
        FigureCanvasAgg(figure).print_png(str(temporary))


def plot_loss(path: Path, name: str, history: list[dict[str, Any]]) -> None:
    """Plot the loss over the iterations as PNG, one panel per octave, since each scales its terms anew."""
    octaves = sorted({entry["octave"] for entry in history})
    figure = Figure(figsize=(4 * len(octaves), 3.5), layout="constrained")
    figure.suptitle(name, parse_math=False)
    for axes, octave in zip(figure.subplots(1, len(octaves), squeeze=False)[0], octaves, strict=True):
        entries = [entry for entry in history if entry["octave"] == octave]
        axes.plot([entry["iteration"] for entry in entries], [entry["loss"] for entry in entries], marker=".")
        axes.set(title=f"octave {octave + 1} of {len(octaves)}", xlabel="iteration", ylabel="loss")
        axes.xaxis.get_major_locator().set_params(integer=True)
    with written_whole(path) as temporary:
        FigureCanvasAgg(figure).print_png(str(temporary))


def plot_sequence(
    path: Path,
    names: Sequence[str],
    losses_before: Sequence[float | None],
    losses_after: Sequence[float | None],
    pairs: Sequence[dict[str, Any]],
    changes: Sequence[float | None],
    masses: Sequence[float | None],
) -> None:
    """Plot the measurements of the frames as PNG: loss before and after, flicker, size of the change, and mass.

    Args:
        path: the file, ending in .png.
        names: the frames, in order.
        losses_before: the loss of each frame at the start; None leaves a gap.
        losses_after: the same at the end.
        pairs: adjacent frames and their flicker, as in `FlickerMeter.pairs`.
        changes: ‖d* − d‖ / ‖d‖ of each frame.
        masses: Σ d* / Σ d − 1 of each frame.
    """
    figure = Figure(figsize=(9, 10), layout="constrained")
    losses, flickers, sizes, kept = figure.subplots(4, 1, sharex=True)
    losses.plot(_with_gaps(losses_before), marker=".", color="0.55", label="before")
    losses.plot(_with_gaps(losses_after), marker=".", color="tab:blue", label="after")
    losses.set(ylabel="loss")
    losses.legend()

    position = {name: i for i, name in enumerate(names)}
    flicker = np.full(len(names), np.nan)
    for pair in pairs:
        if pair["flicker"] is not None:
            flicker[position[pair["from"]]] = pair["flicker"]
    # A pair is drawn between its two frames.
    flickers.plot(np.arange(len(names)) + 0.5, flicker, marker=".", color="tab:red")
    if np.isfinite(flicker).any():
        mean = float(np.nanmean(flicker))
        flickers.axhline(mean, color="tab:red", linestyle="--", linewidth=1, label=f"mean {mean:.3f}")
        flickers.legend(loc="lower right")  # the axis begins at 0: there is room below
    else:
        said = "too little changed to compare" if pairs else "no pair of frames to compare"
        flickers.text(0.5, 0.5, said, transform=flickers.transAxes, ha="center")
    flickers.set(ylabel="flicker of a pair", ylim=(0.0, _top(flicker)))

    size = _with_gaps(changes)
    sizes.plot(size, marker=".", color="tab:green")
    sizes.set(ylabel="change ‖d* − d‖ / ‖d‖", ylim=(0.0, _top(size)))
    mass = 100 * _with_gaps(masses)
    kept.plot(mass, marker=".", color="tab:purple")
    farthest = max(_LEAST_MASS_AXIS, 1.1 * float(np.nanmax(np.abs(mass), initial=0.0)))
    kept.axhline(0.0, color="0.55", linewidth=1)
    kept.set(ylabel="change of mass / %", ylim=(-farthest, farthest))
    kept.set(xlabel="frame", xlim=(-0.5, len(names) - 0.5))
    ticks = range(0, len(names), _round_step(len(names) / _NAMES))
    labels = [_shortened(names[i], _LETTERS) for i in ticks]
    kept.set_xticks(ticks, labels, rotation=30, ha="right", rotation_mode="anchor", parse_math=False)
    for axes in (losses, flickers, sizes, kept):
        axes.grid(alpha=0.3)
    with written_whole(path) as temporary:
        FigureCanvasAgg(figure).print_png(str(temporary))


def on_sheet(count: int, most: int = _ON_SHEET) -> list[int]:
    """Indices of `most` frames of `count`, or of all if they are fewer, evenly spread from the first to the last."""
    chosen = min(count, most)
    return [i * (count - 1) // max(chosen - 1, 1) for i in range(chosen)]


def _tile(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """The first picture above the second, (H, W, 3), both resized to fit their place on the contact sheet."""
    rows, columns = before.shape[:2]
    scale = min(_TILE[0] / columns, _TILE[1] / rows)
    size = max(1, round(scale * rows)), max(1, round(scale * columns))
    first, second = (
        picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)
        for picture in (resized(before, *size), resized(after, *size))
    )
    return np.concatenate([first, np.ones((2, size[1], 3), np.float32), second])


def _shortened(name: str, letters: int) -> str:
    """A name cut to at most `letters` characters; its end is kept, where the number is."""
    return name if len(name) <= letters else "…" + name[1 - letters :]


def _with_gaps(values: Sequence[float | None]) -> np.ndarray:
    """The values, with None as NaN, which plots leave out."""
    return np.array([np.nan if value is None else value for value in values], np.float64)


def _top(values: np.ndarray) -> float:
    """The upper end of an axis from 0, with some room above the largest value."""
    return 1.1 * float(np.nanmax(values, initial=0.0)) or 1.0


def _round_step(least: float) -> int:
    """The smallest of 1, 2, 5, 10, 20, 50, … that is not below `least`."""
    return next(step * 10**power for power in itertools.count() for step in (1, 2, 5) if step * 10**power >= least)
