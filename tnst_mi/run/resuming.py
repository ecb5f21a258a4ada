"""What an earlier run has left in its folder, and whether another one may go on from it."""

from __future__ import annotations

import json
from collections.abc import Collection
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError, MissingFileError
from tnst_mi.io.formats import FORMATS
from tnst_mi.machine.gate import decoding, gate
from tnst_mi.machine.terminal import one_line
from tnst_mi.recipe.recipe import KINDS, Recipe
from tnst_mi.run.folder import (
    DAMAGE,
    ELSEWHERE,
    PICTURES,
    frame_files,
    holds_run,
    is_file_name,
    just_begun,
    occupied,
)
from tnst_mi.run.written import Earlier, Written, recipe_digest

#: Keys that may differ when a run is resumed.
_DECIDES_NOTHING = ("fps",)


def require_begun(out: Path) -> bool:
    """Check that a folder is that of a run; whether it has begun, which one that was killed at once has not.

    Raises:
        InputError: there is no such folder, or it holds something else.
    """
    if not out.is_dir():
        raise InputError(one_line(f"{out}: no run to resume there; leave out --resume to begin one"))
    with gate(out, "the folder of a run"):
        if not occupied(out) or just_begun(out):
            return False
    if not holds_run(out):
        raise InputError(
            f"{out}: holds no run that could be resumed (run.json and recipe.toml are not both there); {ELSEWHERE}"
        )
    return True


def require_run(folder: Path) -> None:
    """Check that a folder holds a run, from which another one may go on.

    Raises:
        InputError: it does not.
    """
    if not holds_run(folder):
        raise InputError(
            one_line(f"{folder}: holds no run to go on from (run.json and recipe.toml are not both there)")
        )


def recipe_of_run(out: Path) -> Recipe:
    """The recipe of the run in a folder.

    Raises:
        InputError: the file is not what the run wrote.
    """
    path = out / "recipe.toml"
    with decoding(out / "run.json", "the record of a run"):
        expected = json.loads((out / "run.json").read_text("utf-8")).get("recipe")
    try:
        recipe = Recipe.from_toml(path)
        if expected in (None, recipe_digest(recipe)):
            return recipe
    except MissingFileError:
        raise  # of what it names, a camera or a picture
    except DAMAGE:
        pass
    raise InputError(f"{path}: is not the recipe of the run there; restore it, or begin the run anew with --overwrite")


def record_in(out: Path) -> bytes | None:
    """The bytes of the run.json in a folder, or None if there is none that can be read."""
    try:
        return (out / "run.json").read_bytes()
    except OSError:
        return None


def resumable_run(
    out: Path, recipe: Recipe, weights: dict[str, Any], suffix: str = FORMATS[0]
) -> dict[str, Any] | None:
    """The record of the run to be resumed, with its finished frames, and notes on others; None if it has not begun.

    Args:
        out: the folder of the run.
        recipe: the recipe to resume it with.
        weights: the weights to resume it with, as run.json records them.
        suffix: file suffix of its results.

    Raises:
        InputError: the folder holds something else, or a run with another recipe, other weights, or files of another
            format; or it had ended, and a file is not what it wrote.
    """
    # Callers from Python may begin a run as if it were to be resumed.
    if not out.exists() or not require_begun(out):
        return None
    try:
        run = json.loads((out / "run.json").read_text("utf-8"))
        frames = [frame for frame in run["frames"] if frame["complete"] and _lists_results(frame, suffix)]
        pictures = _known(run.get("results", {}), PICTURES)
        run["inputs"], run["files"] = dict(run["inputs"]), dict(run["files"])
        earlier_format = run.get("format", suffix[1:])
        if run.get("threads", 1) not in range(1, 1025) or not isinstance(run.get("cluster", []), list):
            raise ValueError(run["threads"])
        earlier_weights = run["weights"]["sha256"]
    except DAMAGE:
        raise InputError(f"{out / 'run.json'}: damaged, so the run cannot be resumed; {ELSEWHERE}") from None
    earlier = recipe if run.get("recipe") == recipe_digest(recipe) else recipe_of_run(out)
    for key in (*KINDS, "keyframes"):
        if key in _DECIDES_NOTHING:
            continue
        before, now = getattr(earlier, key), getattr(recipe, key)
        if before != now:
            had = f"{out}: its run had {key} = {before!r} and the recipe now has {now!r}"
            raise InputError(one_line(f"{had}; resume with the same recipe, or use --overwrite"))
    if earlier_weights != weights["sha256"]:
        used = f"{out}: its run used other weights (sha256 {earlier_weights})"
        raise InputError(one_line(f"{used}; resume with the same ones"))
    if earlier_format != suffix[1:]:
        wrote = f"{out}: its run wrote {earlier_format} files, in the format of its input, which now is {suffix[1:]}"
        raise InputError(one_line(f"{wrote}; resume with the same input, or use --overwrite"))
    left = Earlier(out, ended=run.get("status") == "done")
    run["frames"] = [frame for frame in frames if left.has(frame["name"], frame["results"], frame["log"])]
    if not left.has("the pictures of all frames", pictures):
        run.pop("sequence", None)
    run["notes"] = left.notes()
    return run


def _lists_results(frame: dict[str, Any], suffix: str) -> bool:
    """Whether the record of a frame has its arrays, and the pictures of which those of the whole run are made."""
    name, results = frame["name"], frame.get("results", {})
    files = [*(f"{kind}/{name}{suffix}" for kind in ("density", "velocity"))]
    files += [f"images/{name}_{state}.exr" for state in ("before", "after")]
    if not is_file_name(name) or not set(files) <= set(results):
        return False
    _known(results, [path.as_posix() for path in frame_files(Path(), name, _carried(frame))])
    return isinstance(frame["log"], dict)


def _carried(frame: dict[str, Any]) -> list[str]:
    """The names of the grids that moved with a frame; raises TypeError if they are none."""
    if not all(isinstance(name, str) for name in frame["carried"]):
        raise TypeError(frame["carried"])
    return frame["carried"]


def _known(results: dict[str, Any], names: Collection[str]) -> Written:
    """Sizes and hashes in an untrusted record; raises ValueError or TypeError if they are none, or of other files."""
    for file, of_file in results.items():
        if file not in names or set(of_file) != {"bytes", "sha256"}:
            raise ValueError(file)
    return results
