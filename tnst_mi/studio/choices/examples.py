"""What tags and channels look like, made when it is asked for: atlases of the studio, whose pictures are made once."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import make_folder
from tnst_mi.machine.terminal import one_line
from tnst_mi.network.download import file_hash
from tnst_mi.network.googlenet import LAYERS, LOGITS
from tnst_mi.network.weights import find_weights
from tnst_mi.studio.jobs.processes import NICENESS
from tnst_mi.studio.plain import excerpt, opened_plain

#: The folder of these atlases below that of the studio, and what the processes that make them say.
ATLASES, _LOG = "atlases", "atlases.log"

#: Channels that can be asked for at a time, and that wait, at most.
_MOST = 256

#: Seconds in which a process ends that is asked to.
_PATIENCE = 10.0

#: Channels of a layer by the weights of their network.
_Wanted = tuple[Path, str, list[int]]


class ExampleMaker:
    """Makes pictures of what excites channels by `tnst-mi atlas`, one layer after the other.

    Args:
        out: the folder of the studio, which need not exist.
    """

    def __init__(self, out: Path) -> None:
        self._out = out
        self._wanted: list[_Wanted] = []
        self._process: subprocess.Popen[bytes] | None = None
        self._working: threading.Thread | None = None
        self._error: str | None = None
        self._lock, self._ended = threading.Lock(), False

    def ask(self, goals: Sequence[object], tags: Sequence[str], weights: str | None) -> None:
        """Begin to make pictures of tags and channels.

        Args:
            goals: pairs of a key, "tag" or "semantic", and a value of it.
            tags: all tags of the network, in the order of its classes.
            weights: the recipe's key.

        Raises:
            InputError: something is no tag or channel, these are too many, or the weights cannot be used.
        """
        by_layer: dict[str, list[int]] = defaultdict(list)
        for goal in goals:
            layer, channel = channel_of(goal, tags)
            by_layer[layer].append(channel)
        path = find_weights(weights).path
        with self._lock:
            waiting = sum(len(channels) for _, _, channels in self._wanted)
            if waiting + len(goals) > _MOST:
                raise InputError(
                    f"studio: {waiting + len(goals)} pictures asked for, expected at most {_MOST} at a time"
                )
            self._wanted += [(path, layer, channels) for layer, channels in by_layer.items()]
            self._error = None
            if self._wanted and self._working is None and not self._ended:
                self._working = threading.Thread(target=self._work, daemon=True)
                self._working.start()

    def described(self) -> dict[str, Any]:
        """Whether pictures are being made, and what has gone wrong, as values for JSON."""
        with self._lock:
            return {"busy": self._working is not None, "error": self._error}

    def end(self) -> None:
        """Make no more pictures; those that are finished are kept."""
        with self._lock:
            self._ended, process, working = True, self._process, self._working
            self._wanted.clear()
            if process is not None:
                process.terminate()
        if working is not None:
            working.join(_PATIENCE)

    def _work(self) -> None:
        while True:
            with self._lock:
                if self._ended or not self._wanted:
                    self._working = None
                    return
                wanted = self._wanted.pop(0)
            error = self._make(*wanted)
            with self._lock:
                self._error = error or self._error

    def _make(self, weights: Path, layer: str, channels: list[int]) -> str | None:
        """Make the pictures of a layer; returns what has gone wrong."""
        log = self._out / _LOG
        try:
            flavour = find_weights(weights).flavour
            # Two networks may have one flavour.
            name = f"{flavour}-{file_hash(weights, 'sha256')[:8]}-{layer.replace('/', '-')}"
            command = [sys.executable, "-m", "tnst_mi", "atlas", "--pictures-only", "--layer", layer]
            command += ["--channels", ",".join(map(str, channels)), "--weights", str(weights)]
            command += ["--out", str(self._out / ATLASES / name)]
            make_folder(self._out / ATLASES)
            with self._lock:
                if self._ended:
                    return None
                with opened_plain(log, "wb") as opened:
                    self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=opened, stderr=opened)
                with suppress(psutil.Error):
                    psutil.Process(self._process.pid).nice(NICENESS if psutil.POSIX else None)
            code = self._process.wait()
        except (OSError, InputError) as error:
            return one_line(str(error))
        with self._lock:
            self._process = None
            if code == 0 or self._ended:
                return None
        said = excerpt(log, 4096, last=True).strip().splitlines()
        return one_line(said[-1] if said else f"the process that makes pictures has ended with code {code}")


def channel_of(goal: object, tags: Sequence[str]) -> tuple[str, int]:
    """The layer and the number of what a tag or a channel is called.

    Args:
        goal: a pair of a key, "tag" or "semantic", and a value of it.
        tags: all tags of the network, in the order of its classes.

    Raises:
        InputError: it is neither.
    """
    match goal:
        case ["tag", str(tag)] if tag in tags:
            return LOGITS, tags.index(tag)
        case ["semantic", str(name)]:
            layer, _, number = name.partition(":")
            if layer in LAYERS and number.isascii() and number.isdigit() and len(number) < 6:
                return layer, int(number)
    raise InputError(one_line(f"studio: {goal!r}: expected a tag of the network, or LAYER:CHANNEL"))
