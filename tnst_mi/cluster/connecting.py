"""Connects to a cluster, and begins it where it is for one run alone."""

from __future__ import annotations

import importlib
import importlib.util
import logging
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any

import dask.config
from distributed import Client, Nanny, Scheduler, SpecCluster

from tnst_mi.errors import InputError
from tnst_mi.machine import environment
from tnst_mi.machine.backend import on_gpu
from tnst_mi.machine.terminal import one_line, shortened
from tnst_mi.run.cluster_address import BATCH, Cluster

#: Dask's processes look at themselves a hundred times a second, for pages of its dashboard that tell nothing of runs;
#: each time they take a core from tasks whose data then have to come back into its caches.
_CALM = {"distributed.worker.profile.enabled": False, "distributed.admin.tick.interval": "500ms"}

#: Environment in which the processes begin: as `_CALM`.
_CALM_ENVIRONMENT = {f"DASK_{key.upper().replace('.', '__')}": str(value) for key, value in _CALM.items()}

#: And that of local ones: Dask reports in many lines what the run says in one.
_ENVIRONMENT = {"DASK_LOGGING__DISTRIBUTED": "critical"} | _CALM_ENVIRONMENT

_UNGUARDED = (
    'A script that begins a run on local:N has to keep what it does under: if __name__ == "__main__": (its processes '
    "read it too)"
)

#: Run by each local process before it works.
_PRELOAD = "tnst_mi.cluster.local_process"

Say = Callable[[str], None]


@contextmanager
def connected(cluster: Cluster, say: Say, frames: int) -> Iterator[Client]:
    """A client of a cluster for a run of so many frames; what is begun for it ends with it.

    Raises:
        InputError: there is no such cluster.
    """
    begin = {"local": _local, "scheduler": _scheduler}.get(cluster.kind, _batch)
    with (
        _silent_libraries(),
        dask.config.set({"distributed.admin.large-graph-warning-threshold": "10 GB"} | _CALM),
        begin(cluster, frames) as (where, what),
        Client(where, set_as_default=False) as client,
    ):
        served = "dashboard" in client.scheduler_info()["services"] and importlib.util.find_spec("bokeh")
        dashboard = client.dashboard_link if served else None
        say(f"cluster: {what}" + (f", dashboard {dashboard}" if dashboard else ""))
        yield client


def lacking_workers(cluster: Cluster) -> str | None:
    """What to say when a cluster has no processes; None if none will come."""
    if cluster.kind == "local":
        return None
    if cluster.kind == "scheduler":
        return "no workers: waiting for some (dask worker SCHEDULER --nthreads 1 --memory-limit 0)"
    return f"no jobs of {cluster.kind} have begun, or theirs have ended: waiting for others"


@contextmanager
def _silent_libraries() -> Iterator[None]:
    """What Dask's libraries report of connections that end is of no use: the run says it in one line."""
    names = ("asyncio", "tornado.application", *logging.root.manager.loggerDict)
    loggers = [logging.getLogger(n) for n in names if n.partition(".")[0] in ("asyncio", "distributed", "tornado")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


@contextmanager
def _interrupts_later() -> Iterator[None]:
    """Within the block, Ctrl-C waits; processes that begin there never get it, though terminals send it to all.

    They inherit that it is blocked, and ignore it before they work (`local_process`). Windows has no such thing.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # As it begins, with the first of the processes, it lets signals through again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _local(cluster: Cluster, frames: int) -> Iterator[tuple[Any, str]]:
    """Processes on this machine; with GPUs, each has one of its own."""
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        # Begun by the run itself, this process has read the script that began it.
        raise InputError(_UNGUARDED)
    workers = {}
    for number, card in enumerate(_cards(cluster) if on_gpu() else [None] * cluster.processes):
        own = {} if card is None else {environment.VISIBLE: card}
        options = {"nthreads": 1, "memory_limit": 0, "env": own, "preload": [_PRELOAD], "dashboard": False}
        workers[number] = {"cls": Nanny, "options": options}
    scheduler = {"cls": Scheduler, "options": {"host": "127.0.0.1", "port": 0, "dashboard_address": "127.0.0.1:0"}}
    with dask.config.set({"distributed.nanny.pre-spawn-environ": _ENVIRONMENT}):
        try:
            with _interrupts_later():
                local = SpecCluster(workers=workers, scheduler=scheduler, name="tnst_mi")
        except RuntimeError as error:
            raise InputError(
                f"--cluster {cluster.address}: its processes do not begin ({shortened(one_line(str(error)), 200)}). "
                + _UNGUARDED
            ) from None
        with local:
            yield local, f"{cluster.processes} process{'' if cluster.processes == 1 else 'es'} on this machine"


def _cards(cluster: Cluster) -> list[str]:
    """A GPU for each process."""
    visible = os.environ.get(environment.VISIBLE)
    cards = visible.split(",") if visible else [str(number) for number in range(len(environment.gpus()))]
    if cluster.processes > len(cards):
        raise InputError(
            f"--cluster {cluster.address}: each process has a GPU of its own and there are {len(cards)}; take "
            f"local:{len(cards)}"
        )
    return cards[: cluster.processes]


@contextmanager
def _scheduler(cluster: Cluster, frames: int) -> Iterator[tuple[Any, str]]:
    """The user's own cluster, which goes on when the run ends."""
    yield cluster.address, cluster.address


@contextmanager
def _batch(cluster: Cluster, frames: int) -> Iterator[tuple[Any, str]]:
    """Jobs that are asked for by dask-jobqueue."""
    options: dict[str, Any] = {"cores": 1, "processes": 1, "worker_extra_args": ["--memory-limit", "0"]}
    options |= {"scheduler_options": {"dashboard_address": ":0"}} | dict(cluster.options)
    jobs = options.pop("jobs", None)
    # It takes the signals that end programs for itself as it is imported.
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    jobqueue = importlib.import_module("dask_jobqueue")
    for number, handler in handlers.items():
        signal.signal(number, handler)
    configured = dask.config.get(f"jobqueue.{cluster.kind}.job-script-prologue", None)
    prologue = options.get("job_script_prologue", configured) or []
    try:
        options["job_script_prologue"] = [
            *(f"export {name}={value}" for name, value in _CALM_ENVIRONMENT.items()),
            *prologue,
        ]
        queue = getattr(jobqueue, BATCH[cluster.kind])(**options)
    except Exception as error:  # whatever the options make Dask raise
        raise InputError(f"--cluster {cluster.address}: {shortened(one_line(str(error)), 300)}") from None
    with queue:
        # In place of jobs whose time is up, others are submitted.
        queue.adapt(minimum_jobs=jobs or 1, maximum_jobs=jobs or max(1, frames))
        walltime = options.get("walltime") or dask.config.get(f"jobqueue.{cluster.kind}.walltime", None)
        each = "one process each" + (f", for {walltime}" if walltime else "")
        yield queue, f"{f'up to {frames}' if jobs is None else jobs} jobs of {cluster.kind}, {each}"
