"""The tasks of a shot on workers, event by event."""

from __future__ import annotations

import heapq
import itertools
import math
from collections import deque
from dataclasses import dataclass, field

from cluster_plan.graph import BARRIER, Graph
from cluster_plan.items import Cache, Items, StoreSize
from cluster_plan.machines import Machine
from cluster_plan.measured import Measured

#: Tasks that a worker is given beside the one that it runs, so that it need not wait for the scheduler.
AHEAD = 2

#: Stands for scheduler and coordinator among the workers of the first machine, whose cores they share.
_SCHEDULER = -1


@dataclass(frozen=True)
class Cluster:
    """The workers.

    Attributes:
        workers: how many there are.
        per_machine: how many of them share a machine.
        cores: of a machine; infinity if workers do not slow each other down.
        cache_bytes: what a worker keeps of items that it has read or written, without the network.
    """

    workers: int
    per_machine: int = 1
    cores: float = math.inf
    cache_bytes: float = 0.0


@dataclass(frozen=True)
class Prediction:
    """What a run would be like.

    Attributes:
        seconds: from its beginning to its end.
        idle: the part of their time that workers wait, between the first task and the last.
        bytes_read: from the shared folder, over the network.
        bytes_written: into it, results included.
        store_bytes: what the working state takes there at most.
        result_bytes: what the results take there.
        stolen: tasks that a worker did for another.
    """

    seconds: float
    idle: float
    bytes_read: float
    bytes_written: float
    store_bytes: float
    result_bytes: float
    stolen: int


@dataclass
class _Worker:
    """A worker as the scheduler sees it; both lists are heaps of tasks, with how urgent they are before them.

    Attributes:
        ready: tasks of its frames that have not been given to any worker.
        here: tasks that it has been given and has not begun.
        given: how many it has been given that have not ended, as far as the scheduler knows.
        busy: whether it runs a task.
    """

    cache: Cache
    machine: Machine
    ready: list[tuple[int, int]] = field(default_factory=list)
    here: list[tuple[int, int]] = field(default_factory=list)
    given: int = 0
    busy: bool = False
    #: Kinds of tasks that it has done, each in an octave.
    known: set[tuple[str, int]] = field(default_factory=set)

    @property
    def waiting(self) -> int:
        """Tasks that another worker could begin sooner."""
        return len(self.ready) + (len(self.here) if self.busy else 0)


def simulate(measured: Measured, graph: Graph, cluster: Cluster) -> Prediction:
    """Run a graph on a cluster.

    A task that is ready belongs to the worker of its frame: each has a block of consecutive frames. A worker begins the
    most urgent task that it has been given. One that has nothing to do takes a task from the one with the most.
    Scheduler and coordinator compute on the first machine.

    Raises:
        InputError: a task reads, and needs nothing that it could read.
    """
    return _Simulation(measured, graph, cluster).run()


class _Simulation:
    def __init__(self, measured: Measured, graph: Graph, cluster: Cluster) -> None:
        self._measured, self._graph = measured, graph
        self._items = Items(measured, graph.frames)
        self._store = StoreSize(measured, self._items, graph.frames)
        self._machines = [Machine(cluster.cores) for _ in range(-(-cluster.workers // cluster.per_machine))]
        self._workers = [
            _Worker(Cache(cluster.cache_bytes), self._machines[place // cluster.per_machine])
            for place in range(cluster.workers)
        ]
        self._waits_for = list(graph.waits_for)
        #: When, a number that keeps the order of what happens at once, and what happens: see `run`.
        self._events: list[tuple[float, int, str, int, int]] = []
        self._count = itertools.count()
        #: Workers that have been given nothing.
        self._free = set(range(cluster.workers))
        #: Workers and the tasks that they have ended, of which the scheduler has not taken note; it is at the first.
        self._ended: deque[tuple[int, int]] = deque()
        self._busy = self._read = self._written = self._results = 0.0
        self._stolen = 0
        self._began: dict[int, float] = {}

    def run(self) -> Prediction:
        """From the first task to the last."""
        first = [place for place, count in enumerate(self._waits_for) if count == 0]
        self._release(0.0, first, 0.0)
        now, latency = 0.0, self._measured.latency_seconds
        while self._events:
            now, _, what, place, other = heapq.heappop(self._events)
            if what == "ends":
                self._end(now, place, other)
            elif what == "arrives":
                heapq.heappush(self._workers[place].here, (self._graph.urgency(other), other))
                self._begin(now, place)
                self._steal(now, latency)
            else:
                self._known(now, place, other, latency)
        return Prediction(
            now + self._measured.serial_seconds(self._graph.frames),
            1 - self._busy / (now * len(self._workers)) if now > 0 else 0.0,
            self._read,
            self._written,
            self._store.most,
            self._results,
            self._stolen,
        )

    def _happens(self, when: float, what: str, place: int, other: int) -> None:
        heapq.heappush(self._events, (when, next(self._count), what, place, other))

    # ---------------------------------------------------------------- the scheduler

    def _known(self, now: float, place: int, task: int, latency: float) -> None:
        """The scheduler takes note that a worker has ended a task."""
        worker = self._workers[place]
        worker.given -= 1
        if worker.given == 0:
            self._free.add(place)
        followers = self._graph.followers[task]
        for follower in followers:
            self._waits_for[follower] -= 1
        self._release(now, [f for f in followers if self._waits_for[f] == 0], latency)
        self._fill(now, place, latency)
        self._steal(now, latency)

    def _release(self, now: float, ready: list[int], latency: float) -> None:
        """Tasks are ready, and barriers open: give those to their workers, as far as these have room."""
        homes = set()
        while ready:
            place = ready.pop()
            task = self._graph.tasks[place]
            if task.kind == BARRIER:
                for follower in self._graph.followers[place]:
                    self._waits_for[follower] -= 1
                ready += [f for f in self._graph.followers[place] if self._waits_for[f] == 0]
                continue
            home = task.frame * len(self._workers) // self._graph.frames
            heapq.heappush(self._workers[home].ready, (self._graph.urgency(place), place))
            homes.add(home)
        for home in sorted(homes):
            self._fill(now, home, latency)

    def _fill(self, now: float, place: int, latency: float) -> None:
        """Give a worker tasks of its own, as many as it has room for."""
        worker = self._workers[place]
        while worker.ready and worker.given <= AHEAD:
            self._send(now + latency, place, heapq.heappop(worker.ready)[1])

    def _steal(self, now: float, latency: float) -> None:
        """Give workers that have nothing tasks of those that have the most."""
        for place in sorted(self._free):
            victim = max(self._workers, key=lambda worker: worker.waiting)
            if victim.waiting == 0:
                break
            self._stolen += 1
            if victim.ready:
                _, task = heapq.heappop(victim.ready)
            else:
                _, task = heapq.heappop(victim.here)
                victim.given -= 1
            self._send(now + latency, place, task)

    def _send(self, when: float, place: int, task: int) -> None:
        self._workers[place].given += 1
        self._free.discard(place)
        self._happens(when, "arrives", place, task)

    # ---------------------------------------------------------------- the workers

    def _begin(self, now: float, place: int) -> None:
        """A worker begins the most urgent task that it has, if it is free and has one."""
        worker = self._workers[place]
        if worker.busy or not worker.here:
            return
        _, number = heapq.heappop(worker.here)
        task = self._graph.tasks[number]
        for item, generation, size in self._items.read(task):
            if not worker.cache.has(item, generation):
                self._read += size
            worker.cache.use(item, generation, self._items.size(item.name, item.octave))
        worker.busy, self._began[number] = True, now
        cost = self._measured.cost(task.kind, task.octave)
        seconds = cost.seconds
        if (kind := (task.kind, task.octave)) not in worker.known and cost.first_seconds is not None:
            seconds = cost.first_seconds
        worker.known.add(kind)
        worker.machine.start(now, seconds, place, number)
        self._foresee(place)

    def _machine(self, place: int) -> Machine:
        return self._machines[0] if place == _SCHEDULER else self._workers[place].machine

    def _foresee(self, place: int) -> None:
        """Note when the next task of the machine of a worker, or of the scheduler, ends."""
        machine = self._machine(place)
        if machine.next_end() < math.inf:
            self._happens(machine.next_end(), "ends", place, machine.changes)

    def _end(self, now: float, place: int, changes: int) -> None:
        """A task ends on the machine of a worker, unless something has changed there since this was foreseen."""
        machine = self._machine(place)
        if machine.changes != changes:
            return
        ran_on, number = machine.end(now)
        if ran_on == _SCHEDULER:
            self._happens(now, "known", *self._ended.popleft())
            if self._ended:
                self._take_note(now)
            self._foresee(_SCHEDULER)
            return
        worker, task = self._workers[ran_on], self._graph.tasks[number]
        worker.busy = False
        self._busy += now - self._began.pop(number)
        for item, generation in self._items.written(task):
            worker.cache.use(item, generation, self._items.size(item.name, item.octave))
        written = self._measured.cost(task.kind, task.octave).bytes_written
        self._written += written
        self._results += written if task.kind == "finish" else 0.0
        self._store.after(task)
        if not self._measured.scheduler_seconds:
            self._happens(now, "known", ran_on, number)
        else:
            self._ended.append((ran_on, number))
            if len(self._ended) == 1:
                self._take_note(now)
        self._begin(now, ran_on)
        if not worker.busy:
            # Those that share its machine go faster.
            self._foresee(place)

    def _take_note(self, now: float) -> None:
        """The scheduler begins with the first task that has ended."""
        self._machines[0].start(now, self._measured.scheduler_seconds, _SCHEDULER, self._ended[0][1])
        self._foresee(_SCHEDULER)
