"""The connections of a server: who has no token takes no room from those who have one, however slow they send."""

from __future__ import annotations

import io
import socket
import threading
import time
from contextlib import suppress
from typing import Any

#: Connections at a time: that have not been let in, that have, and of these such as stay open for events. A page keeps
#: up to six.
_STRANGERS, _CONNECTIONS, _KEPT = 16, 64, 48


class Connections:
    """Those that are open. Each has not been let in at first; the newest of these count, so that nobody is kept out."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        #: In the order in which they have come.
        self._strangers: dict[socket.socket, None] = {}
        self._admitted: set[socket.socket] = set()
        self._kept: set[socket.socket] = set()

    def begin(self, connection: socket.socket) -> None:
        """Take a new one, and end the oldest that has not been let in if there are too many of them."""
        with self._lock:
            self._strangers[connection] = None
            if len(self._strangers) <= _STRANGERS:
                return
            oldest = next(iter(self._strangers))
            del self._strangers[oldest]
            # Its thread reads the end of it, and closes it, unless it has done so by now.
            with suppress(OSError):
                oldest.shutdown(socket.SHUT_RDWR)

    def admit(self, connection: socket.socket) -> bool:
        """Let one in, unless there are too many of these; whether it is let in."""
        with self._lock:
            if connection in self._admitted:
                return True
            if connection not in self._strangers or len(self._admitted) >= _CONNECTIONS:
                return False
            del self._strangers[connection]
            self._admitted.add(connection)
            return True

    def let_in(self, connection: socket.socket) -> bool:
        """Whether one has been let in."""
        with self._lock:
            return connection in self._admitted

    def keep(self, connection: socket.socket) -> bool:
        """Let one that has been let in stay open for events, unless too many are; whether it may."""
        with self._lock:
            if len(self._kept) >= _KEPT:
                return False
            self._kept.add(connection)
            return True

    def end(self, connection: socket.socket) -> None:
        """Forget one that has ended."""
        with self._lock:
            self._strangers.pop(connection, None)
            self._admitted.discard(connection)
            self._kept.discard(connection)


class TimedReader(io.RawIOBase):
    """What a connection sends, until its time is over: a limit on each part alone would let one byte a minute through.

    Args:
        connection: which is read, and not closed.
    """

    def __init__(self, connection: socket.socket) -> None:
        super().__init__()
        self._connection, self._seconds, self._end = connection, 0.0, 0.0
        self._each = False

    def limit(self, seconds: float, each: bool = False) -> None:
        """Expect what is read from now on within some seconds, or each part of it within as many.

        Args:
            seconds: how many.
            each: whether they begin anew with each part.
        """
        self._seconds, self._end, self._each = seconds, time.monotonic() + seconds, each

    def readable(self) -> bool:
        """Always."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Read a part.

        Raises:
            TimeoutError: the time is over.
        """
        left = self._seconds if self._each else self._end - time.monotonic()
        if left <= 0:
            raise TimeoutError("timed out")
        self._connection.settimeout(left)
        return self._connection.recv_into(buffer)
