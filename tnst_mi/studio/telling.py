"""What tabs are told, whenever something has changed, as the JSON that browsers read.

It has no infinite numbers and none that are not a number.
"""

from __future__ import annotations

import json
import math
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from tnst_mi.machine.terminal import one_line

#: Seconds after which a connection without news is told that it is still one.
_STILL_HERE = 15.0


class News:
    """Tells tabs of changes.

    Attributes:
        lock: held while what is told of is read or changed.
        version: counts the changes.
    """

    def __init__(self) -> None:
        self.lock = threading.Condition()
        self.version, self._ended = 0, False

    def changed(self) -> None:
        """Something has changed."""
        with self.lock:
            self.version += 1
            self.lock.notify_all()

    def end(self) -> None:
        """End all `told`."""
        with self.lock:
            self._ended = True
            self.lock.notify_all()

    def told(self, state: Callable[[], Any]) -> Iterator[str]:
        """A state as JSON, now and whenever something has changed; empty texts while nothing changes.

        What keeps it from being told is printed: tabs hear of the next change all the same.
        """
        known = -1
        while not self._ended:
            with self.lock:
                self.lock.wait_for(lambda known=known: self.version != known or self._ended, _STILL_HERE)
                changed, known = self.version != known, self.version
            try:
                text = json_text(state()) if changed else ""
            except Exception as error:
                print(one_line(f"tnst-mi: studio: {type(error).__name__}: {error}"), file=sys.stderr)
                text = ""
            yield text


def json_text(values: Any) -> str:
    """Values as JSON; null in place of numbers that it does not have, which damaged files may hold."""
    try:
        return json.dumps(values, allow_nan=False)
    except ValueError:
        return json.dumps(_finite(values), allow_nan=False)


def _finite(values: Any) -> Any:
    if isinstance(values, float):
        return values if math.isfinite(values) else None
    if isinstance(values, Mapping):
        return {str(name): _finite(value) for name, value in values.items()}
    if isinstance(values, list | tuple):
        return [_finite(value) for value in values]
    return values
