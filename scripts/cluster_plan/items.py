"""The items of a run: what tasks read and write, what workers still have of it, and what the store holds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from cluster_plan.graph import Task
from cluster_plan.measured import Measured
from tnst_mi.errors import InputError
from tnst_mi.optimisation.temporal.window import window_of


class Item(NamedTuple):
    """One item of one frame: "input" (the frame's file), "inputs", "fields", "gain" or "step" of an octave."""

    name: str
    octave: int
    frame: int


class Items:
    """Which items tasks read and write, and how many bytes of each.

    Sizes follow from what tasks write. What a task was measured to read is divided among the items that it reads, in
    proportion to their sizes; at the ends of a sequence, where windows are truncated, it reads less.

    Raises:
        InputError: a task reads, and nothing is there that it could read.
    """

    def __init__(self, measured: Measured, frames: int) -> None:
        self._measured, self._frames = measured, frames
        octaves = range(len(measured.iterations))
        changing, self.entering = ("average" if measured.window > 1 else "octave"), "enter"
        if not measured.has("enter", 0):
            self.entering = "octave"
        self._sizes: dict[tuple[str, int], float] = {}
        for octave in octaves:
            fields = measured.cost(changing, octave).bytes_written
            entered = measured.cost("enter", octave).bytes_written
            self._sizes["fields", octave] = fields
            self._sizes["inputs", octave] = max(entered - fields, 0.0)
            self._sizes["gain", octave] = measured.cost("gain", octave).bytes_written
            self._sizes["step", octave] = measured.cost("own", octave).bytes_written
            # Nothing else is read in the first octave.
            self._sizes["input", octave] = measured.cost(self.entering, 0).bytes_read
        self._share = {of: self._share_read(*of) for of in measured.costs}

    def size(self, name: str, octave: int) -> float:
        """Bytes of an item."""
        return self._sizes[name, octave]

    def _share_read(self, kind: str, octave: int) -> float:
        """The part of the items that it reads that is read by a task, 0 to 1 or so."""
        middle = self._measured.window // 2
        task, read = Task(kind, octave, 0, middle), self._measured.cost(kind, octave).bytes_read
        there = sum(self.size(item.name, item.octave) for item, _ in self._named(task, self._measured.window))
        if read > 0 and there == 0:
            raise InputError(
                f"tasks.{kind}: bytes_read = {read:.0f} in octave {octave}, but nothing is there to be read"
            )
        return read / there if there > 0 else 0.0

    def _named(self, task: Task, frames: int) -> Iterator[tuple[Item, int]]:
        """The items that a task reads, and their generations, in a sequence of so many frames."""
        kind, octave, k, frame = task
        if kind in (self.entering, "finish"):
            yield Item("input", 0, frame), 0
            before = octave if kind == "finish" else octave - 1
            if before >= 0:
                yield Item("fields", before, frame), self._measured.iterations[before]
            return
        window = window_of(frame, frames, self._measured.window)
        yield from ((Item("inputs", octave, i), 0) for i in (window if kind in ("gain", "average") else (frame,)))
        if kind != "gain":
            yield Item("fields", octave, frame), k
        if kind == "average":
            yield Item("gain", octave, frame), 0
            yield from ((Item("step", octave, i), k) for i in window)

    def read(self, task: Task) -> Iterator[tuple[Item, int, float]]:
        """The items that a task reads, their generations, and how many bytes of each are read."""
        share = self._share[task.kind, task.octave]
        for item, generation in self._named(task, self._frames):
            yield item, generation, share * self.size(item.name, item.octave)

    def written(self, task: Task) -> Iterator[tuple[Item, int]]:
        """The items that a task writes, and their generations; results, which nothing reads, are none."""
        kind, octave, k, frame = task
        if kind == "enter":
            yield Item("inputs", octave, frame), 0
            yield Item("fields", octave, frame), 0
        elif kind == "gain":
            yield Item("gain", octave, frame), 0
        elif kind == "own":
            yield Item("step", octave, frame), k
        elif kind in ("average", "octave"):
            generation = k + 1 if kind == "average" else self._measured.iterations[octave]
            yield Item("fields", octave, frame), generation


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
        self._entered = [0] * len(measured.iterations)
        self._readers: dict[tuple[int, int, int], int] = {}
        self._held = self.most = 0.0

    def after(self, task: Task) -> None:
        """Count what a task has written, and what has become superfluous."""
        kind, octave, k, frame = task
        if kind == self._items.entering:
            self._enter(octave)
        elif kind == "gain":
            self._add(self._items.size("gain", octave))
        elif kind == "own":
            self._readers[octave, frame, k] = len(window_of(frame, self._frames, self._measured.window))
            self._add(self._items.size("step", octave))
        elif kind == "average":
            for i in window_of(frame, self._frames, self._measured.window):
                self._readers[octave, i, k] -= 1
                if self._readers[octave, i, k] == 0:
                    del self._readers[octave, i, k]
                    self._add(-self._items.size("step", octave))

    def _enter(self, octave: int) -> None:
        size = self._items.size
        self._add(size("inputs", octave) + size("fields", octave))
        self._entered[octave] += 1
        if self._entered[octave] < self._frames:
            return
        if octave > 0:
            self._add(-self._frames * (size("inputs", octave - 1) + size("gain", octave - 1)))
        if octave > 1:
            self._add(-self._frames * size("fields", octave - 2))

    def _add(self, size: float) -> None:
        self._held += size
        self.most = max(self.most, self._held)
