"""The order of tasks: whatever is done first, each finds what it reads, and nothing is done that has been done."""

from __future__ import annotations

import random
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tnst_mi.cluster.graph import TaskGraph, entering, iterating, measuring, urgency
from tnst_mi.cluster.progression import Progression
from tnst_mi.cluster.tasks import AVERAGE, FINISH, ITERATE, STEP, Task
from tnst_mi.optimisation.plan import Plan, plan_of
from tnst_mi.recipe.recipe import Recipe

GOAL = {"semantic": ("inception_3a/3x3:2",), "octaves": 2, "iterations": 3}


def plan(count: int, window: int, still: frozenset[int] = frozenset()) -> Plan:
    scales = [0.0 if index in still else 1.0 for index in range(count)]
    names = [f"s_{index}" for index in range(count)]
    return plan_of(Recipe(**GOAL, window=window), names, list(range(count)), scales, [0.2] * count, (8, 12, 10))


class Shelf:
    """The items of an octave, by kind and frame: takes note of what is written and released, and of what is read."""

    def __init__(self) -> None:
        self.items: dict[tuple[str, int], set[int]] = {}

    def told(self, group: str, frame: int, generation: int) -> None:
        self.items.setdefault((group.partition(".")[0], frame), set()).add(generation)

    def release(self, group: str, frame: int, below: int) -> None:
        kept = self.items.get((group.partition(".")[0], frame), set())
        kept -= {generation for generation in kept if generation < below}

    def has(self, kind: str, frame: int, generation: int) -> bool:
        return generation in self.items.get((kind, frame), ())

    def require(self, kind: str, frame: int, generation: int, task: Task) -> None:
        assert self.has(kind, frame, generation), f"{task} reads {kind} {generation} of frame {frame}"


def carried_out(
    plan: Plan, shelf: Shelf, done: dict[int, int], choose: random.Random, stop: int | None, finished: set[int]
) -> list[Task]:
    """Do the tasks of the last octave in a random order, each when it can be, up to a number of them."""
    level = len(plan.octaves) - 1
    graph = TaskGraph(iterating(plan, level, done, shelf.has, finished))
    crew: Any = SimpleNamespace(members=1)
    progression = Progression(plan, shelf, None, crew, None, lambda progress: None)  # pyright: ignore
    progression._level, progression._done = level, done
    waiting, order = graph.ready, []
    while waiting and len(order) != stop:
        task = waiting.pop(choose.randrange(len(waiting)))
        order.append(task)
        if task.kind in (STEP, AVERAGE):
            shelf.require("fields", task.frame, task.iteration, task)
        if task.kind == AVERAGE:
            for i in plan.followed_by(task.frame):
                shelf.require("step", i, task.iteration + 1, task)
            progression._advanced(task.frame, task.iteration + 1)
            progression._release_steps(task.frame)
        elif task.kind == STEP:
            shelf.told("step", task.frame, task.iteration + 1)
        elif task.kind == FINISH and not plan.frames[task.frame].still:
            shelf.require("fields", task.frame, plan.iterations(level), task)
        waiting += graph.done(task)
    return order


@given(
    st.integers(2, 9), st.sampled_from([3, 5, 9]), st.frozensets(st.integers(0, 8), max_size=3), st.integers(0, 10**6)
)
def test_any_order_finds_what_it_reads_and_any_stop_leaves_what_is_needed(
    count: int, window: int, still: frozenset[int], seed: int
) -> None:
    of = plan(count, window, still)
    choose, shelf, done = random.Random(seed), Shelf(), {frame.index: 0 for frame in of.alive}
    for index in done:
        shelf.told("fields", index, 0)
    order: list[Task] = []
    # The run is stopped here and there, and goes on from what is on the shelf.
    for stop in (choose.randrange(1, 30), choose.randrange(1, 30), None):
        finished = {task.frame for task in order if task.kind == FINISH}
        order += carried_out(of, shelf, done, choose, stop, finished)
    assert len(set(order)) == len(order), "nothing is done twice"
    assert {task.frame for task in order if task.kind == FINISH} == set(range(count))
    assert set(done.values()) <= {of.iterations(1)}
    assert all(shelf.items[kind, t] == {of.iterations(1)} for kind, t in shelf.items if kind == "fields")


@pytest.mark.parametrize("window", [3, 5])
def test_frames_run_ahead_by_no_more_than_their_windows_let_them(window: int) -> None:
    """Last in, first out: as far ahead as it gets. Frames d apart are at most ⌈d / w⌉ iterations apart."""
    of = plan(9, window)
    shelf, done = Shelf(), {frame.index: 0 for frame in of.alive}
    for index in done:
        shelf.told("fields", index, 0)
    graph = TaskGraph(iterating(of, 1, done, shelf.has, ()))
    waiting, reach, furthest = graph.ready, window // 2, 0
    while waiting:
        task = waiting.pop(0 if len(waiting) == 1 else max(range(len(waiting)), key=lambda i: -waiting[i].frame))
        if task.kind == AVERAGE:
            done[task.frame] = task.iteration + 1
            for i, j in ((i, j) for i in done for j in done if j > i):
                assert abs(done[i] - done[j]) <= -(-(j - i) // reach)
            furthest = max(furthest, max(done.values()) - min(done.values()))
        waiting += graph.done(task)
    assert furthest == min(3, 8 // reach), "there is no barrier"


def test_an_octave_is_entered_with_what_each_part_needs() -> None:
    of, nothing = plan(5, 3, frozenset([2])), lambda kind, frame, generation: False
    needs = entering(of, 0, nothing)
    assert {task.frame for task in needs if task.kind == "inputs"} == {0, 1, 2, 3, 4}
    assert {task.frame for task in needs if task.kind == "gain"} == {0, 1, 3, 4}
    assert needs[Task("gain", 0, 1)] == {Task("inputs", 0, i) for i in (0, 1, 2)}
    assert needs[Task("fields", 0, 3)] == {Task("inputs", 0, 3)}
    assert set(measuring(of, 0)) == {Task("scales", 0, frame) for frame in (0, 1, 3, 4)}
    # Without a window, frames that stay unchanged are not looked at.
    alone = entering(plan(5, 1, frozenset([2])), 0, nothing)
    assert {(task.kind, task.frame) for task in alone} == {
        (kind, i) for kind in ("inputs", "fields") for i in (0, 1, 3, 4)
    }
    assert entering(of, 0, lambda kind, frame, generation: True) == {}


def test_without_a_window_frames_go_their_ways_alone_and_still_ones_have_results_too() -> None:
    of = plan(3, 1, frozenset([1]))
    needs = iterating(of, 1, {0: 0, 2: 3}, lambda *_: False, finished=[2])
    assert set(needs) == {Task(ITERATE, 1, 0), Task(FINISH, 1, 0), Task(FINISH, 1, 1)}
    assert Task(ITERATE, 1, 0) in needs[Task(FINISH, 1, 0)]
    assert TaskGraph(needs).ready == [Task(ITERATE, 1, 0), Task(FINISH, 1, 1)]


def test_what_others_wait_for_is_more_urgent() -> None:
    tasks = [Task(STEP, 0, 0, 1), Task(AVERAGE, 0, 8, 0), Task(STEP, 0, 3, 0), Task(FINISH, 0, 2), Task(STEP, 0, 2, 0)]
    assert [(task.kind, task.frame) for task in sorted(tasks, key=lambda task: urgency(task, 9))] == [
        (FINISH, 2),
        (STEP, 2),
        (STEP, 3),
        (AVERAGE, 8),
        (STEP, 0),
    ]
