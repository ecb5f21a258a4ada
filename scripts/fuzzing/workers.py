"""Reads in a process of its own: one that crashes or hangs costs that process alone."""

from __future__ import annotations

import multiprocessing
import tempfile
from multiprocessing.connection import Connection
from pathlib import Path

from fuzzing.trials import Trial, limit_memory, trial

#: A read that takes longer than so many seconds by the clock hangs, whatever else the machine does. Stages of USD are
#: given 60 s by their reader.
HANGS = 90.0

#: Bytes beyond those of the libraries; a read that needs more fails.
_MEMORY_LIMIT = 4 << 30

_STARTING = 120.0


class Worker:
    """Reads damaged files, one after the other, in another process, which is started anew when it dies."""

    def __init__(self) -> None:
        self._process: multiprocessing.process.BaseProcess | None = None
        self._connection: Connection | None = None

    def read(self, name: str, content: bytes) -> Trial:
        """Read a damaged file by the reader of a name."""
        if self._connection is None:
            self._start()
        assert self._connection is not None and self._process is not None
        try:
            self._connection.send((name, content))
            if self._connection.poll(HANGS):
                return self._connection.recv()
            fault = {"hang": f"no end after {HANGS:.0f} s"}
        except (EOFError, OSError):
            self._process.join()
            fault = {"crash": f"the process ended with code {self._process.exitcode}"}
        self.close()
        return Trial(fault)

    def close(self) -> None:
        """End the process."""
        if self._process is not None and self._connection is not None:
            self._process.kill()
            self._process.join()
            self._connection.close()
        self._process = self._connection = None

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()
        if not self._connection.poll(_STARTING) or self._connection.recv() != "ready":
            raise RuntimeError("the process that reads does not start")


def _serve(connection: Connection) -> None:
    limit_memory(_MEMORY_LIMIT)
    connection.send("ready")
    with tempfile.TemporaryDirectory() as folder:
        while True:
            try:
                name, content = connection.recv()
            except EOFError:
                return
            place = Path(folder) / name
            place.mkdir(exist_ok=True)
            connection.send(trial(name, content, place))
