"""What may be opened: the folder with which the studio was started, and what is below it."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.io.formats import READABLE
from tnst_mi.machine.gate import gate
from tnst_mi.machine.terminal import displayable, one_line
from tnst_mi.run.folder import holds_run

#: Entries of a folder that are listed, at most.
_MOST = 400


@dataclass(frozen=True)
class PlaceEntry:
    """Something in a folder.

    Attributes:
        name: as it is shown.
        path: from the started folder, with / between folders.
        kind: "run", "folder" or "frames" (a file that may hold a frame); "more" counts those that are not listed.
    """

    name: str
    path: str
    kind: str


class Places:
    """A folder and what is below it; links that lead out of it are not followed.

    Args:
        root: the folder.
    """

    def __init__(self, root: Path) -> None:
        self.root = root.resolve()

    def within(self, relative: str) -> Path:
        """The file or folder of a path from the started folder, which is there.

        Raises:
            InputError: it leads out of the folder, or nothing is there.
        """
        path = None if Path(relative).is_absolute() else self._inside(self.root / relative)
        if path is None:
            raise InputError(one_line(f"{relative!r}: is not below {self.root}, with which the studio was started"))
        if not path.exists():
            raise InputError(one_line(f"{relative!r}: nothing is there any more"))
        return path

    def relative(self, path: Path) -> str | None:
        """The path from the started folder; None if it is not below it."""
        inside = self._inside(path)
        return None if inside is None else self._name_of(inside)

    def entries(self, relative: str) -> list[dict[str, Any]]:
        """The first of `found`, as values for JSON, and how many more there are."""
        found = self.found(relative)
        shown, more = found[:_MOST], len(found) - _MOST
        if more > 0:
            shown.append(PlaceEntry(f"and {more} more, by their path: tnst-mi studio PATH", "", "more"))
        return [asdict(entry) for entry in shown]

    def found(self, relative: str) -> list[PlaceEntry]:
        """What is in a folder, runs first, then folders, then files that may hold frames, each by their names.

        Raises:
            InputError: it is no folder below the started one, or cannot be read.
        """
        folder = self.within(relative)
        if not folder.is_dir():
            raise InputError(one_line(f"{relative!r}: is no folder"))
        found: list[PlaceEntry] = []
        with gate(folder, "a folder"), os.scandir(folder) as scanned:
            for entry in scanned:
                if entry.name.startswith("."):
                    continue
                # The folder has been resolved: only a link can lead out of it.
                path = self.relative(Path(entry.path)) if entry.is_symlink() else self._name_of(folder / entry.name)
                if path is not None and (kind := _kind(entry)):
                    found.append(PlaceEntry(displayable(entry.name), path, kind))
        ranks = ("run", "folder", "frames")
        return sorted(found, key=lambda entry: (ranks.index(entry.kind), entry.name))

    def _name_of(self, path: Path) -> str:
        return path.relative_to(self.root).as_posix()

    def _inside(self, path: Path) -> Path | None:
        """A path without links; None if it leads out of the folder, or nowhere."""
        try:
            resolved = path.resolve()
            resolved.exists()
        except (OSError, RuntimeError, ValueError):  # a name that is too long or none, links in a circle
            return None
        return resolved if resolved.is_relative_to(self.root) else None


def _kind(entry: os.DirEntry[str]) -> str | None:
    if entry.is_dir():
        return "run" if holds_run(Path(entry.path)) else "folder"
    return "frames" if Path(entry.name).suffix.lower() in READABLE else None
