"""What a figure is: rows of pictures with labels, numbers, and claims that the numbers bear out or not."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas

from tnst_mi.io.atomic import written_whole

if TYPE_CHECKING:
    from figures.setting import Setting

#: In inches: the height of a picture, of the title, of a line of text, the space around a picture, and what the ticks
#: and the name of an axis take of a plot, on the left and below.
_PANEL, _TITLE, _LINE, _SPACE, _TICKS = 2.2, 0.35, 0.17, 0.1, (0.55, 0.4)
_DOTS_PER_INCH = 110


@dataclass(frozen=True)
class Panel:
    """A picture, (H, W) or (H, W, 3) with values in [0, 1] and row 0 at the top, and what stands below it."""

    image: np.ndarray
    label: str = ""


@dataclass(frozen=True)
class Plot:
    """Curves in place of a picture: by name, x and y; axes are linear or, where said, logarithmic."""

    curves: dict[str, tuple[Sequence[float], Sequence[float]]]
    x_label: str
    y_label: str
    label: str = ""
    logarithmic: bool = False


@dataclass(frozen=True)
class Claim:
    """A sentence with its numbers in it, and whether they bear it out."""

    text: str
    holds: bool


@dataclass
class Made:
    """What making a figure gives.

    Attributes:
        rows: the pictures, row by row.
        claims: what of the paper's claim can be put in numbers, and was found.
        numbers: everything measured, for the JSON file; values that JSON knows.
        notes: where this differs from the paper's figure, in sentences; those that only this run knows, such as a
            picture that was not found.
    """

    rows: list[list[Panel | Plot]]
    claims: list[Claim]
    numbers: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Figure:
    """A figure or table of the paper.

    Attributes:
        title: its heading.
        paper: what the paper claims or shows, in our words.
        differs: where ours differs from it, and why, in our words; empty where it does not.
        make: makes it.
    """

    title: str
    paper: str
    make: Callable[[Setting], Made]
    differs: str = ""


def draw(path: Path, title: str, made: Made) -> None:
    """Write the picture of a figure as PNG: its rows, and its claims below."""
    columns = [
        _PANEL * max(_aspect(row[i]) for row in made.rows if i < len(row))
        for i in range(max(len(row) for row in made.rows))
    ]
    labels = [_LINE * max(panel.label.count("\n") + 1 for panel in row) for row in made.rows]
    width = max(sum(columns) + _SPACE * (len(columns) + 1), 5.0)
    characters = int(width * 15)
    lines = [line for claim in made.claims for line in textwrap.wrap(_verdict(claim), characters)]
    caption = _LINE * (len(lines) + 1)
    height = _TITLE + sum(_PANEL + label + _SPACE for label in labels) + caption
    canvas = Canvas(figsize=(width, height), dpi=_DOTS_PER_INCH)
    canvas.text(0.5, 1 - 0.5 * _TITLE / height, title, ha="center", va="center", fontsize=11)
    top = height - _TITLE
    for row, label in zip(made.rows, labels, strict=True):
        left = (width - sum(columns) - _SPACE * (len(columns) - 1)) / 2
        for panel, column in zip(row, columns, strict=False):
            right, up = _TICKS if isinstance(panel, Plot) else (0.0, 0.0)
            box = (left + right, top - _PANEL + up, column - right, _PANEL - up)
            _show(canvas.add_axes([box[0] / width, box[1] / height, box[2] / width, box[3] / height]), panel)
            left += column + _SPACE
        top -= _PANEL + label + _SPACE
    canvas.text(_SPACE / width, (caption - 0.5 * _LINE) / height, "\n".join(lines), va="top", fontsize=8)
    with written_whole(path) as temporary:
        FigureCanvasAgg(canvas).print_png(str(temporary))


def write_numbers(path: Path, figure: Figure, made: Made, run: dict[str, Any]) -> None:
    """Write all that is known of a figure but its picture as JSON; `run` says how it was made."""
    record = {
        "title": figure.title,
        "paper": figure.paper,
        "claims": [{"text": claim.text, "holds": bool(claim.holds)} for claim in made.claims],
        "differs": " ".join(filter(None, [figure.differs, *made.notes])),
        "numbers": made.numbers,
        **run,
    }
    with written_whole(path) as temporary:
        temporary.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", "utf-8")


def _verdict(claim: Claim) -> str:
    return f"{'✓' if claim.holds else '✗'} {claim.text}"


def _aspect(panel: Panel | Plot) -> float:
    return 1.5 if isinstance(panel, Plot) else panel.image.shape[1] / panel.image.shape[0]


def _show(axes: Any, panel: Panel | Plot) -> None:
    if isinstance(panel, Plot):
        for name, (x, y) in panel.curves.items():
            axes.plot(x, y, marker=".", label=name)
        if panel.logarithmic:
            axes.set(xscale="log", yscale="log")
        axes.set_xlabel(panel.x_label, fontsize=8)
        axes.set_ylabel(panel.y_label, fontsize=8)
        axes.set_title(panel.label, fontsize=8)
        axes.tick_params(labelsize=7)
        axes.legend(fontsize=7)
        return
    axes.imshow(np.clip(panel.image, 0.0, 1.0), cmap="gray", vmin=0.0, vmax=1.0, interpolation="lanczos")
    axes.set_xlabel(panel.label, fontsize=8)
    axes.set(xticks=[], yticks=[])
