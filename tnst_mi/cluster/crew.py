"""The processes that carry out the tasks of a run, and Dask, which has them do so.

A task is given to Dask once all that it needs has been done, and forgotten once it has been done itself: what a process
has computed is in the folder of the run, so of a process that dies, only the task that it was at is done again. Which
process does what is left to Dask's scheduler; it is asked to give neighbouring frames to the same process.
"""

from __future__ import annotations

import queue
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from distributed import Client, Future, KilledWorker, fire_and_forget

from tnst_mi.cluster import member
from tnst_mi.cluster.exchange import Done, Given, Iterated
from tnst_mi.cluster.graph import urgency
from tnst_mi.cluster.member import NotJoinedError, RefusedError
from tnst_mi.cluster.parcels import AHEAD, Parcel
from tnst_mi.cluster.shares import Shares
from tnst_mi.cluster.tasks import Task, Told
from tnst_mi.errors import InputError, StoppedError
from tnst_mi.optimisation.plan import Plan

#: Seconds between two looks at which processes are there, and after which it is said that there are none.
_LOOK, _PATIENCE = 1.0, 10.0

#: How many processes have to die at a task for it to be the cause.
_DEATHS = 4

#: How long an answer of Dask is waited for at once: Ctrl-C is noticed in between.
_MOMENT = 0.2


class Crew:
    """The processes of a cluster that work on a run.

    Args:
        client: of the cluster.
        order: what the processes are told of it, pickled.
        plan: of the run.
        say: how to say something to the user.
        grows: whether other processes may come when there are none.
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
        grows: bool,
        pack: Callable[[Task], list[Parcel]] | None = None,
    ) -> None:
        self._client, self._order, self._plan, self._say, self._grows = client, order, plan, say, grows
        self._pack = pack
        self.shares = Shares()
        self._events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        #: Processes that may do tasks, in the order of their coming; those that have been asked to join; and refused.
        self._members: list[str] = []
        self._joining: dict[str, Future] = {}
        self._refused: dict[str, str] = {}
        self._given: dict[Task, Given] = {}
        #: What tasks have returned that are about to be done; what each process is at; how many have died at a task.
        self._results: dict[Task, Any] = {}
        self._at: dict[str, Task] = {}
        self._deaths: Counter[Task] = Counter()
        #: Tasks at which Dask says that too many have died.
        self._suspected: set[Task] = set()
        #: Those that wait for others to be done: with items, only some are sent at once.
        self._waiting: dict[Task, Told] = {}
        self._looked, self._alone_since, self._attempts = 0.0, time.monotonic(), 0
        self._begin()

    def _begin(self) -> None:
        #: Names the run in the cluster.
        self._run = uuid.uuid4().hex[:12]
        self._client.subscribe_topic(member.topic_of(self._run), lambda event: self._events.put(event[1]))

    def begin_again(self) -> None:
        """Take all tasks back, and let the processes forget what they know of the run."""
        self.close()
        self._members, self._joining, self._at, self._looked = [], {}, {}, 0.0
        self._begin()

    @property
    def members(self) -> int:
        """Number of processes that may do tasks."""
        return len(self._members)

    def give(self, tasks: Mapping[Task, Told]) -> None:
        """Have some tasks done, as soon as there is somebody to do them."""
        self._waiting |= tasks
        self._give_waiting()

    def _give_waiting(self) -> None:
        most = float("inf") if self._pack is None else AHEAD * max(1, len(self._members))
        for task in sorted(self._waiting, key=lambda task: urgency(task, len(self._plan.frames))):
            if len(self._given) >= most:
                return
            self._give(task, self._waiting.pop(task))

    def _give(self, task: Task, told: Told) -> None:
        self._attempts += 1
        home = self._home(task.frame)
        # Where some are not fit for it, a task may go to no others; else Dask may give it to whom it likes.
        only = frozenset(self._members) if self._refused and self._members else None
        future = self._client.submit(
            member.perform,
            self._run,
            task,
            told,
            None if self._pack is None else self._pack(task),
            # Dask learns from its beginning how long such a task takes.
            key=f"{task.kind}{task.level}-{self._run}-{task.frame}-{task.iteration}-{self._attempts}",
            workers=list(only) if only else None if home is None else [home],
            allow_other_workers=only is None and home is not None,
            priority=-urgency(task, len(self._plan.frames)),
            pure=False,
        )
        self._given[task] = Given(future, told, only if only else None if home is None else frozenset([home]))
        future.add_done_callback(lambda future: self._events.put((task, future)))

    def _home(self, frame: int) -> str | None:
        """Where the neighbours of a frame are: each process has a part of the sequence."""
        return self._members[frame * len(self._members) // len(self._plan.frames)] if self._members else None

    def answers(self) -> Iterator[Done | Iterated | None]:
        """What happens next, again and again as long as tasks are given; None after a moment without news.

        Raises:
            InputError: a frame cannot be computed, or no process may take part.
            StoppedError: the cluster is gone, or nobody is left; or a process says so.
            OSError: as the process that could not read or write.
        """
        while self._given:
            self._look()
            try:
                event = self._events.get(timeout=_MOMENT)
            except queue.Empty:
                yield None
                continue
            if isinstance(event, dict):
                if "entry" in event:
                    yield Iterated(event["entry"])
                elif "begun" in event:
                    self._at[event["worker"]] = Task(*event["begun"])
                else:
                    self._at.pop(event["worker"], None)
                    self._results[Task(*event["task"])] = event["result"]
                    self.shares.count(event["worker"], event["took"])
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

    def _parcels(self, future: Future) -> Sequence[Parcel] | None:
        """What a task has sent back; None if its process is gone."""
        try:
            return future.result(timeout=_PATIENCE)
        except Exception:  # what Dask raises then is of many kinds
            return None

    def _failed(self, task: Task, told: Told, future: Future) -> None:
        """Give a task again that its process was not fit for; raise what cannot be helped."""
        error = _error(future)
        if error is None and self._client.status != "running":
            raise _gone(self._client)
        if isinstance(error, RefusedError):
            self._refuse(error.member, str(error))
        if isinstance(error, NotJoinedError):
            self._looked = 0.0
        innocent = error is None  # its process died once it was done, before Dask had told so
        if isinstance(error, KilledWorker):
            # Dask also counts those to which it had been given while they were at others: so once is no proof.
            innocent = self._deaths[task] < _DEATHS and task not in self._suspected
            self._suspected.add(task)
        if innocent or isinstance(error, RefusedError | NotJoinedError):
            self._give(task, told)
        elif isinstance(error, KilledWorker):
            raise self._deadly(task)
        elif isinstance(error, InputError | OSError | StoppedError):
            raise error
        else:
            raise InputError(f"{task.described(self._plan)}: {type(error).__name__}: {error}") from error

    def _deadly(self, task: Task) -> InputError:
        return InputError(
            f"{task.described(self._plan)}: {max(_DEATHS, self._deaths[task])} processes have died at it; see what "
            "they have written on stderr, and go on with --resume"
        )

    # ---------------------------------------------------------------- who is there

    def _look(self) -> None:
        """Ask processes that are new to join, and note which have left."""
        for address, future in list(self._joining.items()):
            if future.done():
                del self._joining[address]
                self._joined(address, future)
        if time.monotonic() - self._looked < _LOOK:
            return
        self._looked = time.monotonic()
        if self._client.status != "running":
            raise _gone(self._client)
        there = self._client.scheduler_info(n_workers=-1)["workers"]
        hosts = [about["host"] for about in there.values()]
        left = [address for address in self._members if address not in there]
        for address in left:
            self._members.remove(address)
            self.shares.left(address)
            self._say(f"worker {address} has left; there are {len(self._members)}")
            if (task := self._at.pop(address, None)) is not None:
                self._deaths[task] += 1
                if self._deaths[task] >= _DEATHS:
                    raise self._deadly(task)
        for address in [address for address in self._joining if address not in there]:
            self._joining.pop(address).cancel()
        for address, about in there.items():
            if address in self._members or address in self._joining or address in self._refused:
                continue
            key = f"join-{self._run}-{address}-{time.monotonic_ns()}"
            self.shares.came(address, str(about["name"]), str(about["host"]))
            self._joining[address] = self._client.submit(
                member.join,
                self._run,
                hosts.count(about["host"]),
                member.decisive_versions(),
                self._order,
                key=key,
                workers=[address],
                priority=1,
                pure=False,
            )
        self._require_somebody()

    def _joined(self, address: str, future: Future) -> None:
        if future.status == "finished":
            self._members.append(address)
            # Dask keeps tasks for those that were asked for, even where others are allowed, if there was nobody else.
            begun, before = set(self._at.values()), self._members[:-1]
            lost = {task: of.told for task, of in self._given.items() if task not in begun and not of.fits(before)}
            self._client.cancel([self._given.pop(task).future for task in lost], force=True)
            self.give(lost)
            return
        error = _error(future)
        if error is not None:
            self._refuse(address, str(error) if isinstance(error, RefusedError) else f"{type(error).__name__}: {error}")

    def _refuse(self, address: str, reason: str) -> None:
        """Say why a process cannot take part, once, and do without it."""
        if address not in self._refused:
            self._refused[address] = reason
            self._say(f"worker {address}: refused: {reason}")
            if address in self._members:
                self._members.remove(address)

    def _require_somebody(self) -> None:
        """Say that there is nobody to do the tasks; without hope, end the run."""
        if self._members or self._joining:
            self._alone_since = time.monotonic()
        elif time.monotonic() - self._alone_since > _PATIENCE:
            if not self._grows:
                reasons = "; ".join(dict.fromkeys(self._refused.values()))
                if reasons:
                    raise InputError(f"no worker can take part: {reasons}")
                raise StoppedError("all workers have ended; see what they have written, and go on with --resume")
            self._say("no workers: waiting for some (dask worker SCHEDULER --nthreads 1 --memory-limit 0)")
            self._alone_since = float("inf")

    # ---------------------------------------------------------------- the end

    def take_back(self) -> None:
        """Forget the tasks that are given; those that a process is at go on, to the same bits."""
        futures = [given.future for given in self._given.values()]
        self._given, self._waiting = {}, {}
        if self._client.status == "running":  # else there is nothing to take back, and waiting for it takes long
            self._client.cancel(futures, force=True)

    def close(self) -> None:
        """Leave the cluster as it was."""
        self.take_back()
        if self._client.status == "running":
            self._client.unsubscribe_topic(member.topic_of(self._run))
            for address in self._members:
                # Nobody waits for it: one of them may be frozen.
                key = f"leave-{self._run}-{address}"
                fire_and_forget(self._client.submit(member.leave, self._run, key=key, workers=[address], pure=False))


def _error(future: Future) -> BaseException | None:
    """What a task raised; None if it was not done, since the scheduler is gone."""
    error: Any = future.exception() if future.status == "error" else None
    return error


def _gone(client: Client) -> StoppedError:
    address = client.scheduler.address if client.scheduler is not None else "the scheduler"
    return StoppedError(f"{address}: the scheduler is gone; start it again, and go on with --resume, nothing is lost")
