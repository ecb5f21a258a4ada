"""Which cluster carries out a run, by its address: `local:N`, `tcp://HOST:PORT`, or a batch system."""

from __future__ import annotations

import errno
import importlib.util
import re
import shutil
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.machine.terminal import one_line
from tnst_mi.recipe.recipe_file import read_recipe_file

#: Batch systems that dask-jobqueue knows, by the names that we give them.
BATCH = {"slurm": "SLURMCluster", "pbs": "PBSCluster", "sge": "SGECluster", "lsf": "LSFCluster"}

#: The commands by which they take jobs.
SUBMIT = {"slurm": "sbatch", "pbs": "qsub", "sge": "qsub", "lsf": "bsub"}

#: Seconds in which a scheduler has to answer that it is there.
_ANSWERS = 10.0

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

    @property
    def grows(self) -> bool:
        """Whether processes may come later than the run begins."""
        return self.kind != "local"


def cluster_of(address: str, shared: bool = True) -> Cluster:
    """The cluster that an address means; nothing is begun.

    Args:
        address: of the cluster.
        shared: whether its processes share the folder of the run, and see its input.

    Raises:
        InputError: it means none, or Dask is not installed.
    """
    kind, _, rest = address.partition(":")
    if kind == "local" and re.fullmatch(r"\d{1,4}", rest) and 1 <= int(rest) <= _MOST:
        cluster = Cluster(address, "local", int(rest))
    elif kind == "local":
        raise InputError(f"--cluster {address}: expected local:N with N from 1 to {_MOST}, such as local:2")
    elif (found := re.fullmatch(r"(?:tcp|tls)://(?:\[[0-9a-fA-F:.%]+\]|[^\s/:\[\]]+):(\d{1,5})", address)) and (
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
    """Check, before anything is read or written, that something answers where a scheduler should be.

    Raises:
        InputError: nothing does.
    """
    if cluster.kind != "scheduler":
        return
    host, _, port = cluster.address.partition("://")[2].rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), _ANSWERS).close()
    except OSError as error:
        reason = one_line(error.strerror or str(error))
        raise InputError(
            f"--cluster {cluster.address}: no scheduler answers there ({reason}); start one with dask scheduler"
        ) from None


def _options(file: Path) -> dict[str, Any]:
    """What a file says of the jobs of a batch system."""
    try:
        if not file.is_file():
            raise FileNotFoundError(errno.ENOENT, "is no file")
        options = read_recipe_file(file)
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); give the file of the batch system") from None
    jobs = options.get("jobs")
    if not (isinstance(jobs, int) and not isinstance(jobs, bool) and 1 <= jobs <= _MOST_JOBS):
        raise InputError(f"{file}: jobs = {jobs!r}, expected their number, from 1 to {_MOST_JOBS}")
    return options
