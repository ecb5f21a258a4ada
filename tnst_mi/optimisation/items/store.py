"""The working state of a run, on disk or in memory.

Items are written atomically, and the content of an item depends only on other items; so the items that a killed run
leaves are a valid state, from which the run resumes by computing what is missing. On disk an item is one file (`item`):

    GROUP/FRAME.GENERATION.safetensors        numbers.json        metrics.jsonl        log/MEMBER.jsonl

Numbers, and each line of the log, have a checksum.

Several processes may work on one state: each item is written by one of them, and each has a log of its own, so they
need no locks.
"""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from tnst_mi.io.atomic import append, remove_folder, remove_unfinished, sync, written_whole
from tnst_mi.optimisation.items.damage import DamagedItemError, reading, remove_misplaced
from tnst_mi.optimisation.items.interface import Arrays, Store
from tnst_mi.optimisation.items.item import Item
from tnst_mi.optimisation.items.log import Log, log_line

_ITEM = re.compile(r"(\d{6,9})\.(\d{6,9})\.safetensors")


class MemoryStore(Store):
    """A store for runs that write nothing; all frames of a sequence are in memory at once."""

    def __init__(self) -> None:
        self._items: dict[tuple[str, int], tuple[int, Arrays]] = {}
        self._numbers: dict[str, dict[str, float]] = {}
        self._log = Log()

    def generation(self, group: str, frame: int) -> int:
        """See `Store`."""
        return self._items.get((group, frame), (-1,))[0]

    def has(self, group: str, frame: int, generation: int) -> bool:
        """See `Store`."""
        return self.generation(group, frame) == generation

    def read(
        self, group: str, frame: int, names: Collection[str] | None = None, generation: int | None = None
    ) -> Arrays:
        """See `Store`."""
        item = self._items[group, frame][1]
        return {name: array for name, array in item.items() if names is None or name in names}

    def write(self, group: str, frame: int, generation: int, arrays: Arrays, durable: bool = False) -> None:
        """See `Store`."""
        self._items[group, frame] = generation, arrays

    def discard(self, group: str, frame: int, generation: int | None = None) -> None:
        """See `Store`."""
        if generation is None or self.has(group, frame, generation):
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
        member: names this process where it joins others that work on the state already, for its log. It looks nothing
            up, since what is on other machines may show late in listings, and knows what it has been `told` of or has
            written. Earlier generations stay until they are released.
    """

    def __init__(
        self,
        folder: Path,
        run: str = "",
        may_write: Callable[[], None] = lambda: None,
        say: Callable[[str], None] = lambda remark: None,
        read_only: bool = False,
        member: str | None = None,
    ) -> None:
        self.folder, self._run, self._may_write, self._say = folder, run, may_write, say
        self._log = folder / "metrics.jsonl" if member is None else folder / "log" / f"{member}.jsonl"
        #: Whether no other process works on the state.
        self._alone = member is None
        #: The generations of each item.
        self._generations: dict[tuple[str, int], set[int]] = {}
        self._entries: Log | None = None
        if member is not None:
            return
        if not read_only:
            remove_unfinished(folder)
            remove_misplaced(folder, (self._numbers, self._log))
        self._find(keep_others=read_only)

    def share(self) -> None:
        """From now on other processes work on the state too: earlier generations stay until they are released."""
        self._alone = False

    def told(self, group: str, frame: int, generation: int) -> None:
        """Take note of an item that another process has written."""
        self._generations.setdefault((group, frame), set()).add(generation)

    def found(self, group: str, frame: int) -> int:
        """The newest generation of an item in the folder itself, of which note is taken; −1 if there is none."""
        for path in sorted((self.folder / group).glob(f"{frame:06d}.*.safetensors")):
            if match := _ITEM.fullmatch(path.name):
                self.told(group, frame, int(match[2]))
        return self.generation(group, frame)

    def release(self, group: str, frame: int, below: int) -> None:
        """Remove the generations of an item before one of them: nobody needs them any more."""
        self._may_write()
        generations = self._generations.get((group, frame), set())
        for earlier in [generation for generation in generations if generation < below]:
            self._path(group, frame, earlier).unlink(missing_ok=True)
            generations.remove(earlier)

    def generation(self, group: str, frame: int) -> int:
        """See `Store`."""
        return max(self._generations.get((group, frame), ()), default=-1)

    def has(self, group: str, frame: int, generation: int) -> bool:
        """See `Store`."""
        return generation in self._generations.get((group, frame), ())

    def read(
        self, group: str, frame: int, names: Collection[str] | None = None, generation: int | None = None
    ) -> Arrays:
        """See `Store`."""
        generation = self.generation(group, frame) if generation is None else generation
        item = Item(group, frame, generation)
        found = item.read(self.folder / item.path, self._run, names)
        self.bytes_read += sum(array.nbytes for array in found.values())
        return found

    def write(self, group: str, frame: int, generation: int, arrays: Arrays, durable: bool = False) -> None:
        """See `Store`."""
        item = Item(group, frame, generation)
        self.write_content(item, item.content(arrays, self._run), durable)
        self.bytes_written += sum(array.nbytes for array in arrays.values())

    def content(self, item: Item) -> bytes:
        """What the file of an item holds, to be sent to another process.

        Raises:
            DamagedItemError: there is no such file.
        """
        path = self.folder / item.path
        with reading(path, *item):
            return path.read_bytes()

    def write_content(self, item: Item, content: bytes, durable: bool = False) -> None:
        """Write what the file of an item holds; see `write`."""
        self._may_write()
        group, frame, generation = item
        if durable and self._log.exists():
            sync(self._log)
        with written_whole(self.folder / item.path, durable) as temporary:
            # Written here rather than by the library, whose error does not show that the disk is full.
            temporary.write_bytes(content)
        self.told(group, frame, generation)
        if self._alone:
            self.release(group, frame, generation)

    def discard(self, group: str, frame: int, generation: int | None = None) -> None:
        """See `Store`."""
        self._may_write()
        if not self._alone and generation is None:
            self.found(group, frame)  # others may have written some that are not known here
        generations = self._generations.get((group, frame), set())
        for one in [one for one in generations if generation in (None, one)]:
            remove_folder(self._path(group, frame, one))
            generations.remove(one)

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
        """See `Store`; the files are read once, and what is logged or heard of from then on is kept."""
        return self._all_entries.of(frame)

    def heard(self, entry: dict[str, Any]) -> None:
        """Take note of an entry that another process has added to its log."""
        self._all_entries.add(entry)

    @property
    def _all_entries(self) -> Log:
        if self._entries is None:
            paths = [self.folder / "metrics.jsonl", *sorted(self.folder.glob("log/*.jsonl"))]
            self._entries = Log.read(paths, self._run)
        return self._entries

    @property
    def _numbers(self) -> Path:
        return self.folder / "numbers.json"

    def _all_numbers(self) -> dict[str, dict[str, float]]:
        if not self._numbers.exists():
            return {}
        with reading(self._numbers):
            everything = dict(json.loads(self._numbers.read_text("utf-8")))
            if everything.pop("checksum", None) != self._checksum_of(everything):
                raise DamagedItemError(self._numbers, "the checksum is another")
            return everything

    def _checksum_of(self, numbers: dict[str, dict[str, float]]) -> str:
        form = json.dumps([self._run, numbers], sort_keys=True)
        return f"{zlib.crc32(form.encode('utf-8')):08x}"

    def _path(self, group: str, frame: int, generation: int) -> Path:
        return self.folder / Item(group, frame, generation).path

    def _find(self, keep_others: bool) -> None:
        """Take note of the items that are there: a killed run may leave earlier generations that are still needed."""
        for path in self.folder.glob("*/*.safetensors"):
            if path.parent.is_symlink():
                continue
            if match := _ITEM.fullmatch(path.name):
                self.told(path.parent.name, int(match[1]), int(match[2]))
            elif not keep_others:
                path.unlink()
