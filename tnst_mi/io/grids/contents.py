"""What a file contains: a grid or an array, in words."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Contents:
    """A grid or an array of a file.

    Attributes:
        kind: its name and type, which all frames of a sequence usually have in common.
        box: where its active voxels are; empty for what is stored in full.
        numbers: its size and range.
    """

    kind: str
    box: str = ""
    numbers: str = ""

    def __str__(self) -> str:
        """All of it, in one line."""
        return ", ".join(part for part in (self.kind, self.box, self.numbers) if part)
