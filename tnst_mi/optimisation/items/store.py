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
from tnst_mi.machine.terminal import one_line

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
        """Add an entry to the log."""

    @abstractmethod
    def entries(self) -> list[dict[str, Any]]:
        """The log so far."""


class MemoryStore(Store):
    """A store for runs that write nothing; all frames of a sequence are in memory at once."""

    def __init__(self) -> None:
        self._items: dict[tuple[str, int], tuple[int, Arrays]] = {}
        self._numbers: dict[str, dict[str, float]] = {}
        self._log: list[dict[str, Any]] = []

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
        self._log.append(entry)

    def entries(self) -> list[dict[str, Any]]:
        """See `Store`."""
        return self._log


class FolderStore(Store):
    """A store on disk, which outlives the process.

    Args:
        folder: the folder that holds the state; it is created if it does not exist.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._generations: dict[tuple[str, int], int] = {}
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
            message = f"{path}: damaged ({error}); the run cannot be resumed, start anew with --overwrite"
            raise InputError(one_line(message)) from None

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

    def entries(self) -> list[dict[str, Any]]:
        """See `Store`."""
        path = self.folder / "metrics.jsonl"
        entries = []
        text = path.read_bytes().decode("utf-8", "replace") if path.exists() else ""
        for line in text.splitlines():
            try:
                entry = json.loads(line)
            except (ValueError, RecursionError):
                continue  # incomplete since the run was killed; its iteration is repeated
            if isinstance(entry, dict):
                entries.append(entry)
        return entries

    def _all_numbers(self) -> dict[str, dict[str, float]]:
        path = self.folder / "numbers.json"
        try:
            found = json.loads(path.read_text("utf-8")) if path.exists() else {}
            if all(isinstance(number, int | float) for numbers in found.values() for number in numbers.values()):
                return found
        except (ValueError, AttributeError, RecursionError):
            pass
        raise InputError(f"{path}: damaged; the run cannot be resumed, start anew with --overwrite")

    def _path(self, group: str, frame: int, generation: int) -> Path:
        return self.folder / group / f"{frame:06d}.{generation:06d}.safetensors"

    def _take(self, group: str, frame: int, generation: int) -> None:
        """Record an item as the newest generation, and remove the previous one."""
        earlier = self._generations.get((group, frame))
        if earlier is not None and earlier != generation:
            self._path(group, frame, earlier).unlink(missing_ok=True)
        self._generations[group, frame] = generation
