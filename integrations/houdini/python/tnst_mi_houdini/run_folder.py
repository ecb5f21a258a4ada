"""The folder of a node: what is written there for tnst-mi, and where its results are."""

from __future__ import annotations

import os
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

    def write_recipe(self, text: str) -> None:
        """Write the recipe, whole or not at all."""
        self.path.mkdir(parents=True, exist_ok=True)
        beside = self.recipe.with_name(f".{self.recipe.name}.{os.getpid()}")
        beside.write_text(text, encoding="utf-8")
        os.replace(beside, self.recipe)
