"""A Dask cluster as processes of its own: a scheduler, and workers of one thread."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from distributed import Client

from cluster_measures.observed import pinned

#: As docs/cluster.md advises for clusters of one's own.
CALM = {"DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False", "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "500ms"}

#: Seconds after which a scheduler, and workers, should have begun.
PATIENCE = 120.0


class Processes:
    """The processes of a cluster.

    Args:
        folder: where they leave files; it is created.
        host: the scheduler's address.

    Attributes:
        address: where the scheduler listens.
        scheduler: its process.
        workers: those of its workers.
    """

    def __init__(self, folder: Path, host: str = "127.0.0.1") -> None:
        folder.mkdir(parents=True)
        self._folder, file = folder, folder / "scheduler.json"
        self.workers: list[subprocess.Popen[bytes]] = []
        arguments = ["--host", host, "--port", "0", "--no-dashboard", "--scheduler-file", str(file)]
        self.scheduler = self._begun("scheduler", arguments, [])
        until = time.monotonic() + PATIENCE
        while not (file.exists() and file.read_text("utf-8").endswith("}")):
            if self.scheduler.poll() is not None or time.monotonic() > until:
                self.close()
                raise RuntimeError(f"the scheduler does not begin; see {folder / 'scheduler.log'}")
            time.sleep(0.05)
        self.address = json.loads(file.read_text("utf-8"))["address"]

    def add(self, cores: Collection[int] = (), within: Sequence[str] = (), host: str | None = None) -> None:
        """One more worker.

        Args:
            cores: those on which it may compute; all, if it is empty.
            within: the beginning of its command, which says where it is carried out.
            host: its own address.
        """
        arguments = ["--nthreads", "1", "--memory-limit", "0", "--no-nanny", "--no-dashboard"]
        arguments += ["--local-directory", str(self._folder), *(["--host", host] if host else [])]
        self.workers.append(self._begun("worker", [*arguments, self.address], [*within, *pinned(cores)]))

    def wait(self) -> None:
        """Wait until all workers have come, if there are any."""
        if not self.workers:
            return
        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(len(self.workers), timeout=PATIENCE)

    def kill(self, process: subprocess.Popen[bytes]) -> None:
        """Kill one of them (SIGKILL)."""
        process.kill()
        process.wait()
        with contextlib.suppress(ValueError):
            self.workers.remove(process)

    def close(self) -> None:
        """Kill all that are left."""
        for process in [*self.workers, self.scheduler]:
            self.kill(process)

    def _begun(self, what: str, arguments: list[str], within: list[str]) -> subprocess.Popen[bytes]:
        command = [*within, sys.executable, "-m", f"distributed.cli.dask_{what}", *arguments]
        with (self._folder / f"{what}.log").open("ab") as log:
            return subprocess.Popen(command, env=os.environ | CALM, stdout=log, stderr=log)


@contextlib.contextmanager
def processes(folder: Path, workers: Sequence[Collection[int]], host: str = "127.0.0.1") -> Iterator[Processes]:
    """A cluster with workers on some cores each, killed in the end."""
    cluster = Processes(folder, host)
    try:
        for cores in workers:
            cluster.add(cores)
        cluster.wait()
        yield cluster
    finally:
        cluster.close()
