"""Runs a command in a process group of its own, and ends all of it once stdin ends.

    python supervisor.py COMMAND...

Whoever started this holds the other end of stdin. To close it is to ask for the end; if Blender crashes or is killed,
the system closes it. On Windows it also gives the command a console, without which no Ctrl-Break reaches it. The
command makes way for other programs, of which Blender is one.

Should this process itself be killed, as by a system without memory, a second one that waits for nothing else kills the
command and what it has started. Windows has no such process.

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
from dataclasses import dataclass

#: Seconds that the command has after each request. The first is long enough for a step of large frames: tnst-mi ends
#: after it, and keeps what it has.
PATIENCE = 20.0, 5.0

#: How far the command stands back where systems count that: those of POSIX from 0 to 19.
NICENESS = 10


def main(command: list[str]) -> int:
    """Run the command to its end."""
    guard = None if sys.platform == "win32" else _guarded()  # first of all: threads are not forked with a process
    # Who starts Blender in the background of a script lets it ignore Ctrl-C, which its children would inherit.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    asked, over = threading.Event(), threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: asked.set())
    try:
        child = _started(command)
    except OSError as error:
        print(f"tnst-mi: cannot start {command[0]}: {error.strerror}", file=sys.stderr)
        if guard is not None:
            guard.dismiss()
        return 127
    if guard is not None:
        guard.watch(child)
    threading.Thread(target=_wait_for_stdin, args=(asked,), daemon=True).start()
    threading.Thread(target=_end, args=(child, asked, over), daemon=True).start()
    code = child.wait()
    over.set()
    _kill(child)
    if guard is not None:
        guard.dismiss()  # once there is nothing left: the number of the group may soon be another's
    return code if code >= 0 else 128 - code


@dataclass(frozen=True)
class _Guard:
    """The process that outlives this one if it is killed: it holds one end of a pipe, whose other end goes with us."""

    pid: int
    pipe: int

    def watch(self, child: subprocess.Popen[bytes]) -> None:
        """Tell it the group that is to be killed."""
        with suppress(OSError):  # somebody has killed it
            os.write(self.pipe, str(child.pid).encode())

    def dismiss(self) -> None:
        """End it, without a look at the group."""
        with suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)
        os.waitpid(self.pid, 0)


def _guarded() -> _Guard:
    """Start the guard: a copy of this process, which needs no Python to be found and started."""
    ours, pipe = os.pipe()
    pid = os.fork()
    if pid:
        os.close(ours)
        return _Guard(pid, pipe)
    try:
        os.setsid()  # what is meant for the group of the supervisor is not for it
        os.close(pipe)
        nothing = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(nothing, stream)
        group = b""
        while part := os.read(ours, 64):
            group += part
        if group:
            _signal_group(int(group), signal.SIGKILL)
    finally:
        os._exit(0)


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
        # One that fails is followed by the next: Ctrl-Break may raise SystemError (CPython 112190).
        with suppress(Exception):
            step(child)
        if over.wait(patience):
            return
    _kill(child)


def _interrupt(child: subprocess.Popen[bytes]) -> None:
    if sys.platform == "win32":
        child.send_signal(signal.CTRL_BREAK_EVENT)
    else:
        _signal_group(child.pid, signal.SIGINT)


def _terminate(child: subprocess.Popen[bytes]) -> None:
    if sys.platform == "win32":
        child.terminate()
    else:
        _signal_group(child.pid, signal.SIGTERM)


def _kill(child: subprocess.Popen[bytes]) -> None:
    """Kill the command, and whatever is left of what it has started."""
    if sys.platform == "win32":
        subprocess.run(["taskkill", "/T", "/F", "/PID", str(child.pid)], capture_output=True, check=False)
    else:
        _signal_group(child.pid, signal.SIGKILL)


def _signal_group(group: int, number: int) -> None:
    # It has the number of the child that began it, and outlives it as long as there is something in it.
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
