"""The working state of a run: arrays by group, frame and generation, on disk or in memory.

A generation counts how often an item has been replaced. Items are written atomically, and the content of an item
depends only on other items; so the items that a killed run leaves are a valid state, from which the run resumes by
computing what is missing. On disk an item is one safetensors file, read without pickle and with its sizes checked:

    GROUP/FRAME.GENERATION.safetensors        numbers.json        metrics.jsonl
"""

from __future__ import annotations

import json
import re
import shutil
from abc import ABC, abstractmethod
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import written_whole

#: What one item holds, by name.
Arrays = dict[str, np.ndarray]

_ITEM = re.compile(r"(\d{6,9})\.(\d{6,9})\.safetensors")


class Store(ABC):
    """Items by group and frame; the newest generation of each is kept."""

    @abstractmethod
    def generation(self, group: str, frame: int) -> int:
        """Generation of an item; −1 if it does not exist."""

    @abstractmethod
    def read(self, group: str, frame: int, names: Collection[str] | None = None) -> Arrays:
        """The arrays of an item, or only the named ones, as they were written.

        Raises:
            InputError: the item's file is damaged.
        """

    @abstractmethod
    def write(self, group: str, frame: int, generation: int, arrays: Arrays) -> None:
        """Write an item, replacing its earlier generation."""

    @abstractmethod
    def remove(self, group: str) -> None:
        """Remove all items of a group, if there are any."""

    @abstractmethod
    def numbers(self, name: str) -> dict[str, float] | None:
        """A set of named numbers, or None if it has not been written."""

    @abstractmethod
    def write_numbers(self, name: str, numbers: dict[str, float]) -> None:
        """Write a set of named numbers."""

    @abstractmethod
    def log(self, entry: dict[str, Any]) -> None:
        """Add an entry to the log; its "frame" is the name of the frame that it is about."""

    @abstractmethod
    def entries(self, frame: str) -> list[dict[str, Any]]:
        """The log of a frame so far."""


class _Log:
    """Entries by the frame that they are about: those of one are found without looking at the others."""

    def __init__(self) -> None:
        self._of: dict[str, list[dict[str, Any]]] = {}

    def add(self, entry: dict[str, Any]) -> None:
        self._of.setdefault(entry["frame"], []).append(entry)

    def of(self, frame: str) -> list[dict[str, Any]]:
        return self._of.get(frame, [])


class MemoryStore(Store):
    """A store for runs that write nothing; all frames of a sequence are in memory at once."""

    def __init__(self) -> None:
        self._items: dict[tuple[str, int], tuple[int, Arrays]] = {}
        self._numbers: dict[str, dict[str, float]] = {}
        self._log = _Log()

    def generation(self, group: str, frame: int) -> int:
        """See `Store`."""
        return self._items.get((group, frame), (-1,))[0]

    def read(self, group: str, frame: int, names: Collection[str] | None = None) -> Arrays:
        """See `Store`."""
        item = self._items[group, frame][1]
        return {name: array for name, array in item.items() if names is None or name in names}

    def write(self, group: str, frame: int, generation: int, arrays: Arrays) -> None:
        """See `Store`."""
        self._items[group, frame] = generation, arrays

    def remove(self, group: str) -> None:
        """See `Store`."""
        self._items = {key: item for key, item in self._items.items() if key[0] != group}

    def numbers(self, name: str) -> dict[str, float] | None:
        """See `Store`."""
        return self._numbers.get(name)

    def write_numbers(self, name: str, numbers: dict[str, float]) -> None:
        """See `Store`."""
        self._numbers[name] = numbers

    def log(self, entry: dict[str, Any]) -> None:
        """See `Store`."""
        self._log.add(entry)

    def entries(self, frame: str) -> list[dict[str, Any]]:
        """See `Store`."""
        return self._log.of(frame)


class FolderStore(Store):
    """A store on disk, which outlives the process.

    Args:
        folder: the folder that holds the state; it is created if it does not exist.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._generations: dict[tuple[str, int], int] = {}
        self._log: _Log | None = None
        # A killed run may leave two generations of an item, both complete, and unfinished files.
        for path in sorted(folder.glob("*/*.safetensors")):
            match = _ITEM.fullmatch(path.name)
            if match:
                self._take(path.parent.name, int(match[1]), int(match[2]))
            else:
                path.unlink()

    def generation(self, group: str, frame: int) -> int:
        """See `Store`."""
        return self._generations.get((group, frame), -1)

    def read(self, group: str, frame: int, names: Collection[str] | None = None) -> Arrays:
        """See `Store`."""
        path = self._path(group, frame, self.generation(group, frame))
        try:
            with safe_open(path, framework="numpy") as item:
                return {name: item.get_tensor(name) for name in item.keys() if names is None or name in names}
        except (SafetensorError, OSError, ValueError) as error:
            raise InputError(
                f"{path}: damaged ({error}); the run cannot be resumed, start anew with --overwrite"
            ) from None

    def write(self, group: str, frame: int, generation: int, arrays: Arrays) -> None:
        """See `Store`."""
        with written_whole(self._path(group, frame, generation)) as temporary:
            # Written here rather than by the library, whose error does not show that the disk is full.
            temporary.write_bytes(save({name: np.ascontiguousarray(array) for name, array in arrays.items()}))
        self._take(group, frame, generation)

    def remove(self, group: str) -> None:
        """See `Store`."""
        shutil.rmtree(self.folder / group, ignore_errors=True)
        self._generations = {key: value for key, value in self._generations.items() if key[0] != group}

    def numbers(self, name: str) -> dict[str, float] | None:
        """See `Store`."""
        return self._all_numbers().get(name)

    def write_numbers(self, name: str, numbers: dict[str, float]) -> None:
        """See `Store`."""
        everything = self._all_numbers() | {name: numbers}
        with written_whole(self.folder / "numbers.json") as temporary:
            temporary.write_text(json.dumps(everything, indent=1), "utf-8")

    def log(self, entry: dict[str, Any]) -> None:
        """See `Store`."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with (self.folder / "metrics.jsonl").open("a", encoding="utf-8") as file:
            # The line break comes first, so that a line that a killed run left incomplete stays separate.
            file.write("\n" + json.dumps(entry))
        if self._log is not None:
            self._log.add(entry)

    def entries(self, frame: str) -> list[dict[str, Any]]:
        """See `Store`; the file is read once, and what is logged from then on is kept."""
        if self._log is None:
            self._log = self._read_log()
        return self._log.of(frame)

    def _read_log(self) -> _Log:
        path, log = self.folder / "metrics.jsonl", _Log()
        for line in path.read_text("utf-8").splitlines() if path.exists() else []:
            try:
                log.add(json.loads(line))
            except (ValueError, TypeError, KeyError):
                continue  # incomplete since the run was killed; its iteration is repeated
        return log

    def _all_numbers(self) -> dict[str, dict[str, float]]:
        path = self.folder / "numbers.json"
        try:
            return json.loads(path.read_text("utf-8")) if path.exists() else {}
        except ValueError:
            raise InputError(f"{path}: damaged; the run cannot be resumed, start anew with --overwrite") from None

    def _path(self, group: str, frame: int, generation: int) -> Path:
        return self.folder / group / f"{frame:06d}.{generation:06d}.safetensors"

    def _take(self, group: str, frame: int, generation: int) -> None:
        """Record an item as the newest generation, and remove the previous one."""
        earlier = self._generations.get((group, frame))
        if earlier is not None and earlier != generation:
            self._path(group, frame, earlier).unlink(missing_ok=True)
        self._generations[group, frame] = generation
