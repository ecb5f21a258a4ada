"""Connects to a cluster, and begins it where it is for one run alone."""

from __future__ import annotations

import importlib
import importlib.util
import logging
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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

#: Run by each local process before it works.
_PRELOAD = "tnst_mi.cluster.local_process"

Say = Callable[[str], None]


@contextmanager
def connected(cluster: Cluster, say: Say, frames: int) -> Iterator[Client]:
    """A client of a cluster for a run of so many frames; what is begun for it ends with it.

    Raises:
        InputError: there is no such cluster.
    """
    # As `_ENVIRONMENT`, in this process; what Dask's libraries report of connections that end is of no use either.
    for name in ("asyncio", "tornado.application", *(name for name in logging.root.manager.loggerDict)):
        if name.partition(".")[0] in ("asyncio", "distributed", "tornado"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
    begin = {"local": _local, "scheduler": _scheduler}.get(cluster.kind, _batch)
    with (
        dask.config.set({"distributed.admin.large-graph-warning-threshold": "10 GB"} | _CALM),
        begin(cluster, frames) as (where, what),
        Client(where, set_as_default=False) as client,
    ):
        dashboard = client.dashboard_link if importlib.util.find_spec("bokeh") else None
        say(f"cluster: {what}" + (f", dashboard {dashboard}" if dashboard else ""))
        yield client


@contextmanager
def _local(cluster: Cluster, frames: int) -> Iterator[tuple[Any, str]]:
    """Processes on this machine; with GPUs, each has one of its own."""
    workers = {}
    for number, card in enumerate(_cards(cluster) if on_gpu() else [None] * cluster.processes):
        own = {} if card is None else {environment.VISIBLE: card}
        options = {"nthreads": 1, "memory_limit": 0, "env": own, "preload": [_PRELOAD], "dashboard": False}
        workers[number] = {"cls": Nanny, "options": options}
    scheduler = {"cls": Scheduler, "options": {"host": "127.0.0.1", "port": 0, "dashboard_address": "127.0.0.1:0"}}
    with (
        dask.config.set({"distributed.nanny.pre-spawn-environ": _ENVIRONMENT}),
        SpecCluster(workers=workers, scheduler=scheduler, name="tnst_mi") as local,
    ):
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
    try:
        with Client(cluster.address, set_as_default=False):
            pass
    except Exception as error:  # of many kinds, where what Dask is configured for does not fit
        raise InputError(
            f"--cluster {cluster.address}: no scheduler answers there ({one_line(str(error))}); start one with dask "
            "scheduler, or mend Dask's configuration"
        ) from None
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
        if jobs is None:
            queue.adapt(minimum_jobs=1, maximum_jobs=max(1, frames))
        else:
            queue.scale(jobs=jobs)
        yield queue, f"{f'up to {frames}' if jobs is None else jobs} jobs of {cluster.kind}, one process each"
