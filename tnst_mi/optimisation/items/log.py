"""The log of a run's iterations, one entry each, as lines of JSON."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Any


class Log:
    """Entries by the frame that they are about: those of one are found without looking at the others."""

    def __init__(self) -> None:
        self._of: dict[str, list[dict[str, Any]]] = {}

    @classmethod
    def read(cls, path: Path) -> Log:
        """The entries in a file, none if there is no file; lines that are damaged or incomplete are left out.

        The iteration of a line that a killed run has left incomplete is repeated by the run that goes on.
        """
        log = cls()
        text = path.read_bytes().decode("utf-8", "replace") if path.exists() else ""
        for line in text.splitlines():
            with suppress(ValueError, TypeError, KeyError, RecursionError):
                log.add(json.loads(line))
        return log

    def add(self, entry: dict[str, Any]) -> None:
        """Add an entry; its "frame" is the name of the frame that it is about."""
        self._of.setdefault(entry["frame"], []).append(entry)

    def of(self, frame: str) -> list[dict[str, Any]]:
        """The entries of a frame, in their order."""
        return self._of.get(frame, [])
