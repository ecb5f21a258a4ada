"""Runs as processes of their own: begun, paused and resumed, and found again by a studio that is started later.

They are `tnst-mi stylize`, in a session of their own: neither Ctrl-C in the studio's terminal nor the studio's end
reaches them, and a crash of one is no crash of the page. A pause is what ends any run (SIGTERM), after the iteration
under way; to resume is `--resume`, to the same bits.
"""

from __future__ import annotations

import json
import math
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Self

import psutil

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import written_whole
from tnst_mi.machine.terminal import one_line
from tnst_mi.run.folder import DAMAGE, holds_run
from tnst_mi.studio.plain import excerpt, opened_plain, plain_json

#: What can be said of a run: its process is there; it has ended; the studio has paused it; it was ended by something
#: else, such as a restart of the machine or a full disk, and can be resumed; it cannot be done as it is.
RUNNING, DONE, PAUSED, INTERRUPTED, FAILED = "running", "done", "paused", "interrupted", "failed"

#: Exit code of a run that was interrupted and can be resumed.
_STOPPED = 3

#: How much less urgent tries and renders are than the page.
NICENESS = 10

#: Bytes that are read of a record, of the first and of the last words of a run.
_RECORD, _FIRST_WORDS, _LAST_WORDS = 1 << 16, 1 << 16, 1 << 12

#: How a run on a cluster says where Dask shows what it does.
_DASHBOARD = re.compile(r"\bdashboard (https?://[\w.:\[\]-]+/[\w/.-]*)")

#: The largest number of a process, and the largest other number in a record.
_LARGEST_PID, _LARGEST = 2**31 - 1, 2**53

#: Two readings of the time when a process began differ by less, in seconds.
_SAME_START = 1.0


@dataclass(frozen=True)
class WorkRecord:
    """What is known of a run beside its folder, as FOLDER.json.

    Attributes:
        source: the input.
        shape: (D, H, W) of its frames.
        start_from: the folder of the run that this one goes on from; None for the beginning.
        alone: whether it is of the frame alone that was shown, of several.
        frames: the recipe's key without that.
        cluster: the address of the cluster that does it; None for a process of this machine.
        network: the name of the network that it was begun with; None of runs of earlier versions.
        pid, began: its latest process, by its number and the time when that began; 0 before the first.
        code: exit code of that process; None while it is not known.
        paused: whether the studio has asked it to pause.
        log_begin: bytes of the log that are of earlier processes.
    """

    source: str
    shape: tuple[int, int, int]
    start_from: str | None = None
    alone: bool = False
    frames: str | None = None
    cluster: str | None = None
    network: str | None = None
    pid: int = 0
    began: float = 0.0
    code: int | None = None
    paused: bool = False
    log_begin: int = 0

    @classmethod
    def read(cls, path: Path) -> Self | None:
        """The record in a file; None if it is damaged."""
        try:
            values: Mapping[str, Any] = json.loads(excerpt(path, _RECORD))
            record = cls(**{**values, "shape": tuple(int(n) for n in values["shape"])})
        except DAMAGE:
            return None
        texts = isinstance(record.source, str) and all(
            isinstance(text, str | None) for text in (record.start_from, record.frames, record.cluster, record.network)
        )
        counts = (record.pid, record.log_begin, *record.shape)
        code = record.code is None or (isinstance(record.code, int) and abs(record.code) <= _LARGEST)
        numbers = isinstance(record.began, int | float) and math.isfinite(record.began)
        bounded = all(isinstance(count, int) and 0 <= count <= _LARGEST for count in counts)
        sound = texts and numbers and code and bounded and len(record.shape) == 3 and min(record.shape) > 0
        return record if sound and record.pid <= _LARGEST_PID else None

    def following(self, state: Path, cluster: str | None, network: str) -> WorkRecord:
        """The record of a run of the same input that goes on from a state of this one."""
        return WorkRecord(self.source, self.shape, str(state), self.alone, self.frames, cluster, network)

    def write(self, path: Path) -> None:
        """Write it."""
        with written_whole(path) as temporary:
            temporary.write_text(json.dumps(asdict(self)) + "\n", "utf-8")


class RunProcess:
    """A run in a folder, and the process that does it.

    FOLDER.toml is the recipe that was asked for, FOLDER.log what the run says, FOLDER.json its `WorkRecord`.

    Args:
        folder: of the run.
        record: what is known of it.
        require_own: checks that the folder is still the studio's, before its record is written there.

    Attributes:
        folder, record: likewise.
        trouble: why the record could not be written the last time; None if it was.
    """

    def __init__(self, folder: Path, record: WorkRecord, require_own: Callable[[], None] = lambda: None) -> None:
        self.folder, self.record, self._require_own = folder, record, require_own
        self.trouble: str | None = None
        self._seen_running = False
        self._child: subprocess.Popen[bytes] | None = None
        #: One thread may begin a run while another looks at it.
        self._beginning = threading.Lock()

    @property
    def recipe_file(self) -> Path:
        """The recipe that was asked for."""
        return self.folder.with_suffix(".toml")

    @property
    def log_file(self) -> Path:
        """What the run says."""
        return self.folder.with_suffix(".log")

    def start(self) -> None:
        """Begin the run, or resume it."""
        command = [sys.executable, "-m", "tnst_mi", "stylize", self.record.source]
        command += ["--out", str(self.folder), "--recipe", str(self.recipe_file)]
        begun = holds_run(self.folder)
        if self.record.start_from is not None and not begun:
            command += ["--from", self.record.start_from, *(["--overwrite"] if self.folder.exists() else [])]
        elif self.folder.exists():
            command.append("--resume")
        if self.record.cluster is not None:
            command += ["--cluster", self.record.cluster]
        with self._beginning:
            self._begin(command)

    def _begin(self, command: list[str]) -> None:
        with opened_plain(self.log_file, "ab") as log:
            # Before it begins: were this process to end here, the run could be resumed.
            self._note(pid=0, began=0.0, code=None, paused=False, log_begin=log.tell())
            if self.trouble is not None:
                raise InputError(f"studio: {self.trouble}; mend that")
            self._child = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
            )
        began = 0.0
        with suppress(psutil.Error):
            process = psutil.Process(self._child.pid)
            began = process.create_time()
            if psutil.POSIX:
                process.nice(NICENESS)
        self._note(pid=self._child.pid, began=began)

    def pause(self) -> None:
        """Ask the run to end after the iteration under way."""
        if (process := self._process()) is not None:
            self._note(paused=True)
            with suppress(psutil.Error):
                process.terminate()

    def kill(self) -> None:
        """End the process and those that it has begun, at once."""
        if (process := self._process()) is not None:
            with suppress(psutil.Error):
                for one in (*process.children(recursive=True), process):
                    with suppress(psutil.NoSuchProcess):
                        one.kill()

    def wait(self, seconds: float) -> None:
        """Wait until the process has ended, but no longer than some seconds."""
        with suppress(psutil.TimeoutExpired, subprocess.TimeoutExpired):
            if self._child is not None:
                self._child.wait(seconds)
            elif (process := self._process()) is not None:
                process.wait(seconds)

    def status(self) -> str:
        """What can be said of the run now."""
        with self._beginning:
            if self.trouble is not None:
                self._note()  # what could not be written may be possible by now
            if self._runs():
                self._seen_running = True
                return RUNNING
        if self._recorded_status() == DONE:
            return DONE
        if self.record.paused:
            return PAUSED
        code = self.record.code
        return FAILED if code is not None and code > 0 and code != _STOPPED else INTERRUPTED

    def _runs(self) -> bool:
        """Whether the process is still there; its exit code is noted once it is not, if it is our child."""
        if self._child is None or self.record.code is not None:
            return self._process() is not None
        if (code := self._child.poll()) is not None:
            self._note(code=code)
        return code is None

    def ending(self) -> str:
        """Why a run that is not done has ended: its exit code, or what is known of it, and its last line."""
        code = self.record.code
        if code is None:
            # Of a process that an earlier studio has begun the code is not known.
            seen = "ended; its exit code is not known"
            how = seen if self._seen_running else "ended while no studio looked on, as when the machine was restarted"
        elif code < 0:
            how = f"killed by {_signal_name(-code)}"
        else:
            how = f"exit code {code}"
        lines = excerpt(self.log_file, _LAST_WORDS, self.record.log_begin, last=True).strip().splitlines()
        return f"{how}: {lines[-1] if lines else 'without a word'}"

    def dashboard(self) -> str | None:
        """The URL under which Dask shows what a run on a cluster does, as the run has said; None if it has not."""
        if self.record.cluster is None:
            return None
        found = _DASHBOARD.search(excerpt(self.log_file, _FIRST_WORDS, self.record.log_begin))
        return None if found is None else found[1]

    def _process(self) -> psutil.Process | None:
        """The process, if it is still there."""
        if not self.record.pid or self.record.code is not None:
            return None
        with suppress(psutil.Error):
            process = psutil.Process(self.record.pid)
            # Another process may have its number by now.
            same = abs(process.create_time() - self.record.began) < _SAME_START
            return process if same and process.status() != psutil.STATUS_ZOMBIE else None
        return None

    def _recorded_status(self) -> str | None:
        try:
            return str(plain_json(self.folder / "run.json")["status"])
        except DAMAGE:
            return None

    def _note(self, **changes: Any) -> None:
        """Change the record, and write it; what keeps it from being written is `trouble`, and does not end the run."""
        self.record = replace(self.record, **changes)
        file = self.folder.with_suffix(".json")
        try:
            self._require_own()
            self.record.write(file)
            self.trouble = None
        except InputError as error:
            self.trouble = str(error).removeprefix("studio: ")
        except OSError as error:
            self.trouble = one_line(f"{file} cannot be written ({error.strerror or error})")


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
