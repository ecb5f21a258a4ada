"""Ctrl-C deferred to a point where it does no harm, and with it the signals by which systems end programs.

An exception raised in the middle of a Dr.Jit operation surfaces as a different one, or leaves its graph half traversed.
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

#: By Ctrl-C; by `kill`, batch systems and machines that shut down; by a terminal that closes; by Ctrl-Break, which is
#: what other programs can send on Windows. Those that the system has.
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
_ENDING = tuple(getattr(signal, name) for name in _NAMES if hasattr(signal, name))


class Interrupt:
    """Whether Ctrl-C has been pressed."""

    def __init__(self) -> None:
        self.requested = False

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True


@contextlib.contextmanager
def ended_like_ctrl_c() -> Iterator[None]:
    """Within the block, what ends a program raises KeyboardInterrupt, as Ctrl-C does, unless it is ignored or handled.

    Python delivers signals to the main thread; in other threads the block changes nothing.
    """
    with _handling((signal.SIG_DFL,), signal.default_int_handler):
        yield


@contextlib.contextmanager
def deferred_interrupt() -> Iterator[Interrupt]:
    """Within the block, a first signal that would raise KeyboardInterrupt only sets `requested`; a second does so.

    Python delivers signals to the main thread; in other threads the block changes nothing.
    """
    interrupt = Interrupt()
    with _handling((signal.default_int_handler,), interrupt._handle):
        yield interrupt


@contextlib.contextmanager
def _handling(replaced: tuple[object, ...], handler: object) -> Iterator[None]:
    """Within the block, handle the ending signals whose handlers are to be replaced."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in _ENDING}
    chosen = [number for number in _ENDING if before[number] in replaced]
    try:
        for number in chosen:
            signal.signal(number, handler)  # pyright: ignore[reportArgumentType]
        yield
    finally:
        for number in chosen:
            signal.signal(number, before[number])
