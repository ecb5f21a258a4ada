"""tnst-mi as a process beside Houdini: started, watched and ended without waiting for it."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

from .progress import Progress, error_of, progress_of

#: Seconds that a process has after Ctrl-C to write what it has got, and after being terminated.
_PATIENCE = (30.0, 10.0)

#: Bytes at the end of a log that are read for its last lines.
_TAIL = 1 << 16

_WINDOWS = os.name == "nt"


class Job:
    """A command in a process group of its own, whose output is a log file.

    Attributes:
        log: the file that has all that it prints.
        cancelled: whether `cancel` was called.
    """

    def __init__(self, command: Sequence[str], log: Path, environment: Mapping[str, str]) -> None:
        """Start it.

        Args:
            command: the program and its arguments.
            log: a file, made anew; missing folders are created.
            environment: that of the process.

        Raises:
            OSError: the log cannot be written, or the program cannot be started.
        """
        self.log, self.cancelled = log, False
        self._asked: float | None = None
        log.parent.mkdir(parents=True, exist_ok=True)
        output: IO[bytes]
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                list(command),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=dict(environment),
                start_new_session=not _WINDOWS,
                creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
            )

    @property
    def exit_code(self) -> int | None:
        """None while it runs; 0 done, 2 bad input, 3 stopped and can be resumed. Ends it in time if it is cancelled."""
        code = self._process.poll()
        if code is None and self._asked is not None:
            waited = time.monotonic() - self._asked
            if waited > sum(_PATIENCE):
                self._end(getattr(signal, "SIGKILL", signal.SIGTERM))
            elif waited > _PATIENCE[0]:
                self._end(signal.SIGTERM)
        return code

    @property
    def progress(self) -> Progress | None:
        """The last progress that it has told; None before the first."""
        told = (progress_of(line) for line in reversed(self._last_text().splitlines()))
        return next((progress for progress in told if progress is not None), None)

    @property
    def error(self) -> str:
        """What was wrong and the remedy, of a job that has failed."""
        text = self._last_text()
        lines = text.strip().splitlines()
        said = error_of(text) or (lines[-1] if lines else "nothing was printed")
        return f"{said} (tnst-mi ended with code {self._process.returncode}; all that it said is in {self.log})"

    def cancel(self) -> None:
        """Ask it to end, as Ctrl-C does: what it has got stays, and can be resumed. Does not wait."""
        if self.exit_code is None and not self.cancelled:
            self.cancelled, self._asked = True, time.monotonic()
            self._end(getattr(signal, "CTRL_BREAK_EVENT", signal.SIGINT) if _WINDOWS else signal.SIGINT)

    def wait(self) -> int:
        """Wait for its end."""
        while (code := self.exit_code) is None:
            time.sleep(0.1)
        return code

    def _end(self, with_signal: int) -> None:
        if _WINDOWS:
            self._process.send_signal(with_signal)
            return
        try:
            os.killpg(self._process.pid, with_signal)
        except ProcessLookupError:
            pass

    def _last_text(self) -> str:
        with self.log.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - _TAIL))
            return file.read().decode("utf-8", "replace").replace("\r", "\n")
