"""A command that runs beside Blender: started, watched and ended without ever waiting for it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Progress:
    """How far a job has got.

    Attributes:
        fraction: of its work, 0 to 1; None while that is not known.
        text: one short line for a status bar, such as "octave 2/3, frame 12, 40%, 1:20 left".
    """

    fraction: float | None
    text: str


class Job:
    """A program in a process group of its own, which ends with Blender however that ends.

    Args:
        command: the program and its arguments.
        log: the file that takes all that it prints, made anew by `start`; missing folders are created.
    """

    def __init__(self, command: list[str], log: Path) -> None:
        self.command, self.log = command, log

    def start(self) -> None:
        """Start it.

        Raises:
            OSError: the log cannot be written, or the program cannot be started.
        """
        raise NotImplementedError

    def poll(self) -> Progress:
        """How far it has got; never waits."""
        raise NotImplementedError

    def cancel(self) -> None:
        """Ask it to end, as Ctrl-C does; what does not end is terminated, then killed. Does not wait: see `finished`."""
        raise NotImplementedError

    @property
    def cancelled(self) -> bool:
        """Whether `cancel` was called."""
        raise NotImplementedError

    @property
    def finished(self) -> bool:
        """Whether no process of it is left; never waits."""
        raise NotImplementedError

    @property
    def exit_code(self) -> int | None:
        """That of the program once it is finished: 0 done, 2 bad input, 3 stopped and can be resumed."""
        raise NotImplementedError

    @property
    def error(self) -> str | None:
        """What was wrong and the remedy, as one line; None unless it has failed (a cancelled job has not)."""
        raise NotImplementedError
