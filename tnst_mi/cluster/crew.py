"""The processes that carry out the tasks of a run, and Dask, which has them do so.

A task is given to Dask once all that it needs has been done, and forgotten once it has been done itself: what a process
has computed is in the folder of the run, so of a process that dies, only the task that it was at is done again. Which
process does what is left to Dask's scheduler; it is asked to give neighbouring frames to the same process.
"""

from __future__ import annotations

import queue
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from distributed import Client, Future, KilledWorker

from tnst_mi.cluster import member
from tnst_mi.cluster.blame import MOST_DEATHS, Blame
from tnst_mi.cluster.exchange import Done, Given, Iterated
from tnst_mi.cluster.graph import urgency
from tnst_mi.cluster.member import NotJoinedError, RefusedError
from tnst_mi.cluster.parcels import AHEAD, Parcel
from tnst_mi.cluster.roster import Roster, error_of, gone
from tnst_mi.cluster.shares import Shares
from tnst_mi.cluster.tasks import Task, Told
from tnst_mi.errors import InputError, StoppedError
from tnst_mi.optimisation.plan import Plan

#: How long an answer of Dask is waited for at once, in seconds: Ctrl-C is noticed in between; and how long one that a
#: process has, which may be gone.
_MOMENT, _PATIENCE = 0.2, 10.0


class Crew:
    """The processes of a cluster that work on a run.

    Args:
        client: of the cluster.
        order: what the processes are told of it, pickled.
        plan: of the run.
        say: how to say something to the user.
        lacking: what to say when there are no processes, where others may come; None if none will.
        pack: the items that a task needs, if the processes do not share the folder of the run.

    Attributes:
        shares: what each process has done.
    """

    def __init__(
        self,
        client: Client,
        order: bytes,
        plan: Plan,
        say: Callable[[str], None],
        lacking: str | None,
        pack: Callable[[Task], list[Parcel]] | None = None,
    ) -> None:
        self._client, self._order, self._plan, self._say, self._lacking = client, order, plan, say, lacking
        self._pack = pack
        self.shares, self._attempts = Shares(), 0
        self._begin()

    def _begin(self) -> None:
        #: Names the run in the cluster.
        self._run = uuid.uuid4().hex[:12]
        #: What processes report, and tasks that Dask has finished; of an earlier beginning, nothing arrives here.
        self._events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._roster = Roster(self._client, self._run, self._order, self.shares, self._say, self._lacking)
        self._blame = Blame()
        #: Tasks that wait to be given: with items, only some are sent at once; to nobody, none.
        self._waiting: dict[Task, Told] = {}
        self._given: dict[Task, Given] = {}
        #: What tasks have returned whose items have not come yet.
        self._results: dict[Task, Any] = {}
        events = self._events
        self._client.subscribe_topic(member.topic_of(self._run), lambda event: events.put(event[1]))

    def begin_again(self) -> None:
        """Take all tasks back, and let the processes forget what they know of the run, once they are at none."""
        self._end(patient=True)
        self._begin()

    @property
    def members(self) -> int:
        """Number of processes that may do tasks."""
        return len(self._roster.members)

    # ---------------------------------------------------------------- giving

    def give(self, tasks: Mapping[Task, Told]) -> None:
        """Have some tasks done, as soon as there is somebody to do them."""
        self._waiting |= tasks
        self._give_waiting()

    def _give_waiting(self) -> None:
        if not self._roster.members:
            return
        most = float("inf") if self._pack is None else AHEAD * len(self._roster.members)
        for task in sorted(self._waiting, key=lambda task: urgency(task, len(self._plan.frames))):
            if len(self._given) >= most:
                return
            self._give(task, self._waiting.pop(task))

    def _give(self, task: Task, told: Told) -> None:
        self._attempts += 1
        asked = self._asked(task)
        future = self._client.submit(
            member.perform,
            self._run,
            task,
            told,
            None if self._pack is None else self._pack(task),
            # Dask learns from its beginning how long such a task takes.
            key=f"{task.kind}{task.level}-{self._run}-{task.frame}-{task.iteration}-{self._attempts}",
            workers=list(asked),
            allow_other_workers=not self._roster.refused,
            priority=-urgency(task, len(self._plan.frames)),
            pure=False,
        )
        self._given[task] = Given(future, told, asked)
        events = self._events
        future.add_done_callback(lambda future: events.put((task, future)))

    def _asked(self, task: Task) -> frozenset[str]:
        """Which processes a task is for.

        Where some have been refused, it is for all others and for nobody else. Else it is best done by the one that
        has its neighbours, and Dask may give it to others.
        """
        return frozenset(self._roster.members) if self._roster.refused else frozenset([self._home(task.frame)])

    def _home(self, frame: int) -> str:
        """Where the neighbours of a frame are: each process has a part of the sequence."""
        members = self._roster.members
        return members[frame * len(members) // len(self._plan.frames)]

    def _place_again(self) -> None:
        """Others are there than before: see to it that tasks are for them.

        Of one that has left, Dask gives the tasks to others by itself; but not those that were for nobody else, and
        where nobody is left, it would give them to who has not joined. What somebody is at stays there.
        """
        members, begun = frozenset(self._roster.members), set(self._blame.at.values())
        moved = {
            task: given.told
            for task, given in self._given.items()
            if task not in begun and (not members or (self._roster.refused and given.asked != members))
        }
        self._client.cancel([self._given.pop(task).future for task in moved], force=True)
        self.give(moved)

    # ---------------------------------------------------------------- answers

    def answers(self) -> Iterator[Done | Iterated | None]:
        """What happens next, again and again as long as tasks are given; None after a moment without news.

        Raises:
            InputError: a frame cannot be computed, or no process may take part.
            StoppedError: the cluster is gone, or nobody is left; or a process says so.
            OSError: as the process that could not read or write.
        """
        while self._given or self._waiting:
            self._look()
            try:
                event = self._events.get(timeout=_MOMENT)
            except queue.Empty:
                yield None
                continue
            if isinstance(event, dict):
                if (answer := self._reported(event)) is not None:
                    yield answer
                continue
            task, future = event
            given = self._given.get(task)
            if given is None or given.future is not future:
                continue  # it was taken back
            del self._given[task]
            parcels = self._parcels(future) if future.status == "finished" and self._pack is not None else ()
            if future.status == "finished" and parcels is not None and task in self._results:
                future.release()
                yield Done(task, self._results.pop(task), parcels)
                self._give_waiting()
            else:
                self._failed(task, given.told, future)

    def _reported(self, event: dict[str, Any]) -> Done | Iterated | None:
        """Take note of what a process has reported."""
        address = event["worker"]
        if "entry" in event:
            self._blame.iterated(address, event["entry"]["iteration"])
            return Iterated(event["entry"])
        task = Task(*event["task"])
        if "took" in event:
            self._blame.ended(address, task)
            self.shares.count(address, event["took"])
            if self._pack is not None:
                self._results[task] = event["result"]
            elif (given := self._given.pop(task, None)) is not None:
                # What it has written is there. Did its process die before Dask told so, others would do it again.
                given.future.release()
                return Done(task, event["result"])
        else:
            self._blame.begun(address, task)
        return None

    def _look(self) -> None:
        """See who is there."""
        before = list(self._roster.members), bool(self._roster.refused)
        for address in self._roster.look():
            self._missed(address)
        if before != (self._roster.members, bool(self._roster.refused)):
            self._place_again()

    def _missed(self, address: str) -> None:
        if (task := self._blame.left(address)) is not None:
            raise self._deadly(task)

    def _parcels(self, future: Future) -> Sequence[Parcel] | None:
        """What a task has sent back; None if its process is gone."""
        try:
            return future.result(timeout=_PATIENCE)
        except Exception:  # what Dask raises then is of many kinds
            return None

    def _failed(self, task: Task, told: Told, future: Future) -> None:
        """Give a task again that its process was not fit for; raise what cannot be helped."""
        error = error_of(future)
        if error is None and self._client.status != "running":
            raise gone(self._client)
        if isinstance(error, RefusedError):
            self._roster.refuse(error.member, str(error))
        elif isinstance(error, NotJoinedError):
            # Another process has its address.
            self._roster.missed(error.member)
            self._missed(error.member)
        elif isinstance(error, KilledWorker):
            if self._blame.killed(task):
                raise self._deadly(task)
        elif isinstance(error, InputError | OSError | StoppedError):
            raise error
        elif error is not None:
            raise InputError(f"{task.described(self._plan)}: {type(error).__name__}: {error}") from error
        # Without an error, its process died once it was done, before Dask had told so.
        self.give({task: told})

    def _deadly(self, task: Task) -> InputError:
        return InputError(
            f"{task.described(self._plan)}: {MOST_DEATHS} processes or more have died at it, one after the other; see "
            "what they have written on stderr, and go on with --resume"
        )

    # ---------------------------------------------------------------- the end

    def take_back(self) -> None:
        """Forget the tasks that are given; those that a process is at go on, to the same bits."""
        futures = [given.future for given in self._given.values()]
        self._given, self._waiting = {}, {}
        if self._client.status == "running":  # else there is nothing to take back, and waiting for it takes long
            self._client.cancel(futures, force=True)

    def close(self) -> None:
        """Leave the cluster as it was."""
        self._end(patient=False)

    def _end(self, patient: bool) -> None:
        self.take_back()
        if self._client.status == "running":
            self._client.unsubscribe_topic(member.topic_of(self._run))
            self._roster.dismiss(patient)
