"""What a frame, a recipe or a result shows of itself in a notebook: pictures, and a table of numbers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tnst_mi.frame import Frame
from tnst_mi.losses.pictures import read_image
from tnst_mi.machine.terminal import duration, some_of
from tnst_mi.notebook.main_views import ShownFrame, shown_frames, shown_results
from tnst_mi.notebook.markup import LARGEST, box, picture, table, without_picture
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.sections import documentation
from tnst_mi.recipe.targets import targets_of
from tnst_mi.run.api import Result
from tnst_mi.run.difference import recipe_differences
from tnst_mi.run.report import on_sheet

#: Most columns and rows of a picture among several.
_SMALL = 160

#: Most pictures of a recipe.
_PICTURES = 12


def card(shown: object) -> str:
    """The HTML of a frame, a recipe or a result.

    Raises:
        TypeError: it is something else.
    """
    match shown:
        case Frame():
            return _frame_card(shown)
        case Recipe():
            return _recipe_card(shown)
        case Result():
            return _result_card(shown)
    raise TypeError(f"{type(shown).__name__}: expected a frame, a recipe or a result")


def _frame_card(frame: Frame) -> str:
    density = frame.density
    rows: dict[str, object] = {
        "cells (z, y, x)": " × ".join(map(str, density.shape)),
        "mass": f"{frame.mass:.6g}",
        "largest density": f"{float(density.max()):.3g}",
        "cells with smoke": f"{float((density > 0).mean()):.1%}",
        "velocity": "none",
    }
    if frame.number is not None:
        rows = {"number": frame.number, **rows}
    if frame.velocity is not None:
        fastest = float(np.sqrt(np.einsum("...c,...c", frame.velocity, frame.velocity).max()))
        rows["velocity"] = f"up to {fastest:.3g} cells per frame"
    if frame.obstacle is not None:
        rows["obstacle"] = f"{float(frame.obstacle.mean()):.1%} of the cells"
    if frame.grids:
        rows["other grids"] = some_of(list(frame.grids), 8)
    if frame.reading:
        rows["read as"] = frame.reading
    rows |= {f"note {number}": note.text for number, note in enumerate(frame.notes, start=1)}
    return box(f"Frame {frame.name}", [_pictures(lambda: shown_frames([frame])), table(rows)])


def _recipe_card(recipe: Recipe) -> str:
    changed = recipe_differences(Recipe(), recipe)
    rows = {key: _value(value) for key, (_, value) in changed.items()}
    title = "Recipe" if rows else "Recipe: every key as by default"
    return box(title, [_goal_pictures(recipe), table(rows, documentation())])


def _value(value: object) -> object:
    """The value of a key as TOML has it, in words."""
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return "not set" if value is None else value


def _result_card(result: Result) -> str:
    run, records = result.run, result.run["frames"]
    chosen = on_sheet(len(records))
    status = run["status"] if len(records) == 1 else f"{run['status']}, {len(records)} frames"
    if len(chosen) < len(records):
        status += f", of which {len(chosen)} are shown"
    rows: dict[str, object] = {"status": status}
    if records:
        rows["moved by"] = f"{max(record['largest_displacement'] for record in records):.3g} cells at most"
    rows |= {f"note {record['name']}": record["note"] for record in records[:_PICTURES] if record["note"]}
    if "seconds" in run:
        rows["time"] = duration(run["seconds"])
    rows["network"] = run["weights"]["flavour"]
    if result.out is not None:
        rows["folder"] = result.out
    return box("Result", [_pictures(lambda: shown_results(result, chosen)), table(rows)])


def _pictures(shown: Callable[[], list[ShownFrame]]) -> str:
    """The pictures of frames; why there are none if they cannot be made, since the numbers are worth showing alone."""
    try:
        frames = shown()
        largest = LARGEST if len(frames) == 1 else _SMALL
        return f"<div>{''.join(_beside(frame, largest) for frame in frames)}</div>"
    except Exception as error:
        return without_picture(error)


def _beside(frame: ShownFrame, largest: int) -> str:
    """The pictures of a frame beside each other."""
    captions = ("main view",) if len(frame.pictures) == 1 else (f"{frame.name}, before", f"after: {frame.told}")
    shown = "".join(picture(*pair, largest) for pair in zip(frame.pictures, captions, strict=True))
    # The two stay beside each other where a line has no room for both.
    return f'<span style="display:inline-block;white-space:nowrap;margin-right:12px">{shown}</span>'


def _goal_pictures(recipe: Recipe) -> str:
    """The pictures of style and content that a recipe names, in grey, as the network sees them."""
    try:
        goals = [target.recipe for target in targets_of(recipe.located(Path.cwd()))]
        files = list(dict.fromkeys(file for goal in goals for file in (*goal.style, *goal.content)))
        shown = [picture(read_image(file).grey, Path(file).name, _SMALL) for file in files[:_PICTURES]]
        more = len(files) - len(shown)
        return "".join(shown) + (f"<p>and {more} pictures more</p>" if more > 0 else "")
    except Exception as error:
        return without_picture(error)
