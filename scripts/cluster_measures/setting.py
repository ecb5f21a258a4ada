"""What is stylized, and where its files are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cluster_measures.observed import Trial
from cluster_measures.smoke import write_smoke


@dataclass
class Setting:
    """A sequence, and how it is stylized.

    Attributes:
        folder: for the frames and the runs; it need not exist.
        count: number of frames.
        shape: of each, (D, H, W).
        keys: of the recipe, beside `observed.RECIPE`.
    """

    folder: Path
    count: int
    shape: tuple[int, int, int]
    keys: Mapping[str, Any]
    _runs: int = field(default=0, init=False)

    def trial(self, address: str | None = None, homes: bool = True) -> Trial:
        """A run into a folder of its own; see `Trial`."""
        frames = self.folder / "frames"
        if not frames.exists():
            write_smoke(frames, self.count, self.shape)
        self._runs += 1
        return Trial(frames, self.folder / f"run_{self._runs}", self.keys, address, homes)

    def described(self) -> str:
        """In words."""
        keys = ", ".join(f"{key} {value}" for key, value in self.keys.items())
        return f"{self.count} frames of {'×'.join(map(str, self.shape))} cells, {keys}"


def small(folder: Path) -> Setting:
    """The sequence whose bits are compared."""
    return Setting(folder, 12, (32, 48, 32), {"window": 5, "octaves": 2, "iterations": 3, "views": 2})
