# A copy of processes/job.py of the Blender add-on, by scripts/build_houdini_asset.py: change that one.
"""A command that runs beside Houdini: started, watched and ended without ever waiting for it."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from .child import NO_WINDOW, variables
from .progress import InstallationReader, Progress, ProgressReader
from .pythons import any_python

__all__ = ["Job", "Progress"]

#: Runs the command, and ends it with Houdini.
_SUPERVISOR = Path(__file__).with_name("supervisor.py")

#: Bytes of the log that are read at a time, and looked at for what was wrong.
_MOST, _TAIL = 1 << 20, 1 << 14

#: How tnst-mi begins the lines that say what was wrong.
_COMPLAINT = "tnst-mi: "

#: The exit code of what signal 9 has ended.
_KILLED = 128 + 9

#: Lines of an error, at most.
_LINES = 5


class Job:
    """A program in a process group of its own, which ends with Houdini however that ends (see `supervisor`).

    Args:
        command: the program and its arguments.
        log: the file that takes all that it prints, made anew by `start`; missing folders are created.
    """

    def __init__(self, command: list[str], log: Path) -> None:
        self.command, self.log = command, log
        self.cancelled = False
        """Whether `cancel` was called."""
        self._process: subprocess.Popen[bytes] | None = None
        self._reader = self._new_reader()
        self._read, self._rest = 0, b""

    def start(self) -> None:
        """Start it.

        Raises:
            OSError: the log cannot be written, or there is no Python to start it.
        """
        self.log.parent.mkdir(parents=True, exist_ok=True)
        python = any_python()
        if python is None:
            raise FileNotFoundError(
                "Houdini has no Python of its own, and there is none on the PATH; install Python 3.11 or newer"
            )
        with self.log.open("wb") as log:
            self._process = subprocess.Popen(
                [python, "-I", _SUPERVISOR, *self.command],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=variables(Path(self.command[0])),
                # Not in Houdini's group: Ctrl-C in the terminal that Houdini was started from is not meant for this.
                start_new_session=os.name != "nt",
                creationflags=NO_WINDOW,
            )
        if self.cancelled:  # before it was started
            self.cancel()

    def poll(self) -> Progress:
        """How far it has got; never waits."""
        if self._process is not None:
            self._process.poll()
        for line in self._new_lines():
            self._reader.read(line)
        progress = self._reader.progress()
        if self.cancelled and not self.finished:
            return Progress(progress.fraction, "stopping after the current step")
        return progress

    def cancel(self) -> None:
        """Ask it to end, as Ctrl-C does; what does not end is terminated, then killed.

        It is ended within 25 s, by a process that does not depend on Houdini. This does not wait: see `finished`.
        """
        self.cancelled = True
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()

    @property
    def finished(self) -> bool:
        """Whether it was started, and no process of it is left; never waits."""
        return self.exit_code is not None

    @property
    def exit_code(self) -> int | None:
        """That of the program once it is finished: 0 done, 2 bad input, 3 stopped and can be resumed.

        It is 128 + N where signal N has ended the program, or the supervisor, with which the program ends.
        """
        code = None if self._process is None else self._process.poll()
        return code if code is None or code >= 0 else 128 - code

    @property
    def error(self) -> str | None:
        """What was wrong and the remedy, a few lines at most; None unless it has failed. Cancelled jobs have not."""
        if self.cancelled or self.exit_code in (None, 0):
            return None
        said = self._last_lines()
        complaints = list(dict.fromkeys(line for line in said if self._is_complaint(line)))
        name = Path(self.command[0]).name
        if not complaints and self.exit_code == _KILLED:
            return f"{name} was killed, as systems do when memory runs out; free some, and go on with what is done"
        lines = complaints[-_LINES:] or said[-_LINES:]
        return "\n".join(lines) or f"{name} has ended with exit code {self.exit_code} without a word"

    def _new_reader(self) -> ProgressReader | InstallationReader:
        return ProgressReader()

    def _is_complaint(self, line: str) -> bool:
        return line.startswith(_COMPLAINT)

    def _new_lines(self) -> list[str]:
        """The lines that the log has since the last time, those that are whole."""
        try:
            with self.log.open("rb") as log:
                log.seek(self._read)
                fresh = log.read(_MOST)
        except OSError:
            return []
        self._read += len(fresh)
        *whole, self._rest = (self._rest + fresh).split(b"\n")
        return [line.decode("utf-8", "replace").strip() for line in whole]

    def _last_lines(self) -> list[str]:
        try:
            with self.log.open("rb") as log:
                log.seek(max(0, log.seek(0, os.SEEK_END) - _TAIL))
                lines = log.read().decode("utf-8", "replace").splitlines()
        except OSError:
            return []
        return [line.strip() for line in lines if line.strip()]
