"""The folder of a node: what is written there for tnst-mi, and where its results are."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class RunFolder:
    """The paths in a folder.

    Attributes:
        path: the folder.
    """

    path: Path

    @property
    def sequence(self) -> str:
        """The input, as tnst-mi reads it: a file for each frame."""
        return str(self.path / "input" / "smoke.####.vdb")

    @property
    def recipe(self) -> Path:
        """The recipe that the node's parameters say."""
        return self.path / "recipe.toml"

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

    def input_file(self, frame: int) -> Path:
        """The file of a frame that tnst-mi reads."""
        return self.path / "input" / f"smoke.{frame:04d}.vdb"

    def remove_other_inputs(self, frames: range) -> None:
        """Remove the files of earlier inputs, whose frames are not among those that are stylized now."""
        wanted = {self.input_file(frame) for frame in frames}
        for file in (self.path / "input").glob("smoke.*.vdb"):
            if file not in wanted:
                file.unlink()


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
