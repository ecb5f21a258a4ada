"""The log of a run's iterations, one entry each, as lines of JSON that begin with their checksum."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any


class Log:
    """Entries by the frame that they are about: those of one are found without looking at the others."""

    def __init__(self) -> None:
        self._of: dict[str, list[dict[str, Any]]] = {}

    @classmethod
    def read(cls, paths: Iterable[Path], run: str) -> Log:
        """The entries of a run in some files, if they are there; lines that are not what was written are left out.

        The iteration of a line that a killed run has left incomplete is repeated by the run that goes on.
        """
        log = cls()
        for path in paths:
            text = path.read_bytes().decode("utf-8", "replace") if path.is_file() else ""
            for line in text.splitlines():
                _, _, entry = line.partition(" ")
                if line == log_line(entry, run):
                    log.add(json.loads(entry))
        return log

    def add(self, entry: dict[str, Any]) -> None:
        """Add an entry; its "frame" is the name of the frame that it is about."""
        self._of.setdefault(entry["frame"], []).append(entry)

    def of(self, frame: str) -> list[dict[str, Any]]:
        """The entries of a frame, in their order."""
        return self._of.get(frame, [])


def log_line(entry: str, run: str) -> str:
    """A line of the file: the checksum (CRC-32) of an entry and the run that it belongs to, and the entry as JSON."""
    return f"{zlib.crc32((run + entry).encode('utf-8')):08x} {entry}"
