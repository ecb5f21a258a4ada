"""Faults at the writes of a run: the n-th one fails, or the process dies there.

Everything that is written passes through `tnst_mi.io.atomic`: a file gets its name, or a line is added to a log. Both
are replaced here by ones that count.
"""

from __future__ import annotations

import json
import os
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from moving_smoke import moving_smoke

from tnst_mi.cli import main
from tnst_mi.io import atomic, save_frames

#: What differs between two runs of the same bits: times, memory, and when and where they ran.
_OF_THE_OCCASION = ("started", "seconds", "peak_memory_bytes", "timings", "input", "log")


class Writes:
    """Counts the writes, and lets one of them fail.

    Args:
        fails: number of the write that fails, from 1; 0 for none.
        error: the number of the system's error with which it does.
        seen: called with the number of each write before it, and once more after it.
    """

    def __init__(self, fails: int = 0, error: int = 0, seen: Callable[[int, str], object] | None = None) -> None:
        self._fails, self._error, self._seen = fails, error, seen
        self._order = threading.Lock()
        self.names: list[str] = []

    @contextmanager
    def counted(self) -> Iterator[Writes]:
        """Count within the block."""
        publish, add = atomic._publish, atomic._add

        def counting_publish(temporary: Path, path: Path, durable: bool) -> None:
            def half() -> None:
                os.truncate(temporary, temporary.stat().st_size // 2)

            self._write(path, lambda: publish(temporary, path, durable), half)

        def counting_add(path: Path, text: str) -> None:
            self._write(path, lambda: add(path, text), lambda: add(path, text[: len(text) // 2]))

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(atomic, "_publish", counting_publish)
            patch.setattr(atomic, "_add", counting_add)
            yield self

    def _write(self, path: Path, write: Callable[[], None], write_half: Callable[[], None]) -> None:
        # One at a time, so that what is seen between two writes is what a killed process would leave.
        with self._order:
            self.names.append(path.name)
            number = len(self.names)
            if self._seen is not None:
                self._seen(number, "before")
            if number == self._fails:
                write_half()
                raise OSError(self._error, os.strerror(self._error))
            write()
            if self._seen is not None:
                self._seen(number, "after")


@contextmanager
def plain_pictures() -> Iterator[None]:
    """Plots and videos that take no time, written where the real ones are."""

    class Video:
        def __init__(self, path: Path, frames_per_second: float) -> None:
            self._writing = atomic.written_whole(path)

        def __enter__(self) -> Video:
            self._file = self._writing.__enter__()
            self._file.write_bytes(b"")
            return self

        def __exit__(self, *failure: Any) -> bool | None:
            return self._writing.__exit__(*failure)

        def add(self, image: Any) -> None:
            with self._file.open("ab") as file:
                file.write(image.tobytes())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FigureCanvasAgg, "print_png", lambda canvas, path: Path(path).write_bytes(b"a plot"))
        patch.setattr("tnst_mi.run.report.open_video", Video)
        yield


@pytest.fixture(autouse=True)
def quick() -> Iterator[None]:
    """Runs whose plots and videos take no time."""
    with plain_pictures():
        yield


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory, tiny_weights: Path) -> list[str]:
    """The arguments of a run, but for its folder: two frames, a window of 3, two octaves of one iteration."""
    folder = tmp_path_factory.mktemp("input")
    save_frames(folder / "smoke", moving_smoke(2))
    goal = ["--semantic", "inception_3a/3x3:2", "--octaves", "2", "--iterations", "1", "--views", "1"]
    kept = ["--window", "3", "--coherence", "1", "--lam", "0.5", "--weights", str(tiny_weights)]
    return ["stylize", str(folder / "smoke"), *goal, *kept, "--out"]


@dataclass(frozen=True)
class Undisturbed:
    """A run that nothing disturbed.

    Attributes:
        results: see `results`.
        names: of the files that it wrote, in their order.
        left: a folder with what a process would have left that died at a write, as NUMBER-before and NUMBER-after.
    """

    results: dict[str, Any]
    names: list[str]
    left: Path


def copied(folder: Path, to: Path) -> None:
    """Copy a folder in which another thread writes pictures, and removes them: what goes meanwhile is left out."""
    for _ in range(20):
        with suppress(shutil.Error):
            shutil.copytree(folder, to)
            return
        shutil.rmtree(to)
    raise AssertionError(f"{folder} never stays")


@pytest.fixture(scope="module")
def undisturbed(begun: list[str], tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    """The run of `begun`."""
    folder = tmp_path_factory.mktemp("undisturbed")
    out, left = folder / "out", folder / "left"
    writes = Writes(seen=lambda number, when: copied(out, left / f"{number}-{when}"))
    with plain_pictures(), writes.counted():
        assert main([*begun, str(out)]) == 0
    return Undisturbed(results(out), writes.names, left)


def results(out: Path) -> dict[str, Any]:
    """Everything in the folder of a finished run, bit by bit, but for what belongs to the occasion."""
    found: dict[str, Any] = {}
    for path in sorted(out.rglob("*")):
        if not path.is_file():
            continue
        name = str(path.relative_to(out))
        if name == "run.json":
            found[name] = _without_occasion(json.loads(path.read_text("utf-8")))
        elif name == "metrics.jsonl":
            found[name] = [_without_occasion(json.loads(line)) for line in path.read_text("utf-8").splitlines()]
        else:
            found[name] = path.read_bytes()
    return found


def unfinished(out: Path) -> list[str]:
    """Files that are there under their own names and are not whole: none, whatever happened."""
    bad = []
    for path in sorted(out.rglob("*")):
        if path.suffix == ".json" and not path.name.startswith("."):
            try:
                json.loads(path.read_text("utf-8"))
            except ValueError:
                bad.append(path.name)
    return bad


def _without_occasion(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_occasion(item) for key, item in value.items() if key not in _OF_THE_OCCASION}
    if isinstance(value, list):
        return [_without_occasion(item) for item in value]
    return value
