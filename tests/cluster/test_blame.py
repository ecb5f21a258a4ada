"""Which task is the cause when processes die."""

from __future__ import annotations

import pytest

pytest.importorskip("distributed", reason="needs tnst_mi[cluster]")

from tnst_mi.cluster.blame import MOST_DEATHS, Blame
from tnst_mi.cluster.tasks import ITERATE, STEP, Task

TASK, OTHER = Task(STEP, 0, 3, 1), Task(STEP, 0, 4, 1)


def test_a_task_at_which_several_die_in_turn_is_the_cause() -> None:
    blame = Blame()
    for number in range(MOST_DEATHS):
        blame.begun(f"worker {number}", TASK)
        blame.begun(f"neighbour {number}", OTHER)
        found = blame.left(f"worker {number}")
        blame.ended(f"neighbour {number}", OTHER)
        assert found == (TASK if number == MOST_DEATHS - 1 else None)


def test_processes_that_die_between_tasks_blame_none() -> None:
    blame = Blame()
    for number in range(10):
        blame.begun(f"worker {number}", TASK)
        blame.ended(f"worker {number}", TASK)
        assert blame.left(f"worker {number}") is None
        assert blame.left(f"idle {number}") is None


def test_a_task_that_gets_further_each_time_is_not_the_cause() -> None:
    """Hours of iterations, on machines that are taken away; unless it always ends at the same one."""
    task = Task(ITERATE, 1, 0)
    for further in (True, False):
        blame, found = Blame(), []
        for number in range(2 * MOST_DEATHS):
            blame.begun("worker", task)
            for iteration in range(5 * number if further else 5, 5 * number + 8 if further else 8):
                blame.iterated("worker", iteration)
            found.append(blame.left("worker"))
        # The first death comes after iterations that were new.
        assert found.count(None) == (len(found) if further else MOST_DEATHS - 1)


def test_what_dask_says_is_no_proof_at_once() -> None:
    blame = Blame()
    assert not blame.killed(TASK) and blame.killed(TASK)
    assert not blame.killed(OTHER)
    blame.begun("worker", OTHER)
    blame.ended("worker", OTHER)
    assert not blame.killed(OTHER)
