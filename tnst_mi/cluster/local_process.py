"""What a process on this machine does before it works for a run: a terminal's Ctrl-C is for the run, which ends it."""

from __future__ import annotations

import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Called by Dask in the main thread of the process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
