"""What tells whether the files of a run are still what it wrote: their sizes and hashes, which run.json holds."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.machine.terminal import one_line, some_of
from tnst_mi.network.download import file_hash
from tnst_mi.recipe.recipe import Recipe

#: Sizes and hashes of files, by their paths in the folder of the run.
Written = dict[str, dict[str, Any]]


def written(out: Path, files: Iterable[Path]) -> Written:
    """Sizes and SHA-256 of those of some files in the folder of a run that are there."""
    return {
        file.relative_to(out).as_posix(): {"bytes": file.stat().st_size, "sha256": file_hash(file, "sha256")}
        for file in files
        if file.is_file()
    }


def lines_written(lines: Iterable[str]) -> dict[str, Any]:
    """Number and SHA-256 of the lines that metrics.jsonl holds about a frame."""
    text = "".join(f"{line}\n" for line in lines)
    return {"lines": text.count("\n"), "sha256": hashlib.sha256(text.encode("utf-8")).hexdigest()}


def lines_by_frame(metrics: Path) -> dict[str, list[str]]:
    """The lines of metrics.jsonl by the frame that each is about, without those that do not tell it."""
    text = metrics.read_bytes().decode("utf-8", "replace") if metrics.is_file() else ""
    found: dict[str, list[str]] = {}
    for line in text.splitlines():
        try:
            name = json.loads(line)["frame"]
        except (ValueError, KeyError, TypeError, RecursionError):
            continue
        if isinstance(name, str):
            found.setdefault(name, []).append(line)
    return found


def recipe_digest(recipe: Recipe) -> str:
    """The SHA-256 of everything in a recipe that decides about bits of stylized smoke."""
    return hashlib.sha256(replace(recipe, fps=None).to_toml().encode("utf-8")).hexdigest()


class Earlier:
    """What is left of the files of an earlier run.

    Args:
        out: its folder.
        ended: whether it had ended: then files that are other ones may have been changed on purpose.
    """

    def __init__(self, out: Path, ended: bool) -> None:
        self._out, self._ended = out, ended
        self._lines = lines_by_frame(out / "metrics.jsonl")
        self._again: list[str] = []

    def has(self, what: str, recorded: Mapping[str, Any], lines: Mapping[str, Any] | None = None) -> bool:
        """Whether files are what was written; if not, they have to be made again.

        Args:
            what: the frame that they belong to, or other words for them.
            recorded: sizes and hashes of the files.
            lines: likewise of the frame's lines in metrics.jsonl.

        Raises:
            InputError: the run had ended, and there is another file in the place of one.
        """
        lost = [file for file in recorded if not (self._out / file).exists()]
        changed = [file for file in recorded if file not in lost and not _is(self._out / file, recorded[file])]
        if lines is not None and lines_written(self._lines.get(what, ())) != lines:
            (changed if (self._out / "metrics.jsonl").exists() else lost).append("metrics.jsonl")
        if changed and self._ended:
            file = self._out / changed[0]
            raise InputError(
                one_line(f"{file}: is not what the run wrote; restore it, or begin the run anew with --overwrite")
            )
        if lost or changed:
            self._again.append(f"{what} ({[*changed, *lost][0]})")
        return not (lost or changed)

    def notes(self) -> list[str]:
        """What is to be said of what is made again."""
        if not self._again:
            return []
        return [f"note: {self._out}: made again, since files are damaged or lost: {some_of(self._again)}"]


def _is(path: Path, recorded: Mapping[str, Any]) -> bool:
    """Whether a file has a recorded size and hash."""
    try:
        return path.stat().st_size == recorded["bytes"] and file_hash(path, "sha256") == recorded["sha256"]
    except OSError:
        return False
