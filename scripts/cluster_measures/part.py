"""What a part of the measurements says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any


@dataclass
class Part:
    """What a part says.

    Attributes:
        title: what it is about.
        lines: of the report, Markdown.
        values: the numbers, for JSON.
        holds: by what was asked, whether it was found.
        skipped: why there is nothing; empty if there is.
    """

    title: str
    lines: list[str] = field(default_factory=list)
    values: dict[str, Any] = field(default_factory=dict)
    holds: dict[str, bool] = field(default_factory=dict)
    skipped: str = ""

    def report(self) -> str:
        """The part in Markdown."""
        if self.skipped:
            return f"## {self.title}\n\nLeft out: {self.skipped}\n"
        asked = [f"- {'yes' if found else '**no**'}: {what}" for what, found in self.holds.items()]
        return "\n".join([f"## {self.title}", "", *self.lines, "", *asked, ""])

    def record(self) -> dict[str, Any]:
        """The part for JSON."""
        return {"holds": self.holds, "skipped": self.skipped} | self.values


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return [f"| {' | '.join(map(str, line))} |" for line in lines]
