"""Progress on stderr: a bar on a terminal; elsewhere, as in logs, plain lines that are few."""

from __future__ import annotations

import math
import os
import sys
import time
from typing import Any

from tqdm import tqdm

from tnst_mi.errors import InputError

#: Elsewhere than on a terminal: the share of the work or the seconds after which there is another line, and the least
#: seconds between two, so that short work does not fill a log.
_SHARE, _SECONDS, _LEAST = 0.1, 30.0, 1.0

#: Takes the place of these seconds where a program follows the log, such as an add-on that shows progress of its own.
VARIABLE = "TNST_MI_PROGRESS_SECONDS"

#: Without a format of its own, a line of work whose end is known; the bar is left out of lines.
_FORMAT = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}, {rate_fmt}{postfix}]"


class SteadyProgress(tqdm):
    """tqdm by a clock that nobody sets back: by the wall clock, it would then show negative times, or nothing."""

    @property
    def _time(self) -> Any:
        return time.monotonic

    @_time.setter
    def _time(self, clock: Any) -> None:
        """The wall clock, which tqdm puts here, is not kept."""


class PlainProgress(SteadyProgress):
    """tqdm for streams that are no terminals: lines after each tenth of the work or some seconds, and at its end.

    Args:
        arguments: of `tqdm`.
        seconds: after which there is another line.
        keywords: of `tqdm`.

    Example:
        >>> import io
        >>> log = io.StringIO()
        >>> for _ in PlainProgress(range(3), "reading", file=log):
        ...     pass
        >>> log.getvalue().count("\\n"), "\\r" in log.getvalue(), "reading: 100%" in log.getvalue()
        (1, False, True)
    """

    def __init__(self, *arguments: Any, seconds: float = _SECONDS, **keywords: Any) -> None:
        self._written: tuple[float, float] | None = None
        self._seconds = seconds
        # It is asked at each step whether a line is due.
        super().__init__(*arguments, **(keywords | {"dynamic_ncols": False, "mininterval": 0, "miniters": 1}))

    def display(self, msg: str | None = None, pos: int | None = None) -> bool:
        """Write a line if one is due."""
        now = time.monotonic()
        if self._written is None:
            self._written = now, self.n
        seconds, steps = now - self._written[0], self.n - self._written[1]
        done = self.total is not None and self.n >= self.total
        tenth = self.total is not None and steps >= _SHARE * self.total
        due = done or seconds >= self._seconds or (tenth and seconds >= _LEAST)
        if msg is not None or steps == 0 or not due:
            return False
        self._written = now, self.n
        print(self._line(), file=self.fp, flush=True)
        return True

    def _line(self) -> str:
        """What tqdm shows, without the bar, which says no more than the percentage."""
        if self.total is None:
            return str(self).strip()
        line = (self.bar_format or _FORMAT).replace("|{bar}|", "")
        # tqdm's set_description adds the colon that the format has.
        prefix = self.desc.removesuffix(": ")
        if not prefix:
            line = line.replace("{desc}: ", "")
        return self.format_meter(**{**self.format_dict, "prefix": prefix, "ncols": None, "bar_format": line}).strip()

    def clear(self, *_: Any, **__: Any) -> None:
        """Other lines need no room."""

    def close(self) -> None:
        """End it, with a line for what was done since the last."""
        if not self.disable and self._written is not None and self._written[1] < self.n:
            print(self._line(), file=self.fp, flush=True)
            self._written = time.monotonic(), self.n
        self.leave = False
        super().close()


def progress_bar(*arguments: Any, **keywords: Any) -> tqdm:
    """tqdm's progress bar on stderr, or plain lines where that is no terminal; arguments are those of `tqdm.tqdm`.

    Raises:
        InputError: $TNST_MI_PROGRESS_SECONDS is no number of seconds, and there is no terminal.
    """
    keywords = {"file": sys.stderr, "dynamic_ncols": True} | keywords
    if sys.stderr is not None and sys.stderr.isatty():
        return SteadyProgress(*arguments, **keywords)
    return PlainProgress(*arguments, seconds=_line_seconds(), **keywords)


def _line_seconds() -> float:
    """The seconds after which there is another line.

    Raises:
        InputError: the environment has a value that is none.
    """
    text = os.environ.get(VARIABLE)
    try:
        seconds = _SECONDS if text is None else float(text)
    except ValueError:
        seconds = math.nan
    if not seconds > 0:
        raise InputError(f"${VARIABLE} = {text!r}: expected seconds above 0, such as 1")
    return seconds
