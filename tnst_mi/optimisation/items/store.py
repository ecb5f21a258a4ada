"""The working state of a run: arrays by group, frame and generation, on disk or in memory.

A generation counts how often an item has been replaced. Items are written atomically, and the content of an item
depends only on other items; so the items that a killed run leaves are a valid state, from which the run resumes by
computing what is missing. On disk an item is one safetensors file, read without pickle and with its sizes checked:

    GROUP/FRAME.GENERATION.safetensors        numbers.json        metrics.jsonl

It holds a checksum of each array together with the item's name and the run that it belongs to. So an item that is
truncated, that has lost its contents with the power, or that has another's name is found when it is read. Numbers, and
each line of the log, have a checksum too.
"""

from __future__ import annotations

import json
import re
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save

from tnst_mi.io.atomic import append, remove_folder, remove_unfinished, sync, written_whole
from tnst_mi.optimisation.items.damage import DamagedItemError, reading, remove_misplaced
from tnst_mi.optimisation.items.log import Log, log_line

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
            DamagedItemError: the item is not what was written.
        """

    @abstractmethod
    def write(self, group: str, frame: int, generation: int, arrays: Arrays, durable: bool = False) -> None:
        """Write an item, replacing its earlier generation.

        Args:
            group, frame, generation: of the item.
            arrays: by name.
            durable: whether it has to outlast a loss of power, with the log so far.
        """

    @abstractmethod
    def discard(self, group: str, frame: int) -> None:
        """Remove an item."""

    @abstractmethod
    def remove(self, group: str) -> None:
        """Remove all items of a group, if there are any, in one step."""

    @abstractmethod
    def clear(self) -> None:
        """Remove all items and numbers, so that the run begins anew; the log stays."""

    @abstractmethod
    def note(self, remark: str) -> None:
        """Say something to the user."""

    @abstractmethod
    def numbers(self, name: str) -> dict[str, float] | None:
        """A set of named numbers, or None if it has not been written.

        Raises:
            DamagedItemError: the numbers are not what was written.
        """

    @abstractmethod
    def write_numbers(self, name: str, numbers: dict[str, float]) -> None:
        """Write a set of named numbers."""

    @abstractmethod
    def log(self, entry: dict[str, Any]) -> None:
        """Add an entry to the log; its "frame" is the name of the frame that it is about."""

    @abstractmethod
    def entries(self, frame: str) -> list[dict[str, Any]]:
        """The log of a frame so far."""


class MemoryStore(Store):
    """A store for runs that write nothing; all frames of a sequence are in memory at once."""

    def __init__(self) -> None:
        self._items: dict[tuple[str, int], tuple[int, Arrays]] = {}
        self._numbers: dict[str, dict[str, float]] = {}
        self._log = Log()

    def generation(self, group: str, frame: int) -> int:
        """See `Store`."""
        return self._items.get((group, frame), (-1,))[0]

    def read(self, group: str, frame: int, names: Collection[str] | None = None) -> Arrays:
        """See `Store`."""
        item = self._items[group, frame][1]
        return {name: array for name, array in item.items() if names is None or name in names}

    def write(self, group: str, frame: int, generation: int, arrays: Arrays, durable: bool = False) -> None:
        """See `Store`."""
        self._items[group, frame] = generation, arrays

    def discard(self, group: str, frame: int) -> None:
        """See `Store`."""
        self._items.pop((group, frame), None)

    def clear(self) -> None:
        """See `Store`."""
        self._items, self._numbers = {}, {}

    def note(self, remark: str) -> None:
        """See `Store`; items in memory are not damaged, so there is nothing to say."""

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
        run: identifies the run that the state belongs to: items of another one count as damaged.
        may_write: called before anything is written or removed; raises if that must not happen any more.
        say: how to say something to the user.
        read_only: leave everything as it is, what a killed run has left unfinished included.
    """

    def __init__(
        self,
        folder: Path,
        run: str = "",
        may_write: Callable[[], None] = lambda: None,
        say: Callable[[str], None] = lambda remark: None,
        read_only: bool = False,
    ) -> None:
        self.folder, self._run, self._may_write, self._say = folder, run, may_write, say
        self._generations: dict[tuple[str, int], int] = {}
        self._entries: Log | None = None
        if not read_only:
            remove_unfinished(folder)
            remove_misplaced(folder, (self._numbers, self._log))
        # A killed run may leave two generations of an item, both complete, and unfinished files.
        for path in sorted(folder.glob("*/*.safetensors")):
            match = _ITEM.fullmatch(path.name)
            if path.parent.is_symlink():
                continue
            if match and read_only:
                # The later generation of an item comes last.
                self._generations[path.parent.name, int(match[1])] = int(match[2])
            elif match:
                self._take(path.parent.name, int(match[1]), int(match[2]))
            elif not read_only:
                path.unlink()

    def generation(self, group: str, frame: int) -> int:
        """See `Store`."""
        return self._generations.get((group, frame), -1)

    def read(self, group: str, frame: int, names: Collection[str] | None = None) -> Arrays:
        """See `Store`."""
        path = self._path(group, frame, self.generation(group, frame))
        with reading(path, group, frame), safe_open(path, framework="numpy") as item:
            written = item.metadata() or {}
            found = {name: item.get_tensor(name) for name in item.keys() if names is None or name in names}
        if names is not None and set(names) - set(found):
            raise DamagedItemError(path, "arrays are missing", group, frame)
        for name, array in found.items():
            if written.get(name) != self._checksum(path, name, array):
                raise DamagedItemError(path, f"the checksum of {name} is another", group, frame)
        return found

    def write(self, group: str, frame: int, generation: int, arrays: Arrays, durable: bool = False) -> None:
        """See `Store`."""
        self._may_write()
        path = self._path(group, frame, generation)
        arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
        checksums = {name: self._checksum(path, name, array) for name, array in arrays.items()}
        if durable and self._log.exists():
            sync(self._log)
        with written_whole(path, durable) as temporary:
            # Written here rather than by the library, whose error does not show that the disk is full.
            temporary.write_bytes(save(arrays, checksums))
        self._take(group, frame, generation)

    def discard(self, group: str, frame: int) -> None:
        """See `Store`."""
        self._may_write()
        generation = self._generations.pop((group, frame), None)
        if generation is not None:
            remove_folder(self._path(group, frame, generation))

    def remove(self, group: str) -> None:
        """See `Store`."""
        self._may_write()
        remove_folder(self.folder / group)
        self._generations = {key: value for key, value in self._generations.items() if key[0] != group}

    def clear(self) -> None:
        """See `Store`."""
        for group in {group for group, _ in self._generations}:
            self.remove(group)
        remove_folder(self._numbers)

    def note(self, remark: str) -> None:
        """See `Store`."""
        self._say(f"note: {self.folder}: {remark}")

    def numbers(self, name: str) -> dict[str, float] | None:
        """See `Store`."""
        return self._all_numbers().get(name)

    def write_numbers(self, name: str, numbers: dict[str, float]) -> None:
        """See `Store`."""
        self._may_write()
        everything = self._all_numbers() | {name: numbers}
        with written_whole(self._numbers) as temporary:
            temporary.write_text(
                json.dumps(everything | {"checksum": self._checksum_of(everything)}, indent=1), "utf-8"
            )

    def log(self, entry: dict[str, Any]) -> None:
        """See `Store`."""
        self._may_write()
        # The line break comes first, so that a line that a killed run left incomplete stays separate.
        append(self._log, "\n" + log_line(json.dumps(entry), self._run))
        if self._entries is not None:
            self._entries.add(entry)

    def entries(self, frame: str) -> list[dict[str, Any]]:
        """See `Store`; the file is read once, and what is logged from then on is kept."""
        if self._entries is None:
            self._entries = Log.read(self._log, self._run)
        return self._entries.of(frame)

    @property
    def _numbers(self) -> Path:
        return self.folder / "numbers.json"

    @property
    def _log(self) -> Path:
        return self.folder / "metrics.jsonl"

    def _all_numbers(self) -> dict[str, dict[str, float]]:
        if not self._numbers.exists():
            return {}
        with reading(self._numbers):
            everything = dict(json.loads(self._numbers.read_text("utf-8")))
            if everything.pop("checksum", None) != self._checksum_of(everything):
                raise DamagedItemError(self._numbers, "the checksum is another")
            return everything

    def _checksum(self, path: Path, name: str, array: np.ndarray) -> str:
        """The checksum of an array (CRC-32), with what must not be another's: its run, its item, its name and form."""
        form = json.dumps([self._run, path.parent.name, path.name, name, array.dtype.str, array.shape])
        return f"{zlib.crc32(array.data, zlib.crc32(form.encode('utf-8'))):08x}"

    def _checksum_of(self, numbers: dict[str, dict[str, float]]) -> str:
        form = json.dumps([self._run, numbers], sort_keys=True)
        return f"{zlib.crc32(form.encode('utf-8')):08x}"

    def _path(self, group: str, frame: int, generation: int) -> Path:
        return self.folder / group / f"{frame:06d}.{generation:06d}.safetensors"

    def _take(self, group: str, frame: int, generation: int) -> None:
        """Record an item as the newest generation, and remove the previous one."""
        earlier = self._generations.get((group, frame))
        if earlier is not None and earlier != generation:
            self._path(group, frame, earlier).unlink(missing_ok=True)
        self._generations[group, frame] = generation
