"""The items of a run: what tasks read and write, what workers still have of it, and what the store holds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from cluster_plan.graph import Task
from cluster_plan.measured import Measured
from tnst_mi.errors import InputError
from tnst_mi.optimisation.temporal.window import window_of

#: Kinds of tasks by which frames enter an octave, and of what they write.
_ENTERING = ("inputs", "fields", "gain")


class Item(NamedTuple):
    """One item of one frame: "input" (the frame's file), "inputs", "fields", "gain" or "step" of an octave."""

    name: str
    octave: int
    frame: int


class Items:
    """Which items tasks read and write, and how many bytes of each.

    Sizes are what tasks write. What a task was measured to read is divided among the items that it needs, in proportion
    to their sizes; at the ends of a sequence, where windows are truncated, it reads less.

    Raises:
        InputError: a task reads, and needs nothing that it could read.
    """

    def __init__(self, measured: Measured, frames: int) -> None:
        self._measured, self._frames = measured, frames
        self._sizes = {
            (name, octave): measured.cost(name, octave).bytes_written
            for name in ("inputs", "fields", "gain", "step")
            for octave in range(len(measured.iterations))
        }
        #: Nothing else is read by what enters the first octave.
        self._file_size = measured.cost("inputs", 0).bytes_read or 0.0
        self._share = {of: self._share_read(*of) for of in measured.costs}

    def size(self, name: str, octave: int) -> float:
        """Bytes of an item."""
        return self._file_size if name == "input" else self._sizes[name, octave]

    def _share_read(self, kind: str, octave: int) -> float:
        """The part of the items that it needs that is read by a task."""
        task, read = Task(kind, octave, 0, self._measured.window // 2), self._measured.cost(kind, octave).bytes_read
        needed = sum(self.size(item.name, item.octave) for item, _ in self._needed(task, self._measured.window))
        if read and not needed:
            raise InputError(f"tasks.{kind}: bytes_read = {read:.0f} in octave {octave}, but it needs nothing to read")
        return 1.0 if read is None or not needed else read / needed

    def _needed(self, task: Task, frames: int) -> Iterator[tuple[Item, int]]:
        """The items that a task needs, and their generations, in a sequence of so many frames."""
        kind, octave, k, frame = task
        if kind in ("inputs", "finish"):
            yield Item("input", 0, frame), 0
        if kind in ("scales", "step", "iterate"):
            yield Item("inputs", octave, frame), 0
        if kind == "fields" and octave > 0:
            yield Item("fields", octave - 1, frame), self._measured.iterations[octave - 1]
        if kind in ("scales", "step", "average", "iterate"):
            yield Item("fields", octave, frame), k
        if kind == "finish":
            yield Item("fields", octave, frame), self._measured.iterations[octave]
        if kind in ("gain", "average"):
            window = window_of(frame, frames, self._measured.window)
            yield from ((Item("inputs", octave, i), 0) for i in window)
            if kind == "average":
                yield Item("gain", octave, frame), 0
                yield from ((Item("step", octave, i), k) for i in window)

    def read(self, task: Task) -> Iterator[tuple[Item, int, float]]:
        """The items that a task reads, their generations, and how many bytes of each are read."""
        share = self._share[task.kind, task.octave]
        for item, generation in self._needed(task, self._frames):
            yield item, generation, share * self.size(item.name, item.octave)

    def written(self, task: Task) -> Iterator[tuple[Item, int]]:
        """The items that a task writes, and their generations; results, which nothing reads, are none."""
        kind, octave, k, frame = task
        if kind in ("inputs", "fields", "gain"):
            yield Item(kind, octave, frame), 0
        elif kind == "step":
            yield Item("step", octave, frame), k
        elif kind == "average":
            yield Item("fields", octave, frame), k + 1
        elif kind == "iterate":
            yield Item("fields", octave, frame), self._measured.iterations[octave]


class Cache:
    """What a worker still has of the items that it has read or written: those that it used last.

    Args:
        capacity: in bytes.
    """

    def __init__(self, capacity: float) -> None:
        self._capacity, self._held = capacity, 0.0
        #: By item: generation and bytes, the longest unused first.
        self._items: dict[Item, tuple[int, float]] = {}

    def has(self, item: Item, generation: int) -> bool:
        """Whether an item is there, in this generation."""
        return self._items.get(item, (-1, 0.0))[0] == generation

    def use(self, item: Item, generation: int, size: float) -> None:
        """Keep an item that has been read or written, in place of its earlier generation."""
        self._held -= self._items.pop(item, (0, 0.0))[1]
        if size > self._capacity:
            return
        self._items[item] = generation, size
        self._held += size
        while self._held > self._capacity:
            longest = next(iter(self._items))
            self._held -= self._items.pop(longest)[1]


class StoreSize:
    """How many bytes the store holds, and how many it has held at most.

    A step is kept until every frame whose window has it has followed it; the other items of an octave until all frames
    have entered the next one, and its last fields until they have entered the one after.
    """

    def __init__(self, measured: Measured, items: Items, frames: int) -> None:
        self._measured, self._items, self._frames = measured, items, frames
        #: By octave, the tasks that are left until all frames have entered it.
        self._entering = [
            frames * sum(measured.has(kind, octave) for kind in _ENTERING) for octave in range(len(measured.iterations))
        ]
        #: By step and iteration, the frames that have not followed it.
        self._followers: dict[tuple[Item, int], int] = {}
        self._held = self.most = 0.0

    def after(self, task: Task) -> None:
        """Count what a task has written, and what has become superfluous."""
        kind, octave, k, frame = task
        window = window_of(frame, self._frames, self._measured.window)
        if kind in _ENTERING:
            self._add(self._items.size(kind, octave))
            self._entering[octave] -= 1
            if self._entering[octave] == 0:
                self._forget(octave)
        elif kind == "step":
            self._followers[Item("step", octave, frame), k] = len(window)
            self._add(self._items.size("step", octave))
        elif kind == "average":
            for step in ((Item("step", octave, i), k) for i in window):
                self._followers[step] -= 1
                if self._followers[step] == 0:
                    del self._followers[step]
                    self._add(-self._items.size("step", octave))

    def _forget(self, octave: int) -> None:
        """All frames have entered an octave."""
        if octave > 0:
            self._add(-self._frames * (self._items.size("inputs", octave - 1) + self._items.size("gain", octave - 1)))
        if octave > 1:
            self._add(-self._frames * self._items.size("fields", octave - 2))

    def _add(self, size: float) -> None:
        self._held += size
        self.most = max(self.most, self._held)
