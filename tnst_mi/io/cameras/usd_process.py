"""Asks Pixar's library about a stage in a process of its own, with bounds on its time, its memory and its answer.

The library is not made for hostile files: some crash it, hang it, or make it fill the memory. That costs the process
alone, and the file is refused in one line.
"""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.machine import address_space
from tnst_mi.machine.terminal import amount, shortened

_WORKER = Path(__file__).with_name("usd_worker.py")

#: Seconds for an answer; bytes of address space, of which libraries take one gigabyte, and more for each byte of the
#: stage, as text takes; longest answer in bytes.
_SECONDS, _MEMORY, _MEMORY_PER_BYTE, _LONGEST = 60.0, 4_000_000_000, 3, 1 << 22


@dataclass(frozen=True, eq=False)
class StageSample:
    """A camera of a stage at one time, in USD's terms.

    Attributes:
        matrix: (4, 4), from the camera to the scene, applied to columns.
        perspective: whether it is a perspective camera; otherwise an orthographic one.
        focal_length: of the lens, in the unit of the apertures.
        apertures: width and height of the film, in tenths of the scene's unit, or any unit of a perspective camera.
        offsets: of the film's middle from the line that the camera looks along, to the right and up, in that unit.
    """

    matrix: np.ndarray
    perspective: bool
    focal_length: float
    apertures: tuple[float, float]
    offsets: tuple[float, float]


@dataclass(frozen=True, eq=False)
class StageAnswer:
    """What is in a stage.

    Attributes:
        cameras: the paths of all cameras.
        matching: of those that have the name that was asked for.
        camera: the camera, if one matches.
    """

    cameras: list[str]
    matching: list[str]
    camera: StageCamera | None


@dataclass(frozen=True, eq=False)
class StageCamera:
    """The only camera that matches a name.

    Attributes:
        metres: length of the scene's unit.
        up: the axis that is up, such as "Y".
        span: the first and the last frame at which something about it is said, or None if it never changes.
        samples: the camera by frames: the one that was asked for, or the first of the span, and some that follow at
            whole distances; by None if it never changes.
    """

    metres: float
    up: str
    span: tuple[float, float] | None
    samples: dict[float | None, StageSample]


def ask(path: Path, name: str | None, frame: float | None) -> StageAnswer:
    """Open a stage, and find its cameras.

    Args:
        path: the file.
        name: the path of the camera's prim, or the prim's name; None for any.
        frame: where the samples begin; None for the first whole frame of the camera's own.

    Raises:
        InputError: USD is not installed, or the stage takes too much time or memory, crashes the library, or makes it
            answer nonsense.
        ValueError: it is damaged.
    """
    if importlib.util.find_spec("pxr") is None:
        raise InputError(f"{path}: cameras in USD need Pixar's library: pip install 'tnst_mi[usd]' (or usd-core)")
    memory = _MEMORY + _MEMORY_PER_BYTE * path.stat().st_size
    if (most := address_space.limit()) is not None:  # of this process, and so of the one that it starts
        memory = min(memory, most)
    question = {"path": str(path), "name": name, "frame": frame, "memory": memory, "seconds": _SECONDS}
    started = time.monotonic()
    code, answer = _run(path, json.dumps(question))
    if time.monotonic() - started >= _SECONDS:
        raise InputError(f"{path}: Pixar's library took more than {_SECONDS:g} s to read it; export the camera alone")
    if code != 0 and len(answer) <= _LONGEST:
        raise InputError(
            f"{path}: crashes Pixar's library ({_end(code)}); it is damaged, or takes more than {amount(memory)}: save "
            "or copy it again, or export the camera alone"
        )
    try:
        if len(answer) > _LONGEST:
            raise ValueError
        values = json.loads(answer)
        if "problem" not in values:
            return _checked(values)
        problem, reason = values["problem"], shortened(str(values["reason"]), 200)
    except (ValueError, TypeError, LookupError, OverflowError, RecursionError):
        raise InputError(f"{path}: makes Pixar's library answer nonsense; save it again, or copy it again") from None
    if problem == "library":
        raise InputError(
            f"{path}: Pixar's library cannot be imported ({reason}); install it again: "
            "pip install --force-reinstall usd-core"
        )
    if problem == "memory":
        raise InputError(f"{path}: takes more than {amount(memory)} to read; export the camera alone")
    raise ValueError(reason)


def _run(path: Path, question: str) -> tuple[int, bytes]:
    """The worker's exit code and its answer, no more of it than tells that it is too long."""
    # What the library is imported from here, it is imported from there.
    found_in = os.pathsep.join(str(folder) or os.getcwd() for folder in sys.path)
    # Without -P, its own folder would be first among these.
    command = [sys.executable or "", "-P", str(_WORKER), question]
    try:
        process = subprocess.Popen(
            command,
            env=os.environ | {"PYTHONPATH": found_in},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
    except OSError as error:
        raise InputError(
            f"{path}: USD is read by another Python, which cannot be started (sys.executable = {sys.executable!r}: "
            f"{error.strerror})"
        ) from error
    with process:
        assert process.stdout is not None
        late = threading.Timer(_SECONDS, process.kill)
        late.daemon = True
        late.start()
        try:
            answer = process.stdout.read(_LONGEST + 1)
            if len(answer) > _LONGEST:
                process.kill()
            return process.wait(), answer
        finally:  # also after Ctrl-C
            late.cancel()
            process.kill()


def _end(code: int) -> str:
    """How a process ended, by its exit code."""
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"exit code {code}"


def _checked(values: dict[str, Any]) -> StageAnswer:
    """An answer as it should be; any exception means that it is not."""
    cameras, matching = ([str(name) for name in values[key]] for key in ("cameras", "matching"))
    if len(matching) != 1:
        return StageAnswer(cameras, matching, None)
    span = None if values["span"] is None else _pair(values["span"])
    samples = {sample["frame"]: _sample(sample) for sample in values["samples"]}
    camera = StageCamera(float(values["metres"]), str(values["up"]), span, samples)
    return StageAnswer(cameras, matching, camera)


def _sample(values: dict[str, Any]) -> StageSample:
    return StageSample(
        # USD's matrices are applied to rows.
        np.array(values["matrix"], np.float64).reshape(4, 4).T,
        bool(values["perspective"]),
        float(values["focal_length"]),
        _pair(values["apertures"]),
        _pair(values["offsets"]),
    )


def _pair(values: Any) -> tuple[float, float]:
    first, second = map(float, values)
    return first, second
