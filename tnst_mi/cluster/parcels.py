"""What tasks read and write, item by item: for processes that do not share the folder of the run.

Then the process that the user has started does what reads the input or writes results, and sends each other task the
items that it needs, as they are in its folder; it writes what comes back. A process keeps them in a folder of its own
until its task is done.
"""

from __future__ import annotations

from collections.abc import Iterable

from tnst_mi.cluster.tasks import AVERAGE, FIELDS, FINISH, GAIN, INPUTS, ITERATE, SCALES, STEP, Task
from tnst_mi.optimisation.items.item import Item
from tnst_mi.optimisation.items.store import FolderStore
from tnst_mi.optimisation.plan import Plan
from tnst_mi.optimisation.temporal.window import window_of

#: An item, and what its file holds.
Parcel = tuple[Item, bytes]

#: Kinds of tasks that read the input or write results.
AT_HOME = (INPUTS, FINISH)

#: Tasks that are sent at once for each process: one that it is at, and one that waits.
AHEAD = 2


def needed(plan: Plan, task: Task, done: int) -> list[Item]:
    """The items that a task reads.

    Args:
        plan: of the sequence.
        task: of a kind that is not `AT_HOME`.
        done: iterations of its frame that are done in the octave.
    """
    kind, level, t, k = task
    own, fields = Item(f"inputs.{level}", t, 0), f"fields.{level}"
    around = [Item(f"inputs.{level}", i, 0) for i in window_of(t, len(plan.frames), plan.window)]
    if kind == FIELDS:
        coarser = level > plan.first_octave
        return [own, *([Item(f"fields.{level - 1}", t, plan.iterations(level - 1))] if coarser else [])]
    if kind == GAIN:
        return around
    if kind in (SCALES, ITERATE):
        return [own, Item(fields, t, done)]
    if kind == STEP:
        return [own, Item(fields, t, k)]
    steps = [Item(f"step.{level}", i, k + 1) for i in plan.followed_by(t)]
    gain = [Item(f"gain.{level}", t, 0)] if plan.recipe.window_average == "smoke" else []
    return [*around, Item(fields, t, k), *gain, *steps]


def made(plan: Plan, task: Task) -> list[Item]:
    """The items that a task writes, of those that others need."""
    kind, level, t, k = task
    return {
        FIELDS: [Item(f"fields.{level}", t, 0)],
        GAIN: [Item(f"gain.{level}", t, 0)],
        SCALES: [],
        STEP: [Item(f"step.{level}", t, k + 1)],
        AVERAGE: [Item(f"fields.{level}", t, k + 1)],
        ITERATE: [Item(f"fields.{level}", t, plan.iterations(level))],
    }[kind]


def packed(store: FolderStore, items: Iterable[Item]) -> list[Parcel]:
    """Items of a store, to be sent.

    Raises:
        DamagedItemError: one is not there.
    """
    return [(item, store.content(item)) for item in items]


def unpacked(store: FolderStore, parcels: Iterable[Parcel]) -> None:
    """Put items that were sent into a store.

    Raises:
        OSError: they cannot be written.
    """
    for item, content in parcels:
        store.write_content(item, content)
