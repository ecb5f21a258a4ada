"""Work items for TOPs: variations of a recipe, and shots, each as a command line. Needs neither `hou` nor `pdg`."""

from __future__ import annotations

import collections
import hashlib
import itertools
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .commands import batch_command, farm_line
from .recipe_text import recipe_text
from .run_folder import written_whole
from .sequences import frame_pattern

#: Characters that a name may have, which is that of a file and of a folder.
_LONGEST = 80


@dataclass(frozen=True)
class WorkItem:
    """One run.

    Attributes:
        name: that of its recipe, such as "tagfire_eta0.004"; where values do not make a name of a file, or make one
            twice, with a hash of them at its end.
        shot: the name of its shot.
        values: the keys of the recipe by which it differs from the others.
        recipe: its recipe file.
        out: the folder of the run.
        results: its densities, as a pattern with ####.
        files: its densities, one for each frame that the input has now.
        command: its command line, which begins the run, or goes on with one that was stopped.
    """

    name: str
    shot: str
    values: Mapping[str, Any]
    recipe: Path
    out: Path
    results: str
    files: tuple[Path, ...]
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
        ValueError: a shot's name is none of a folder, TOML has no such value, or Windows no such command line.
        OSError: a recipe cannot be written.
    """
    for shot in shots:
        if shot != _folder_name(shot):
            raise ValueError(
                f"{shot!r}: expected the name of a shot that a folder can have, such as {_folder_name(shot)}"
            )
    items = []
    combinations = [dict(zip(variations, each, strict=True)) for each in itertools.product(*variations.values())]
    for name, values in zip(_names(combinations), combinations, strict=True):
        recipe = folder / f"{name}.toml"
        with written_whole(recipe) as beside:
            beside.write_text(recipe_text({**base, **values}), encoding="utf-8")
        for shot, source in shots.items():
            pattern = Path(frame_pattern(source))
            # A batch of one: the same command begins a run, goes on with it, and leaves alone what is done.
            batch = folder / shot / name
            command = farm_line(batch_command(program, [str(recipe)], [str(pattern)], str(batch), cluster), windows)
            out = batch / _folder_name(recipe.stem) / _folder_name(pattern.stem)
            density = out / "density"
            files = tuple(density / frame for frame in _frames(pattern))
            items.append(WorkItem(name, shot, values, recipe, out, str(density / pattern.name), files, command))
    return items


def _frames(pattern: Path) -> list[str]:
    """The names of the files that a pattern means, as far as they are there."""
    before, _, after = re.split("(#+)", pattern.name)
    name = re.compile(rf"{re.escape(before)}-?\d+{re.escape(after)}")
    try:
        return sorted(found.name for found in pattern.parent.iterdir() if name.fullmatch(found.name))
    except OSError:
        return []


def _names(combinations: Sequence[Mapping[str, Any]]) -> list[str]:
    """A name for each combination of values, which are different where the values are."""
    texts = ["_".join(f"{key}{_joined(value)}" for key, value in values.items()) or "base" for values in combinations]
    names = [_folder_name(text)[:_LONGEST] for text in texts]
    # Not all disks tell capitals from others.
    uses = collections.Counter(name.lower() for name in names)
    for index, (text, values) in enumerate(zip(texts, combinations, strict=True)):
        if names[index] != text or uses[names[index].lower()] > 1:
            digest = hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
            names[index] = f"{names[index]}_{digest[:8]}"
    return names


def _joined(value: Any) -> str:
    return "-".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)


def _folder_name(text: str) -> str:
    """A text as the name of a folder, as tnst-mi batch has it."""
    return re.sub(r"[^\w.-]+", "_", text).strip("._") or "input"
