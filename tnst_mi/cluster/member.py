"""A process that carries out tasks of runs: what it is told of a run, and the checks with which it joins.

A process that would come to other bits, or to none, is refused by a line that says why.
"""

from __future__ import annotations

import os
import pickle
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from distributed import get_worker

from tnst_mi.cluster.parcels import Parcel, made, packed, unpacked
from tnst_mi.cluster.tasks import Task, Told, Workplace, carry_out
from tnst_mi.errors import InputError, StoppedError
from tnst_mi.io.atomic import remove_folder
from tnst_mi.machine import environment
from tnst_mi.machine.backend import activate, kernel_threads, network_threads
from tnst_mi.machine.lock import LOCK
from tnst_mi.machine.turns import turn
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.network.weights import find_weights
from tnst_mi.optimisation.items.device_store import DeviceStore
from tnst_mi.optimisation.items.store import FolderStore
from tnst_mi.run.folder import WORK, RunFolder
from tnst_mi.run.work import Work

#: Packages whose versions decide bits.
DECISIVE = ("tnst_mi", "mitsuba", "drjit", "torch", "numpy")


class RefusedError(InputError):
    """A process cannot take part in a run; the message says why.

    Attributes:
        member: the address of the process.
    """

    def __init__(self, message: str, member: str) -> None:
        super().__init__(message)
        self.member = member

    def __reduce__(self) -> tuple[type[RefusedError], tuple[str, str]]:
        """As another process gets it."""
        return RefusedError, (str(self), self.member)


class NotJoinedError(RuntimeError):
    """A process was given a task of a run that it has not joined.

    Attributes:
        member: the address of the process.
    """

    def __init__(self, member: str) -> None:
        super().__init__(member)
        self.member = member


@dataclass(frozen=True)
class Order:
    """What a process is told of a run.

    Attributes:
        work: of the run.
        identity: of the run, see `run.record.run_identity`.
        lock: the contents of the lock of its folder, as long as it goes on.
        weights: the file of the network, or the name of one that ships with the package.
        weights_digest: its SHA-256.
        variant: of Mitsuba.
        threads: of torch on the CPU.
        shared: whether the processes share the folder of the run, and see its input.
    """

    work: Work
    identity: str
    lock: bytes
    weights: str
    weights_digest: str
    variant: str
    threads: int
    shared: bool


#: By run: versions and the pickled order.
_delivered: dict[str, tuple[dict[str, str], bytes]] = {}

#: By run: where its tasks are carried out. One at a time, since each takes memory for the network.
_joined: dict[str, Workplace] = {}


def join(run: str, sharing: int, versions: dict[str, str], order: bytes) -> None:
    """Take part in a run, before its first task.

    Args:
        run: names it.
        sharing: how many processes share the cores of this machine.
        versions: of `DECISIVE` packages.
        order: what there is to know of the run, pickled: it is read by processes of the same versions only.

    Raises:
        RefusedError: this process cannot.
    """
    with turn():
        _delivered[run] = versions, order
        _workplace(run)
        kernel_threads(_cores() // (1 if _has_cores_of_its_own() else sharing))


def perform(run: str, task: Task, told: Told, parcels: list[Parcel] | None = None) -> list[Parcel]:
    """Carry out a task of a run, and report what it took.

    Args:
        run: names it.
        task: what to do.
        told: what it needs besides items.
        parcels: the items that it needs; None if they are in the shared folder.

    Returns:
        What the task has written, if it was sent parcels. What `carry_out` returns is reported.

    Raises:
        NotJoinedError: this process has not joined the run.
        InputError, OSError, StoppedError: see `carry_out`.
    """
    since = time.perf_counter()
    with turn():
        worker = get_worker()
        if run not in _delivered:
            raise NotJoinedError(worker.address)
        place = _workplace(run)
        topic, backing = topic_of(run), place.backing
        worker.log_event(topic, {"worker": worker.address, "task": task})
        read, written = backing.bytes_read, backing.bytes_written

        def report(entry: dict[str, Any]) -> None:
            worker.log_event(topic, {"worker": worker.address, "entry": entry})

        unpacked(backing, parcels or ())
        result = carry_out(task, told, place, report)
        sent = [] if parcels is None else packed(backing, made(place.plan, task))
        if parcels is not None:
            backing.clear()
        took = {
            "kind": task.kind,
            "level": task.level,
            "seconds": time.perf_counter() - since,
            "read": backing.bytes_read - read,
            "written": backing.bytes_written - written,
        }
        worker.log_event(topic, {"worker": worker.address, "took": took, "task": task, "result": result})
    return sent


def topic_of(run: str) -> str:
    """The topic of what processes report of a run."""
    return f"tnst_mi-{run}"


def decisive_versions() -> dict[str, str]:
    """The versions of the packages that decide bits."""
    versions = environment.versions()
    return {name: str(versions[name]) for name in DECISIVE}


def _workplace(run: str) -> Workplace:
    if run not in _joined:
        for other in list(_joined):
            _leave(other)
        address = get_worker().address
        try:
            _joined[run] = _entered(run)
        except RefusedError:
            raise
        except (InputError, OSError, StoppedError) as error:
            raise RefusedError(str(error), address) from None
    return _joined[run]


def leave(run: str) -> None:
    """Forget a run that has ended."""
    with turn():
        _delivered.pop(run, None)
        _leave(run)


def _leave(run: str) -> None:
    if place := _joined.pop(run, None):
        place.store.close()
        if place.backing.folder.parent != place.work.out:
            remove_folder(place.backing.folder.parent)


def _entered(run: str) -> Workplace:
    """Where tasks of a run are carried out, once it is certain that they can be.

    Raises:
        InputError: they cannot.
    """
    worker = get_worker()
    if worker.state.nthreads != 1:
        raise InputError(f"it has {worker.state.nthreads} threads, expected 1; start it with --nthreads 1")
    versions, pickled = _delivered[run]
    for name, expected in versions.items():
        if (own := decisive_versions()[name]) != expected:
            raise InputError(f"it has {name} {own}, and the run {expected}; install the same")
    order: Order = pickle.loads(pickled)
    work, out = order.work, order.work.out
    assert out is not None
    activate(order.variant)
    network_threads(order.threads)
    weights = find_weights(order.weights)
    network = GoogLeNet.from_file(weights.path)
    if network.sha256 != order.weights_digest:
        raise InputError(f"{weights.path}: is another network than that of the run; give it the same file")
    member = f"{platform.node()}.{os.getpid()}.{worker.address.rpartition(':')[2]}"
    may_write: Callable[[], None] = _may_always
    if order.shared:
        may_write = _Lock(out, order.lock)
        may_write()
        first = next(iter(work.unchanged))
        if first.name != work.names[0]:
            raise InputError(f"{first.name}: is not {work.names[0]}, the first frame of the run")
    else:
        # Is removed with the process, as Dask's own files are.
        out = Path(worker.local_directory) / f"tnst_mi-{run}"
    backing = FolderStore(out / WORK, order.identity, may_write, member=member)
    folder = RunFolder(out, work.recipe, suffix=work.suffix, may_write=may_write, joining=True)
    return Workplace(work, network, DeviceStore(backing, work.cache_bytes), folder)


def _has_cores_of_its_own() -> bool:
    return _cores() < (os.cpu_count() or 1)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _may_always() -> None:
    """What is in a folder of this process's own may be written."""


@dataclass(frozen=True)
class _Lock:
    """Checks, before anything is written, that the run still goes on in its folder, which all processes share."""

    out: Path
    expected: bytes

    def __call__(self) -> None:
        try:
            found = (self.out / LOCK).read_bytes()
        except OSError as error:
            raise StoppedError(
                f"{self.out}: is not the folder of the run on {platform.node()} ({error.strerror}); share it, by the "
                "same path on all machines"
            ) from None
        if found != self.expected:
            raise StoppedError(f"{self.out}: its run has ended, or another goes on there, so nothing more is written")
