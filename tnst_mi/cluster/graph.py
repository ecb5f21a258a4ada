"""Which task of a run needs which others: Algorithm 1 without barriers but between octaves.

Within an octave, the average of a frame waits for the own steps of its window and for nothing else. So frames far from
each other may be iterations apart: neighbours by one, and those in w + 1 frames' distance by two. An octave waits for
the one before, since the scales of its loss are measured over the whole sequence.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

from tnst_mi.cluster.tasks import AVERAGE, FIELDS, FINISH, GAIN, INPUTS, ITERATE, SCALES, STEP, Task
from tnst_mi.optimisation.plan import Plan
from tnst_mi.optimisation.temporal.window import window_of

#: What each task needs, of the tasks that are left.
Needs = dict[Task, set[Task]]

#: Whether an item is there: kind, index of the frame, generation.
Has = Callable[[str, int, int], bool]


class TaskGraph:
    """Tasks that are left, and those of them that can be done now.

    Args:
        needs: the tasks, with what each needs; what is not among them has been done.
    """

    def __init__(self, needs: Mapping[Task, Collection[Task]]) -> None:
        self._needs = {task: {need for need in wanted if need in needs} for task, wanted in needs.items()}
        self._needed_by: dict[Task, list[Task]] = {}
        for task, wanted in self._needs.items():
            for need in wanted:
                self._needed_by.setdefault(need, []).append(task)
        self._left = set(self._needs)

    def __len__(self) -> int:
        """Number of tasks that have not been done."""
        return len(self._left)

    @property
    def ready(self) -> list[Task]:
        """Those that need no other one."""
        return [task for task, wanted in self._needs.items() if not wanted]

    def done(self, task: Task) -> list[Task]:
        """Take note that a task has been done; returns those that can be done now, and could not before."""
        if task not in self._left:
            return []
        self._left.remove(task)
        following = self._needed_by.pop(task, [])
        for other in following:
            self._needs[other].remove(task)
        return [other for other in following if not self._needs[other]]


def entering(plan: Plan, level: int, has: Has) -> Needs:
    """The tasks by which all frames enter an octave, of which some may have done so."""
    windowed, alive = plan.window > 1, {frame.index for frame in plan.alive}
    # Neighbours are transported through unchanged frames too.
    present = range(len(plan.frames)) if windowed else sorted(alive)
    needs: Needs = {Task(INPUTS, level, t): set() for t in present if not has("inputs", t, 0)}
    for t in sorted(alive):
        if not any(has("fields", t, done) for done in range(plan.iterations(level) + 1)):
            needs[Task(FIELDS, level, t)] = {Task(INPUTS, level, t)}
        if windowed and plan.recipe.window_average == "smoke" and not has("gain", t, 0):
            window = window_of(t, len(plan.frames), plan.window)
            needs[Task(GAIN, level, t)] = {Task(INPUTS, level, i) for i in window}
    return needs


def measuring(plan: Plan, level: int) -> Needs:
    """The tasks that measure the scales of an octave's loss."""
    return {Task(SCALES, level, frame.index): set() for frame in plan.alive}


def iterating(plan: Plan, level: int, done: Mapping[int, int], has: Has, finished: Collection[int]) -> Needs:
    """The iterations of an octave, and after the last octave the results of each frame.

    Args:
        plan: of the sequence.
        level: the octave.
        done: by frame, the iterations that are done.
        has: whether an item of the octave is there.
        finished: frames whose results are there, and are not needed any more.
    """
    last, needs = level == len(plan.octaves) - 1, Needs()
    alive = [f.index for f in plan.alive if plan.window > 1 or not (last and f.index in finished)]
    for t in alive:
        count = plan.iterations(level)
        if plan.window == 1:
            if done[t] < count:
                needs[Task(ITERATE, level, t)] = set()
            continue
        for k in range(done[t], count):
            if not has("step", t, k + 1):
                needs[Task(STEP, level, t, k)] = {Task(AVERAGE, level, t, k - 1)}
            followed = {Task(STEP, level, i, k) for i in plan.followed_by(t)}
            needs[Task(AVERAGE, level, t, k)] = {Task(AVERAGE, level, t, k - 1), *followed}
    for frame in plan.frames if last else ():
        if frame.index not in finished:
            count = plan.iterations(level)
            before = Task(ITERATE, level, frame.index), Task(AVERAGE, level, frame.index, count - 1)
            needs[Task(FINISH, level, frame.index)] = set(before)
    return needs


def urgency(task: Task, frames: int) -> int:
    """The smaller, the earlier a task should be done: what others wait for, then frames in their order."""
    phase = 2 * task.iteration + (task.kind == AVERAGE)
    if task.kind == FINISH:
        phase = -1  # results are shown as early as they can be
    return phase * frames + task.frame
