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

#: Height of a picture on the page, and room for the text below all of them, in inches.
_PANEL, _CAPTION_LINE = 2.2, 0.19
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
    columns = max(len(row) for row in made.rows)
    aspects = [_aspect(row[i]) for i in range(columns) for row in made.rows[:1] if i < len(row)]
    aspects += [1.0] * (columns - len(aspects))
    width = max(_PANEL * sum(aspects), 5.0)
    characters = int(width * 14)
    lines = [line for claim in made.claims for line in textwrap.wrap(_verdict(claim), characters)]
    height = (_PANEL + 0.35) * len(made.rows) + 0.45
    caption = _CAPTION_LINE * (len(lines) + 1)
    canvas = Canvas(figsize=(width, height + caption), dpi=_DOTS_PER_INCH)
    pictures, text = canvas.subfigures(2, 1, height_ratios=[height, caption])
    pictures.suptitle(title, fontsize=11)
    axes = pictures.subplots(len(made.rows), columns, squeeze=False, width_ratios=aspects)
    pictures.subplots_adjust(left=0.02, right=0.98, bottom=0.06, top=1 - 0.4 / height, wspace=0.06, hspace=0.2)
    for row, panels in zip(axes, made.rows, strict=True):
        for place in row[len(panels) :]:
            place.axis("off")
        for place, panel in zip(row, panels, strict=False):
            _show(place, panel)
    text.text(0.02, 0.95, "\n".join(lines), va="top", fontsize=8)
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
        axes.set(xlabel=panel.x_label, ylabel=panel.y_label, title=panel.label)
        axes.legend(fontsize=7)
        return
    axes.imshow(np.clip(panel.image, 0.0, 1.0), cmap="gray", vmin=0.0, vmax=1.0, interpolation="lanczos")
    axes.set_xlabel(panel.label, fontsize=8)
    axes.set(xticks=[], yticks=[])
