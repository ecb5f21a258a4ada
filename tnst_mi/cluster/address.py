"""Which cluster carries out a run: processes on this machine, the user's own one, or jobs of a batch system."""

from __future__ import annotations

import importlib
import importlib.util
import logging
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tnst_mi.errors import InputError, naming
from tnst_mi.io.bounded_toml import toml_values

if TYPE_CHECKING:
    from distributed import Client

#: Batch systems that dask-jobqueue knows, by the names that we give them.
BATCH = {"slurm": "SLURMCluster", "pbs": "PBSCluster", "sge": "SGECluster", "lsf": "LSFCluster"}

EXPECTED = "local:N, tcp://HOST:PORT, or a batch system such as slurm or slurm:FILE"

#: Most processes on one machine.
_MOST = 256

Say = Callable[[str], None]


class Cluster(ABC):
    """A cluster by its address.

    Attributes:
        address: as the user gave it.
        processes: on this machine, 0 if they are elsewhere.
        grows: whether processes may come later than the run begins.
    """

    address: str
    processes = 0
    grows = True

    @abstractmethod
    def connected(self, say: Say, frames: int) -> Any:
        """A context with a client of the cluster for a run of so many frames; what is begun for it ends with it.

        Raises:
            InputError: there is no such cluster.
        """


def cluster_of(address: str) -> Cluster:
    """The cluster that an address means; nothing is begun.

    Raises:
        InputError: it means none, or Dask is not installed.
    """
    kind, _, rest = address.partition(":")
    if kind == "local" and re.fullmatch(r"\d{1,4}", rest) and 1 <= int(rest) <= _MOST:
        cluster: Cluster = LocalProcesses(address, int(rest))
    elif kind == "local":
        raise InputError(f"--cluster {address}: expected local:N with N from 1 to {_MOST}, such as local:2")
    elif re.fullmatch(r"(tcp|tls)://\S+:\d{1,5}", address):
        cluster = Scheduler(address)
    elif kind in BATCH:
        cluster = BatchSystem(address, kind, _options(Path(rest).expanduser()) if rest else {})
    else:
        raise InputError(f"--cluster {address}: expected {EXPECTED}")
    for package in ("distributed", *(["dask_jobqueue"] if kind in BATCH else [])):
        if importlib.util.find_spec(package) is None:
            raise InputError(f"--cluster {address}: {package} is not installed; pip install 'tnst_mi[cluster]'")
    return cluster


@dataclass(frozen=True)
class LocalProcesses(Cluster):
    """Processes on this machine, which begin and end with the run."""

    address: str
    processes: int
    grows = False

    @contextmanager
    def connected(self, say: Say, frames: int) -> Iterator[Client]:
        """See `Cluster`; with GPUs, each process has one of its own."""
        import dask.config
        from distributed import Nanny, Scheduler, SpecCluster

        from tnst_mi.machine.backend import on_gpu

        _be_quiet()
        cards = _cards(self) if on_gpu() else [None] * self.processes
        workers = {}
        for number, card in enumerate(cards):
            environment = {"DASK_LOGGING__DISTRIBUTED": "error"} | (
                {} if card is None else {"CUDA_VISIBLE_DEVICES": card}
            )
            options = {"nthreads": 1, "memory_limit": 0, "env": environment, "preload": [_PRELOAD]}
            workers[number] = {"cls": Nanny, "options": options | {"dashboard_address": None, "dashboard": False}}
        scheduler = {"cls": Scheduler, "options": {"host": "127.0.0.1", "port": 0, "dashboard_address": "127.0.0.1:0"}}
        with (
            dask.config.set({"distributed.nanny.pre-spawn-environ": _ENVIRONMENT}),
            SpecCluster(workers=workers, scheduler=scheduler, name="tnst_mi") as cluster,
            _client(cluster) as client,
        ):
            _announce(say, client, f"{self.processes} processes on this machine")
            yield client


@dataclass(frozen=True)
class Scheduler(Cluster):
    """The user's own cluster, by the address of its scheduler; it goes on when the run ends."""

    address: str

    @contextmanager
    def connected(self, say: Say, frames: int) -> Iterator[Client]:
        """See `Cluster`."""
        _be_quiet()
        try:
            client = _client(self.address)
        except (OSError, TimeoutError) as error:
            raise InputError(
                f"--cluster {self.address}: no scheduler answers there ({type(error).__name__}); start one with dask "
                "scheduler"
            ) from None
        with client:
            _announce(say, client, self.address)
            yield client


@dataclass(frozen=True)
class BatchSystem(Cluster):
    """Jobs of a batch system, one process each, asked for by dask-jobqueue; they end with the run.

    Attributes:
        kind: a key of `BATCH`.
        options: keyword arguments of dask-jobqueue's cluster, and `jobs`, their number; of what is not there, Dask's
            own configuration says what it is, and there are as many jobs as there is work for.
    """

    address: str
    kind: str
    options: Mapping[str, Any]

    @contextmanager
    def connected(self, say: Say, frames: int) -> Iterator[Client]:
        """See `Cluster`."""
        _be_quiet()
        options = {"cores": 1, "processes": 1, "worker_extra_args": ["--memory-limit", "0"]} | dict(self.options)
        jobs = options.pop("jobs", None)
        try:
            cluster = getattr(importlib.import_module("dask_jobqueue"), BATCH[self.kind])(**options)
        except (TypeError, ValueError) as error:
            raise InputError(f"--cluster {self.address}: {' '.join(str(error).split())}") from None
        with cluster:
            if jobs is None:
                cluster.adapt(minimum_jobs=1, maximum_jobs=frames)
            else:
                cluster.scale(jobs=jobs)
            with _client(cluster) as client:
                _announce(say, client, f"{f'up to {frames}' if jobs is None else jobs} jobs of {self.kind}")
                yield client


#: Environment in which local processes begin: Dask reports in many lines what the run says in one.
_ENVIRONMENT = {"DASK_LOGGING__DISTRIBUTED": "critical"}

#: Run by each local process before it works.
_PRELOAD = "tnst_mi.cluster.local_process"


def _options(file: Path) -> dict[str, Any]:
    try:
        with naming(file):
            options = toml_values(file.read_text("utf-8"))
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); give the file of the batch system") from None
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{file}: is no TOML ({error})") from None
    jobs = options.get("jobs")
    if not (isinstance(jobs, int) and not isinstance(jobs, bool) and 1 <= jobs <= 10_000):
        raise InputError(f"{file}: jobs = {jobs!r}, expected their number, 1 or more")
    return options


def _cards(cluster: LocalProcesses) -> list[str]:
    """A GPU for each process."""
    from tnst_mi.machine import environment

    visible = os.environ.get(environment.VISIBLE)
    cards = visible.split(",") if visible else [str(number) for number in range(len(environment.gpus()))]
    if cluster.processes > len(cards):
        raise InputError(
            f"--cluster {cluster.address}: each process has a GPU of its own and there are {len(cards)}; take "
            f"local:{len(cards)}"
        )
    return cards[: cluster.processes]


def _client(where: Any) -> Client:
    from distributed import Client

    return Client(where, set_as_default=False)


def _announce(say: Say, client: Client, what: str) -> None:
    dashboard = client.dashboard_link
    say(f"cluster: {what}" + (f", dashboard {dashboard}" if dashboard and importlib.util.find_spec("bokeh") else ""))


def _be_quiet() -> None:
    """As `_ENVIRONMENT`, in this process."""
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
