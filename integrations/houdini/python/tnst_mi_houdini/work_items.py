"""Work items for TOPs: variations of a recipe, and shots, each as a command line. Needs neither `hou` nor `pdg`."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .commands import batch_command, farm_line
from .recipe_text import recipe_text
from .run_folder import written_whole
from .sequences import frame_pattern


@dataclass(frozen=True)
class WorkItem:
    """One run.

    Attributes:
        name: that of its recipe, such as "tagfire_eta0.004".
        shot: the name of its shot.
        values: the keys of the recipe by which it differs from the others.
        recipe: its recipe file.
        out: the folder of the run.
        results: its densities, as a pattern with ####.
        command: its command line, which begins the run, or goes on with one that was stopped.
    """

    name: str
    shot: str
    values: Mapping[str, Any]
    recipe: Path
    out: Path
    results: str
    command: str


def work_items(
    program: str,
    shots: Mapping[str, str],
    base: Mapping[str, Any],
    variations: Mapping[str, Sequence[Any]],
    folder: Path,
    cluster: str = "",
    windows: bool = False,
) -> list[WorkItem]:
    """An item for each shot and each combination of variations. Writes their recipes.

    Args:
        program: `tnst-mi`, by its path on the machines of the farm.
        shots: the input of each shot as Houdini names it, such as {"sh010": "/shots/010/smoke.$F4.vdb"}.
        base: keys of the recipe that all have.
        variations: values by key, such as {"eta": [0.002, 0.004], "tag": [["fire"], ["flower"]]}.
        folder: where recipes and runs are written, on a disk that the farm sees.
        cluster: see `stylize_command`.
        windows: whether the farm's machines have Windows.

    Raises:
        NoFrameNumber: an input does not say where the number of the frame is.
    """
    items = []
    for combination in itertools.product(*variations.values()):
        values = dict(zip(variations, combination))  # noqa: B905 (the argument is new in Python 3.10)
        name = "_".join(f"{key}{_folder_name(_joined(value))}" for key, value in values.items()) or "base"
        recipe = folder / f"{name}.toml"
        with written_whole(recipe) as beside:
            beside.write_text(recipe_text({**base, **values}), encoding="utf-8")
        for shot, source in shots.items():
            pattern = Path(frame_pattern(source))
            # A batch of one: the same command begins a run, goes on with it, and leaves alone what is done.
            batch = folder / shot / name
            command = farm_line(batch_command(program, [str(recipe)], [str(pattern)], str(batch), cluster), windows)
            out = batch / _folder_name(recipe.stem) / _folder_name(pattern.stem)
            items.append(WorkItem(name, shot, values, recipe, out, str(out / "density" / pattern.name), command))
    return items


def _joined(value: Any) -> str:
    return "-".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)


def _folder_name(text: str) -> str:
    """A text as the name of a folder, as tnst-mi batch has it."""
    return re.sub(r"[^\w.-]+", "_", text).strip("._") or "input"
