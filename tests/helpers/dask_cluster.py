"""A Dask cluster on this machine as its processes: a scheduler, and workers that can be killed one by one."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

_SCHEDULER = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--no-dashboard"]
_WORKER = [sys.executable, "-m", "distributed.cli.dask_worker", "--no-nanny", "--no-dashboard", "--memory-limit", "0"]


class Processes:
    """The processes of a cluster.

    Args:
        folder: for what they write.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        command = [
            sys.executable,
            "-m",
            "distributed.cli.dask_scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            "0",
            "--no-dashboard",
        ]
        self.scheduler = self._started(command)
        self.address = self._said(self.scheduler, r"Scheduler at:\s+(tcp://\S+)")
        self.workers: list[subprocess.Popen[str]] = []

    def add(self, *arguments: str, threads: int = 1, **environment: str) -> subprocess.Popen[str]:
        """One more worker."""
        where = ["--local-directory", str(self.folder), self.address]
        command = [*_WORKER, *where, "--nthreads", str(threads), *arguments]
        self.workers.append(worker := self._started(command, **environment))
        assert worker.stderr is not None
        threading.Thread(target=worker.stderr.read, daemon=True).start()
        return worker

    def kill(self, process: subprocess.Popen[str]) -> None:
        """Kill one of them (SIGKILL)."""
        process.send_signal(signal.SIGKILL)
        process.wait()
        with contextlib.suppress(ValueError):
            self.workers.remove(process)

    def close(self) -> None:
        """Kill all that are left."""
        for process in [*self.workers, self.scheduler]:
            self.kill(process)

    def _started(self, command: list[str], **environment: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [*command, "--local-directory", str(self.folder)]
            if "--no-nanny" in command
            else [*command, "--no-dashboard"],
            env=os.environ | {"OMP_NUM_THREADS": "1"} | environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    @staticmethod
    def _said(process: subprocess.Popen[str], pattern: str) -> str:
        """What a process says of itself; the rest is read too, so that it can go on."""
        assert process.stderr is not None
        for line in process.stderr:
            if found := re.search(pattern, line):
                threading.Thread(target=process.stderr.read, daemon=True).start()
                return found[1]
        raise AssertionError("it has ended")


@contextlib.contextmanager
def processes(folder: Path, workers: int) -> Iterator[Processes]:
    """A cluster with so many workers, killed in the end."""
    cluster = Processes(folder)
    try:
        for _ in range(workers):
            cluster.add()
        yield cluster
    finally:
        cluster.close()
