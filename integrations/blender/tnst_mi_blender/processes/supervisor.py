"""Runs a command in a process group of its own, and ends all of it once stdin ends.

    python supervisor.py COMMAND...

Whoever started this holds the other end of stdin. To close it is to ask for the end; if Blender crashes or is killed,
the system closes it. On Windows it also gives the command a console, without which no Ctrl-Break reaches it. The
command makes way for other programs, of which Blender is one.

The exit code is that of the command, 128 + N if signal N has ended it, 127 if it cannot be started.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress

#: Seconds that the command has after each request. The first is long enough for a step of large frames: tnst-mi ends
#: after it, and keeps what it has.
PATIENCE = 20.0, 5.0

#: How far the command stands back where systems count that: those of POSIX from 0 to 19.
NICENESS = 10


def main(command: list[str]) -> int:
    """Run the command to its end."""
    # Who starts Blender in the background of a script lets it ignore Ctrl-C, which its children would inherit.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    asked, over = threading.Event(), threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: asked.set())
    try:
        child = _started(command)
    except OSError as error:
        print(f"tnst-mi: cannot start {command[0]}: {error.strerror}", file=sys.stderr)
        return 127
    threading.Thread(target=_wait_for_stdin, args=(asked,), daemon=True).start()
    threading.Thread(target=_end, args=(child, asked, over), daemon=True).start()
    code = child.wait()
    over.set()
    _kill(child)
    return code if code >= 0 else 128 - code


def _started(command: list[str]) -> subprocess.Popen[bytes]:
    if sys.platform == "win32":
        flags = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.BELOW_NORMAL_PRIORITY_CLASS
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, creationflags=flags)
    os.nice(NICENESS)  # this process does, and what it starts with it
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)


def _wait_for_stdin(asked: threading.Event) -> None:
    # Not sys.stdin, whose lock a thread must not hold when Python ends.
    with suppress(OSError):
        while os.read(0, 4096):
            pass
    asked.set()


def _end(child: subprocess.Popen[bytes], asked: threading.Event, over: threading.Event) -> None:
    """End the command once that is asked for: politely, firmly, by force."""
    asked.wait()
    steps: tuple[Callable[[subprocess.Popen[bytes]], None], ...] = (_interrupt, _terminate)
    for step, patience in zip(steps, PATIENCE, strict=True):
        if over.is_set():
            return
        step(child)
        if over.wait(patience):
            return
    _kill(child)


def _interrupt(child: subprocess.Popen[bytes]) -> None:
    if sys.platform == "win32":
        with suppress(OSError):
            child.send_signal(signal.CTRL_BREAK_EVENT)
    else:
        _signal_group(child, signal.SIGINT)


def _terminate(child: subprocess.Popen[bytes]) -> None:
    if sys.platform == "win32":
        child.terminate()
    else:
        _signal_group(child, signal.SIGTERM)


def _kill(child: subprocess.Popen[bytes]) -> None:
    """Kill the command, and whatever is left of what it has started."""
    if sys.platform == "win32":
        subprocess.run(["taskkill", "/T", "/F", "/PID", str(child.pid)], capture_output=True, check=False)
    else:
        _signal_group(child, signal.SIGKILL)


def _signal_group(child: subprocess.Popen[bytes], number: int) -> None:
    # The group has the number of the child, and outlives it as long as there is something in it.
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(child.pid, number)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
