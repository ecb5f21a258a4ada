"""Which cluster carries out a run, by its address: `local:N`, `tcp://HOST:PORT`, or a batch system."""

from __future__ import annotations

import asyncio
import errno
import importlib
import importlib.util
import re
import shutil
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.machine.terminal import one_line, printable, shortened
from tnst_mi.recipe.recipe_file import read_recipe_file

#: Batch systems that dask-jobqueue knows, by the names that we give them.
BATCH = {"slurm": "SLURMCluster", "pbs": "PBSCluster", "sge": "SGECluster", "lsf": "LSFCluster"}

#: The commands by which they take jobs.
SUBMIT = {"slurm": "sbatch", "pbs": "qsub", "sge": "qsub", "lsf": "bsub"}

#: Seconds in which a scheduler has to answer that it is there.
_ANSWERS = 10.0

#: Arguments of dask-jobqueue that have one value here, and what to give instead; and those that are lists of texts.
_FIXED = {
    "cores": "take job_cpu for the cores that it computes on",
    "processes": "take jobs for the number of them",
    "worker_extra_args": "leave it out",
}
_LISTS = ("job_script_prologue", "job_extra_directives", "job_directives_skip")

#: Most processes on one machine, and most jobs.
_MOST, _MOST_JOBS = 256, 10_000


@dataclass(frozen=True)
class Cluster:
    """A cluster.

    Attributes:
        address: as the user gave it.
        kind: "local" for processes on this machine, which begin and end with the run; "scheduler" for the user's own
            cluster; else a key of `BATCH`, for jobs of a batch system, one process each, which end with the run.
        processes: on this machine; 0 if they are elsewhere.
        options: of a batch system: keyword arguments of dask-jobqueue's cluster, and `jobs`, their number. Of what is
            not there, Dask's own configuration says what it is, and there are as many jobs as there is work for.
        shared: whether its processes share the folder of the run, and see its input.
    """

    address: str
    kind: str
    processes: int = 0
    options: Mapping[str, Any] = field(default_factory=dict)
    shared: bool = True


def cluster_of(address: str, shared: bool = True) -> Cluster:
    """The cluster that an address means; nothing is begun.

    Args:
        address: of the cluster.
        shared: whether its processes share the folder of the run, and see its input.

    Raises:
        InputError: it means none, or Dask is not installed.
    """
    kind, _, rest = address.partition(":")
    if kind == "local" and re.fullmatch(r"[0-9]{1,4}", rest) and 1 <= int(rest) <= _MOST:
        cluster = Cluster(address, "local", int(rest))
    elif kind == "local":
        raise InputError(f"--cluster {address}: expected local:N with N from 1 to {_MOST}, such as local:2")
    elif (found := re.fullmatch(r"(?:tcp|tls)://(?:\[[0-9a-fA-F:.%]+\]|[^\s/:\[\]]+):([0-9]{1,5})", address)) and (
        0 < int(found[1]) < 1 << 16
    ):
        cluster = Cluster(address, "scheduler")
    elif kind in BATCH:
        cluster = Cluster(address, kind, options=_options(Path(rest).expanduser()) if rest else {})
    else:
        batch = ", ".join(BATCH)
        raise InputError(f"--cluster {address}: expected local:N, tcp://HOST:PORT, or {batch} with or without :FILE")
    for package in ("distributed", *(["dask_jobqueue"] if kind in BATCH else [])):
        if importlib.util.find_spec(package) is None:
            raise InputError(f"--cluster {address}: {package} is not installed; pip install 'tnst_mi[cluster]'")
    if kind in BATCH and shutil.which(SUBMIT[kind]) is None:
        raise InputError(f"--cluster {address}: {SUBMIT[kind]} is not here; run where jobs can be submitted")
    return replace(cluster, shared=shared)


def processes_of(cluster: Cluster | None) -> int:
    """How many processes of this machine do the work of a run, on a cluster or without one."""
    return 1 if cluster is None else max(1, cluster.processes)


def require_reachable(cluster: Cluster) -> None:
    """Check, before anything is read or written, that a scheduler answers where one should be.

    Raises:
        InputError: none does.
    """
    if cluster.kind != "scheduler":
        return
    host, _, port = cluster.address.partition("://")[2].rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), _ANSWERS).close()
    except OSError as error:
        reason = one_line(error.strerror or str(error))
        raise _no_scheduler(cluster, reason) from None
    try:
        found = asyncio.run(_kind_of_server(cluster.address))
    except Exception as error:  # of many kinds, where what Dask is configured for does not fit
        raise _no_scheduler(cluster, shortened(one_line(str(error)) or type(error).__name__, 200)) from None
    if found != "Scheduler":
        raise _no_scheduler(cluster, f"that is the address of a {shortened(printable(found), 20).lower()}")


async def _kind_of_server(address: str) -> str:
    """What a server of Dask's says that it is."""
    distributed = importlib.import_module("distributed")
    security = distributed.Security().get_connection_args("client")
    async with distributed.rpc(address, connection_args=security, timeout=_ANSWERS) as server:
        return str((await asyncio.wait_for(server.identity(), _ANSWERS))["type"])


def _no_scheduler(cluster: Cluster, reason: str) -> InputError:
    return InputError(
        f"--cluster {cluster.address}: no scheduler answers there ({reason}); start one with dask scheduler, or mend "
        "Dask's configuration"
    )


def _options(file: Path) -> dict[str, Any]:
    """What a file says of the jobs of a batch system."""
    try:
        if not file.is_file():
            raise FileNotFoundError(errno.ENOENT, "is no file")
        options = read_recipe_file(file)
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); give the file of the batch system") from None
    for key, instead in _FIXED.items():
        if key in options:
            said = f"{file}: {key} = {options[key]!r}"
            raise InputError(f"{said}: a job is one process with one thread of Dask's; {instead}")
    for key in _LISTS:
        found = options.get(key, [])
        if not isinstance(found, list) or not all(isinstance(entry, str) for entry in found):
            raise InputError(f"{file}: {key} = {found!r}, expected a list of texts, such as [{str(found)!r}]")
    jobs = options.get("jobs")
    if not (isinstance(jobs, int) and not isinstance(jobs, bool) and 1 <= jobs <= _MOST_JOBS):
        raise InputError(f"{file}: jobs = {jobs!r}, expected their number, from 1 to {_MOST_JOBS}")
    return options
