"""Finds the cameras of a stage by Pixar's library: a script, run by `usd_process` in a process of its own.

It imports nothing of the package either, whose libraries would take longer than the stage. Its only argument is a
question in JSON, its only output the answer, which `usd_process.StageAnswer` describes. A stage may crash it or fill
its memory, and whoever reads the answer must not trust it.
"""

from __future__ import annotations

import importlib
import json
import math
import os
import signal
import sys
import time
from collections.abc import Iterator
from typing import Any

if sys.platform != "win32":
    import resource

#: Frames that follow the one that is asked for are answered too, as many as this and for so many seconds.
_AHEAD, _SECONDS_AHEAD = 1000, 0.5


def main() -> None:
    """Answer the question of the command line."""
    question = json.loads(sys.argv[1])
    # Whatever the library prints is no answer.
    answer = os.fdopen(os.dup(1), "w", encoding="ascii")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    _bound(question["memory"], question["seconds"])
    # Threads reserve address space for each core, and what is asked takes one.
    os.environ["PXR_WORK_THREAD_LIMIT"] = "1"
    try:
        usd, geometry = (importlib.import_module(f"pxr.{name}") for name in ("Usd", "UsdGeom"))
    except ImportError as error:
        found = _problem("library", error)
    else:
        try:
            found = _found(usd, geometry, question["path"], question["name"], question["frame"])
        except MemoryError as error:
            found = _problem("memory", error)
        except Exception as error:  # the library's own types, and whatever its values make Python raise
            found = _problem("damage", error)
    with answer:
        json.dump(found, answer)


def _problem(kind: str, error: Exception) -> dict[str, Any]:
    try:
        reason = str(error).strip()
    except UnicodeDecodeError:  # the library quotes bytes of the file as they are
        reason = ""
    return {"problem": kind, "reason": reason[:1000] or type(error).__name__}


def _bound(memory: int, seconds: float) -> None:
    """Limit what this process may take, where the system can, also if the one that waits for the answer is gone."""
    # Ctrl-C reaches both; that one decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "win32":
        return
    signal.setitimer(signal.ITIMER_REAL, seconds)
    bounds = {resource.RLIMIT_CORE: 0}
    if sys.platform == "linux":  # other systems do not keep it
        bounds[resource.RLIMIT_AS] = memory
    for kind, most in bounds.items():
        now, _ = resource.getrlimit(kind)
        if now == resource.RLIM_INFINITY or now > most:
            resource.setrlimit(kind, (most, most))


def _found(usd: Any, geometry: Any, path: str, name: str | None, frame: float | None) -> dict[str, Any]:
    # Payloads hold geometry, which can be large.
    stage = usd.Stage.Open(path, usd.Stage.LoadNone)
    prims = {str(prim.GetPath()): prim for prim in stage.Traverse() if prim.IsA(geometry.Camera)}
    matching = [camera for camera in prims if name is None or name in (camera, camera.rpartition("/")[2])]
    found: dict[str, Any] = {"cameras": list(prims), "matching": matching}
    if len(matching) == 1:
        prim = prims[matching[0]]
        times = _time_samples(geometry, prim)
        span = (min(times), max(times)) if len(times) > 1 else None
        found |= {
            "metres": geometry.GetStageMetersPerUnit(stage),
            "up": str(geometry.GetStageUpAxis(stage)),
            "span": span,
            "samples": list(_samples(usd, geometry.Camera(prim), span, frame)),
        }
    return found


def _time_samples(geometry: Any, prim: Any) -> set[float]:
    """The time codes at which a camera, or what it is attached to, has samples."""
    times: set[float] = set()
    for attribute in prim.GetAttributes():
        times.update(attribute.GetTimeSamples())
    while prim.IsValid():
        if prim.IsA(geometry.Xformable):
            times.update(geometry.Xformable(prim).GetTimeSamples())
        prim = prim.GetParent()
    return times


def _samples(usd: Any, camera: Any, span: tuple[float, float] | None, frame: float | None) -> Iterator[dict[str, Any]]:
    """The camera at the frames from one on, the first whole one if it is None; one that never changes, once."""
    if span is None:
        yield _sample(None, camera.GetCamera(usd.TimeCode.EarliestTime()))
        return
    start = time.monotonic()
    first = math.ceil(span[0]) if frame is None else frame
    for ahead in range(_AHEAD):
        number = first + ahead
        late = time.monotonic() - start > _SECONDS_AHEAD
        if ahead > 0 and (late or number > span[1]):
            return
        yield _sample(number, camera.GetCamera(usd.TimeCode(number)))


def _sample(number: float | None, camera: Any) -> dict[str, Any]:
    return {
        "frame": number,
        "matrix": [list(row) for row in camera.transform],
        "perspective": camera.projection == type(camera).Perspective,
        "focal_length": camera.focalLength,
        "apertures": (camera.horizontalAperture, camera.verticalAperture),
        "offsets": (camera.horizontalApertureOffset, camera.verticalApertureOffset),
    }


if __name__ == "__main__":
    main()
