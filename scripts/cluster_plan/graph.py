"""The tasks of a shot, and which waits for which."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from cluster_plan.measured import Measured
from tnst_mi.optimisation.temporal.window import window_of

#: What is no task, but lets others begin once all of some have ended.
BARRIER = "barrier"


class Task(NamedTuple):
    """One task; of a barrier, the frame is −1."""

    kind: str
    octave: int
    iteration: int
    frame: int


@dataclass
class Graph:
    """The tasks, each after those that it waits for, and but for results in the order in which they are urgent.

    Attributes:
        frames: how many there are.
        tasks: and barriers, which are known by their places in this list.
        followers: those that wait for each.
        waits_for: how many each waits for.
    """

    frames: int
    tasks: list[Task] = field(default_factory=list)
    followers: list[list[int]] = field(default_factory=list)
    waits_for: list[int] = field(default_factory=list)

    def add(self, task: Task, waits_for: Iterable[int]) -> int:
        """Add a task, and return its place."""
        place, before = len(self.tasks), set(waits_for)
        self.tasks.append(task)
        self.followers.append([])
        self.waits_for.append(len(before))
        for earlier in before:
            self.followers[earlier].append(place)
        return place

    def urgency(self, place: int) -> int:
        """The smaller, the earlier a task should be done: results as early as they can be."""
        return place - len(self.tasks) if self.tasks[place].kind == "finish" else place


def graph_of(measured: Measured, frames: int) -> Graph:
    """The graph of a shot of so many frames, all of which are changed.

    An octave begins when the one before has ended everywhere, since the scales of its loss are measured over the whole
    sequence; for the same reason no frame has its first step before all have been measured. Then a frame waits for its
    window alone.
    """
    graph, every = Graph(frames), range(frames)
    windows = [window_of(frame, frames, measured.window) for frame in every]
    # What the next task of each frame waits for.
    before: list[list[int]] = [[] for _ in every]

    def one_each(kind: str, octave: int, iteration: int, waits_for: list[list[int]]) -> list[list[int]]:
        return [[graph.add(Task(kind, octave, iteration, frame), waits_for[frame])] for frame in every]

    def after_all(octave: int, these: list[list[int]]) -> list[list[int]]:
        return [[graph.add(Task(BARRIER, octave, 0, -1), (place for places in these for place in places))]] * frames

    for octave, iterations in enumerate(measured.iterations):
        if octave > 0:
            before = after_all(octave, before)
        inputs = one_each("inputs", octave, 0, before)
        entered = one_each("fields", octave, 0, inputs)
        if measured.has("gain", octave):
            entered += one_each(
                "gain", octave, 0, [[place for i in window for place in inputs[i]] for window in windows]
            )
        before = after_all(octave, entered)
        if measured.has("scales", octave):
            before = after_all(octave, one_each("scales", octave, 0, before))
        if measured.window == 1:
            before = one_each("iterate", octave, 0, before)
            continue
        for k in range(iterations):
            steps = one_each("step", octave, k, before)
            before = one_each(
                "average", octave, k, [[place for i in window for place in steps[i]] for window in windows]
            )
    last = len(measured.iterations) - 1
    if measured.has("finish", last):
        one_each("finish", last, 0, before)
    return graph
