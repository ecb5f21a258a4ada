"""One read of a damaged file: what it raised, how long it took, and how much memory."""

from __future__ import annotations

import contextlib
import io
import os
import resource
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from fuzzing.readers import READERS
from tnst_mi.errors import InputError, StoppedError, UnforeseenError

#: Bounds of a read: characters of its message, seconds of processor time, bytes of memory.
LONGEST_MESSAGE, LONGEST_TIME, MOST_MEMORY = 300, 2.0, 500_000_000

#: Characters of a line that is printed of a file.
LONGEST_LINE = 1000

_STATUS, _PEAK_RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


@dataclass(frozen=True)
class Trial:
    """What came of a read.

    Attributes:
        faults: what is wrong with it, by kind ("exception", "message", "time", "memory", …), in words.
        refused: whether the file was refused, as it should be if it is damaged.
        seconds: of processor time.
        memory: bytes at the peak, beyond what the process had before.
        where: the innermost places of an exception that no reader should raise.
    """

    faults: dict[str, str]
    refused: bool = False
    seconds: float = 0.0
    memory: int = 0
    where: str = ""


@dataclass
class Tally:
    """What came of the inputs of one reader."""

    inputs: int = 0
    refused: int = 0
    slowest: float = 0.0
    largest: int = 0
    faults: Counter[str] = field(default_factory=Counter)

    def add(self, found: Trial) -> None:
        """Count one."""
        self.inputs, self.refused = self.inputs + 1, self.refused + found.refused
        self.slowest, self.largest = max(self.slowest, found.seconds), max(self.largest, found.memory)
        self.faults.update(found.faults.keys())

    def line(self, name: str) -> str:
        """All of it in one line."""
        faults = ", ".join(f"{count} × {kind}" for kind, count in sorted(self.faults.items())) or "no fault"
        return (
            f"{name}: {self.inputs} inputs, {self.refused} refused, at most {self.slowest:.2f} s and "
            f"{self.largest / 1e6:.0f} MB; {faults}"
        )


def save(path: Path, content: bytes, found: Trial) -> None:
    """Keep an input with a fault, and what that is."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    words = "".join(f"{kind}: {text}\n" for kind, text in found.faults.items())
    path.with_name(f"{path.name}.txt").write_text(words + found.where, "utf-8", errors="replace")


def trial(name: str, content: bytes, folder: Path) -> Trial:
    """Read a damaged file by the reader of a name, in a folder that it has to itself."""
    faults: dict[str, str] = {}
    refused, where, shown = False, "", io.StringIO()
    before, started = _memory(reset=True), time.process_time()
    try:
        with contextlib.redirect_stdout(shown), contextlib.redirect_stderr(shown), _printed(faults):
            READERS[name].read_damaged(content, folder)
    except UnforeseenError as error:
        faults["unforeseen"] = str(error)
    except (InputError, StoppedError) as error:
        refused = True
        faults |= _faults_of_message(str(error))
    except Exception as error:
        faults["exception"] = f"{type(error).__name__}: {error}"[:LONGEST_MESSAGE]
        where = "".join(traceback.format_tb(error.__traceback__)[-3:])
    seconds, memory = time.process_time() - started, max(0, _memory(reset=False) - before)
    for line in shown.getvalue().splitlines():
        if len(line) > LONGEST_LINE or not line.isprintable():
            faults["output"] = f"a line of {len(line)} characters: {line!r}"[:LONGEST_MESSAGE]
    if seconds > LONGEST_TIME:
        faults["time"] = f"{seconds:.1f} s"
    if memory > MOST_MEMORY:
        faults["memory"] = f"{memory / 1e9:.1f} GB"
    return Trial(faults, refused, seconds, memory, where)


def limit_memory(beyond: int) -> None:
    """Make allocations fail that exceed what the process has now by more than some bytes (Linux)."""
    if sys.platform == "linux":
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
        most = pages * resource.getpagesize() + beyond
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


@contextlib.contextmanager
def _printed(faults: dict[str, str]) -> Iterator[None]:
    """Note it as a fault if libraries that are not written in Python print anything."""
    with tempfile.TemporaryFile() as file:
        kept = [(stream, os.dup(stream)) for stream in (1, 2)]
        for stream, _ in kept:
            os.dup2(file.fileno(), stream)
        try:
            yield
        finally:
            for stream, copy in kept:
                os.dup2(copy, stream)
                os.close(copy)
            file.seek(0)
            if text := file.read(LONGEST_MESSAGE):
                faults["output"] = repr(text)


def _faults_of_message(message: str) -> dict[str, str]:
    if len(message) > LONGEST_MESSAGE:
        return {"message": f"{len(message)} characters: {message[:100]!r} … {message[-100:]!r}"}
    if not message.isprintable():
        return {"message": f"control characters: {message!r}"}
    return {}


def _memory(reset: bool) -> int:
    """The process's largest resident size in bytes since the last reset; since its start where none is possible."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            if reset:
                _PEAK_RESET.write_text("5", "ascii")
            (line,) = (line for line in _STATUS.read_text("ascii").splitlines() if line.startswith("VmHWM"))
            return int(line.split()[1]) << 10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << (0 if sys.platform == "darwin" else 10)
