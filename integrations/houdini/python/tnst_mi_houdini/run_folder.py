"""The folder of a node: what is written there for tnst-mi, and where its results are.

Each run has an input of its own, input.1, input.2, …: it is written beside, under another name, and switched to once
it is complete, so that neither a run that is under way, nor one that can be resumed, ever sees another input. Marks
say what is ours: nothing is written into a folder of others, and nothing is removed that a mark does not list.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

#: Marks the folder of a node; and that of an input, whose files it lists.
_MARK, _LIST = "tnst_mi_node.json", "tnst_mi_input.json"

_PREFIX, _RECIPE = "input.", "recipe.toml"


class NotOurs(Exception):
    """The folder is of others; the message is one line with the remedy."""


@dataclass(frozen=True)
class Input:
    """What one run reads.

    Attributes:
        path: its folder.
    """

    path: Path

    @property
    def sequence(self) -> str:
        """Its frames, as tnst-mi reads them: a file for each."""
        return str(self.path / "smoke.####.vdb")

    @property
    def recipe(self) -> Path:
        """The recipe that the node's parameters said."""
        return self.path / _RECIPE

    @property
    def number(self) -> int:
        """By which later inputs are told from earlier ones."""
        text = self.path.name[len(_PREFIX) :]
        return int(text) if text.isdecimal() else 0

    def remove(self) -> None:
        """Remove what was written for it. What others have put there stays, and so what cannot be removed."""
        try:
            names = json.loads((self.path / _LIST).read_text(encoding="utf-8"))["files"]
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return
        for name in [*names, _LIST]:
            if isinstance(name, str) and name == Path(name).name:
                with contextlib.suppress(OSError):
                    (self.path / name).unlink()
        with contextlib.suppress(OSError):
            self.path.rmdir()


@dataclass(frozen=True)
class RunFolder:
    """The paths in a folder.

    Attributes:
        path: the folder, from the root.
    """

    path: Path

    @property
    def out(self) -> Path:
        """The run of tnst-mi."""
        return self.path / "run"

    @property
    def log(self) -> Path:
        """All that tnst-mi prints."""
        return self.path / "log.txt"

    @property
    def has_run(self) -> bool:
        """Whether a run has begun here."""
        return self.out.is_dir() and any(self.out.iterdir())

    def require_ours(self) -> None:
        """Check that it may be written to: it is new, empty, or marked.

        Raises:
            NotOurs: it is not.
            OSError: it cannot be read.
        """
        if (self.path / _MARK).is_file() or not self.path.exists():
            return
        if not self.path.is_dir() or any(self.path.iterdir()):
            raise NotOurs(
                f"{self.path}: has files that are not of this asset, which could be lost; choose a new or empty Folder"
            )

    def write_input(self, write: Callable[[Path], None], node: str) -> Input:
        """Write a new input: all of it, or nothing.

        Args:
            write: writes its files into the folder that it is given: recipe.toml, and smoke.1001.vdb, ….
            node: the path of the node, for the marks.

        Raises:
            NotOurs: see `require_ours`.
            OSError: it cannot be written; and all that `write` raises.
        """
        self.require_ours()
        self.path.mkdir(parents=True, exist_ok=True)
        mark = json.dumps({"node": node}) + "\n"
        with written_whole(self.path / _MARK) as beside:
            beside.write_text(mark, encoding="utf-8")
        staged = Path(tempfile.mkdtemp(prefix=f".{_PREFIX}", dir=self.path))
        try:
            staged.chmod(0o755)  # a farm may work under another name
            write(staged)
            names = sorted(path.name for path in staged.iterdir())
            (staged / _LIST).write_text(json.dumps({"node": node, "files": names}) + "\n", encoding="utf-8")
            return Input(self._renamed(staged))
        except BaseException:
            shutil.rmtree(staged, ignore_errors=True)
            raise

    def remove_superseded(self, own: Input | None = None) -> None:
        """Remove the inputs that no run needs any more, once a run has ended.

        Args:
            own: the input that the run was given, which is removed if the run has not begun; None for one that was
                resumed.
        """
        read = self._input_of_run()
        if own is not None and own != read and (read is not None or not self.has_run):
            own.remove()
        if read is None:
            return
        for path in self.path.glob(f"{_PREFIX}*"):
            other = Input(path)
            if 0 < other.number < read.number and not path.is_symlink():
                other.remove()

    def _input_of_run(self) -> Input | None:
        """The input of the run that is here; None if it is none of this folder, or there is none that says it."""
        try:
            source = Path(json.loads((self.out / "run.json").read_text(encoding="utf-8"))["input"])
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return None
        found = Input(self.path / source.parent.name)
        same = os.path.realpath(found.path) == os.path.realpath(source.parent)
        return found if same and found.number else None

    def _renamed(self, staged: Path) -> Path:
        number = max((Input(path).number for path in self.path.glob(f"{_PREFIX}*")), default=0) + 1
        while True:
            path = self.path / f"{_PREFIX}{number}"
            try:
                os.rename(staged, path)
            except OSError:
                if not path.exists():
                    raise
                number += 1  # another Houdini was faster
            else:
                return path


@contextlib.contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A path beside a file, which takes the file's place when all is written, and is removed if that fails."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        yield beside
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)
