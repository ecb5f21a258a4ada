"""Whether a cluster comes to the results of one process, whatever becomes of its workers and its scheduler."""

from __future__ import annotations

import contextlib
import random
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from cluster_measures.hosts import Network, NoHostsError, hosts
from cluster_measures.observed import Observed, OnTask, Trial, observe
from cluster_measures.part import Part, table
from cluster_measures.processes import Processes, processes
from cluster_measures.setting import Setting, small
from cluster_measures.smoke import digest
from tnst_mi.errors import StoppedError

#: Runs in which a worker is killed, and in which the scheduler is.
WORKER_KILLS, SCHEDULER_KILLS = 20, 3

#: A kill comes up to so many seconds after a random task: in the middle of the next one, or between two.
LATER = 0.06


def same_bits(folder: Path) -> Part:
    """The results of one process against those of one to three workers."""
    return same(small(folder), (1, 2, 3))


def same(setting: Setting, workers: Sequence[int]) -> Part:
    """The results of one process against those of several."""
    part = Part("The same bits")
    for address in (None, *(f"local:{count}" for count in workers)):
        trial = setting.trial(address)
        observe(trial)
        part.values[address or "one process"] = digest(trial.out)
    part.lines = [setting.described(), "", *table(("run", "SHA-256 of all results"), list(part.values.items()))]
    part.holds["all results are the same"] = len(set(part.values.values())) == 1
    return part


# ---------------------------------------------------------------- kills


def kills(folder: Path, workers: int = WORKER_KILLS, schedulers: int = SCHEDULER_KILLS) -> Part:
    """Runs on two workers of which one is killed, and runs whose scheduler is, at random moments."""
    part, setting, rng = Part("Kills"), small(folder), random.Random(1)
    alone = setting.trial()
    observe(alone)
    expected = digest(alone.out)
    with processes(folder / "cluster", [(), ()]) as cluster:
        needed = _kinds([observe(setting.trial(cluster.address))])
        of_workers = [_worker_killed(setting, cluster, needed.total(), rng) for _ in range(workers)]
    of_schedulers = [_scheduler_killed(setting, needed.total(), rng) for _ in range(schedulers)]
    rows = []
    for what, runs in (("worker", of_workers), ("scheduler", of_schedulers)):
        twice = [_kinds(parts) - needed for _, parts in runs]
        equal = [found == expected for found, _ in runs]
        kinds = sum(twice, Counter())
        rows.append(
            (
                what,
                len(runs),
                sum(equal),
                kinds.total(),
                max((one.total() for one in twice), default=0),
                ", ".join(f"{count} {kind}" for kind, count in kinds.items()) or "–",
            )
        )
        part.values[what] = {"same": equal, "twice": [dict(one) for one in twice]}
        part.holds[f"with a {what} killed, all results are those of one process"] = all(equal)
    head = ("killed", "runs", "with the same bits", "tasks that ended twice", "most in one run", "of these")
    part.lines = [f"{setting.described()}; {needed.total()} tasks", "", *table(head, rows)]
    return part


#: The digest of the results, and what was seen of the parts of the run.
_Killed = tuple[str, list[Observed]]


def _worker_killed(setting: Setting, cluster: Processes, tasks: int, rng: random.Random) -> _Killed:
    """A run in which one of two workers is killed; another one comes."""
    trial, victim = setting.trial(cluster.address), rng.choice(cluster.workers)

    def kill() -> None:
        cluster.kill(victim)
        cluster.add()

    with _at_a_random_moment(kill, tasks, rng) as on_task:
        seen = observe(trial, on_task)
    cluster.wait()
    return digest(trial.out), [seen]


def _scheduler_killed(setting: Setting, tasks: int, rng: random.Random) -> _Killed:
    """A run whose scheduler is killed, and that is resumed on another cluster."""
    trial, parts = setting.trial(), [Observed()]
    with processes(trial.out.with_suffix(".first"), [(), ()]) as cluster:
        with _at_a_random_moment(lambda: cluster.kill(cluster.scheduler), tasks, rng) as on_task:

            def note(seen: Observed) -> None:
                parts[0] = seen
                on_task(seen)

            with contextlib.suppress(StoppedError):
                observe(replace(trial, address=cluster.address), note)
    with processes(trial.out.with_suffix(".second"), [(), ()]) as cluster:
        parts.append(observe(replace(trial, address=cluster.address)))
    return digest(trial.out), parts


@contextlib.contextmanager
def _at_a_random_moment(act: Callable[[], None], tasks: int, rng: random.Random) -> Iterator[OnTask]:
    """A callback for `observe` that acts once, up to `LATER` seconds after one of so many tasks."""
    after, timer = rng.randrange(1, tasks), threading.Timer(rng.uniform(0, LATER), act)

    def on_task(seen: Observed) -> None:
        if len(seen.tasks) == after:
            timer.start()

    yield on_task
    timer.join()


def _kinds(parts: Sequence[Observed]) -> Counter[str]:
    """How many tasks of each kind and octave have ended."""
    return Counter(f"{task['kind']} {task['level'] + 1}" for seen in parts for task in seen.tasks)


# ---------------------------------------------------------------- hosts


def on_hosts(folder: Path, counts: Sequence[int] = (2, 3)) -> Part:
    """Workers on hosts of their own, which reach the scheduler and the coordinator by a network alone."""
    part, setting = Part("Hosts"), small(folder)
    alone = setting.trial()
    observe(alone)
    rows = [("one process", digest(alone.out), "–", "–")]
    for count in counts:
        try:
            with hosts(count) as network:
                trial, seen, traffic = _run_on(network, setting, folder / f"cluster_{count}")
        except NoHostsError as error:
            part.skipped = str(error)
            return part
        (cluster,) = seen.record["cluster"]
        shares = ", ".join(f"{worker['host']}: {worker['tasks']}" for worker in cluster["workers"])
        rows.append((f"{count} hosts", digest(trial.out), shares, f"{traffic / len(seen.tasks) / 1000:.1f} kB"))
    head = ("run", "SHA-256 of all results", "tasks of each host", "network, per task")
    part.lines = [setting.described(), "", *table(head, rows)]
    part.values = {str(run): {"digest": found, "tasks": of, "network": kb} for run, found, of, kb in rows}
    part.holds["all results are the same"] = len({found for _, found, *_ in rows}) == 1
    return part


def _run_on(network: Network, setting: Setting, folder: Path) -> tuple[Trial, Observed, int]:
    """A run with one worker on each host; also the bytes that these send and receive for it."""
    with processes(folder, [], network.address) as cluster:
        for host in network.hosts:
            cluster.add(within=host.within, host=host.address)
        cluster.wait()
        before, trial = network.traffic(), setting.trial(cluster.address)
        seen = observe(trial)
        return trial, seen, network.traffic() - before
