"""The SOP `tnst_mi::stylize` inside Houdini: what its buttons do, and what it shows.

Houdini waits while the input is written, which Escape interrupts. tnst-mi then runs beside it: the status line shows
how far it has got, and the node the current frame as soon as that is done. Without a user interface (hython, TOPs),
`stylize` and `resume` wait for its end.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import hou  # pyright: ignore[reportMissingModuleSource]

from .bounds import require_goal
from .commands import resume_command, stylize_command
from .environment import PROGRAM, ProgramMissing, find_program
from .job import Job
from .lock import LOCK, writer_of
from .recipe_text import recipe_text
from .run_folder import Input, NotOurs, RunFolder
from .values import recipe_values

#: Seconds between two looks at a run.
_PAUSE = 0.5


@dataclass(frozen=True)
class _Run:
    """A run that this Houdini has started.

    Attributes:
        job: its process.
        folder: where it is.
        input: what was written for it; None if it was resumed.
        owner: the identity of its node in the session.
    """

    job: Job
    folder: RunFolder
    input: Input | None
    owner: int


#: The last run of each folder: nodes come and go with the scenes that are opened, and two may share one.
_RUNS: dict[str, _Run] = {}


class CannotRun(Exception):
    """What the artist has to change first; the message is one line with the remedy."""


def stylize(node: hou.SopNode) -> None:
    """Write the input and the recipe, and begin to stylize: the button Stylize."""
    _told(node, _stylize)


def resume(node: hou.SopNode) -> None:
    """Go on with the run of the node's folder: the button Resume."""
    _told(node, _resume)


def cancel(node: hou.SopNode) -> None:
    """Stop the run: the button Cancel. Does not wait for it."""
    _told(node, _cancel)


def deleted(node: hou.SopNode) -> None:
    """Stop the run that this node has started: the node goes."""
    for run in _RUNS.values():
        if run.owner == node.sessionId() and not run.job.finished:
            run.job.cancel()


def cook(node: hou.SopNode) -> None:
    """Show the results of the current frame, or the input with a warning where there are none yet."""
    path = node.evalParm("result")
    if not os.path.isfile(path):
        raise hou.NodeWarning(f"{path} is not there: the input is shown; press Stylize")
    node.geometry().loadFromFile(path)


def _told(node: hou.SopNode, action: Callable[[hou.SopNode], None]) -> None:
    """Do something, and tell the artist in one line why it could not be done."""
    try:
        action(node)
    except (CannotRun, NotOurs, ProgramMissing, ValueError, OSError, hou.OperationFailed) as error:
        message = _one_line(error)
        if not hou.isUIAvailable():
            raise hou.NodeError(message) from error
        hou.ui.displayMessage(message, severity=hou.severityType.Error, title=node.name())
    except hou.OperationInterrupted:
        _status(f"{node.name()}: interrupted while the input was written; nothing was stylized")


def _stylize(node: hou.SopNode) -> None:
    folder = _folder(node)
    _require_idle(node, folder)
    program = _program(node)
    replace = bool(node.evalParm("replace"))
    if folder.has_run and not replace:
        raise CannotRun(
            f"{folder.out}: has the results of an earlier run; press Resume to go on with it, switch on Replace an "
            "Earlier Run, or choose another Folder"
        )
    first, last = (int(number) for number in node.parmTuple("range").eval())
    if first > last:
        raise CannotRun(f"Start/End {first} to {last}: expected the first frame before the last")
    frames = range(first, last + 1)
    values, notes = recipe_values(node, frames)
    require_goal(values)
    if "fps" not in values:
        values["fps"] = float(hou.fps())
        notes.append(f"fps is Houdini's, {hou.fps():g}; the folder Run has it")
    recipe = recipe_text(values, f"{node.path()} of {hou.hipFile.path()}")

    def write(to: Path) -> None:
        (to / "recipe.toml").write_text(recipe, encoding="utf-8")
        _write_frames(node, to, frames)

    written = folder.write_input(write, node.path())
    for note in notes:
        print(f"{node.path()}: {note}")
    cluster = node.evalParm("cluster")
    command = stylize_command(program, written.sequence, str(written.recipe), str(folder.out), cluster, replace)
    try:
        _start(node, command, folder, written)
    except OSError:
        written.remove()
        raise


def _resume(node: hou.SopNode) -> None:
    folder = _folder(node)
    _require_idle(node, folder)
    if not folder.has_run:
        raise CannotRun(f"{folder.out}: no run to go on with; press Stylize")
    folder.require_ours()
    program = _program(node)
    _start(node, resume_command(program, str(folder.out), node.evalParm("cluster")), folder, None)


def _cancel(node: hou.SopNode) -> None:
    folder = _folder(node)
    run = _under_way(folder)
    if run is not None:
        run.job.cancel()
        _status(f"{node.name()}: stopping; Resume goes on from what is done")
        return
    writer = writer_of(folder.out)
    if writer is not None:
        raise CannotRun(
            f"{folder.out}: {writer} writes there, which this Houdini has not started; press Cancel or Ctrl-C where it "
            "was started, or send it an interrupt (kill -INT)"
        )
    _status(f"{node.name()}: no run is under way in {folder.path}")


def _folder(node: hou.SopNode) -> RunFolder:
    return RunFolder(Path(os.path.abspath(node.evalParm("folder"))))


def _under_way(folder: RunFolder) -> _Run | None:
    """The run of a folder that this Houdini has started, if it has not ended."""
    run = _RUNS.get(os.path.realpath(folder.path))
    return run if run is not None and not run.job.finished else None


def _require_idle(node: hou.SopNode, folder: RunFolder) -> None:
    if _under_way(folder) is not None:
        raise CannotRun(f"{node.name()}: a run is under way in {folder.path}; press Cancel, or wait for it")
    writer = writer_of(folder.out)
    if writer is not None:
        raise CannotRun(
            f"{folder.out}: {writer} writes there; wait for its end, choose another Folder, or, if it has ended on "
            f"another machine, remove {folder.out / LOCK}"
        )


def _program(node: hou.SopNode) -> str:
    # What packages set is known to Houdini, and not always to Python.
    return find_program(node.evalParm("program") or hou.getenv(PROGRAM) or "", os.environ)


def _write_frames(node: hou.SopNode, to: Path, frames: range) -> None:
    """Write the VDBs of the node's input at each frame into a folder."""
    inputs = node.inputs()
    if not inputs or inputs[0] is None:
        raise CannotRun(f"{node.name()}: nothing is connected; connect the VDBs of the smoke")
    with hou.InterruptableOperation("Writing the input of tnst-mi", open_interrupt_dialog=True) as operation:
        for done, frame in enumerate(frames):
            operation.updateProgress(done / len(frames))
            try:
                geometry = inputs[0].geometryAtFrame(frame)
            except hou.OperationFailed as error:
                raise CannotRun(f"{inputs[0].path()}: does not cook at frame {frame} ({_one_line(error)})") from error
            others = [prim for prim in geometry.iterPrims() if prim.type() != hou.primType.VDB]
            if others:
                raise CannotRun(
                    f"{inputs[0].path()}: {len(others)} primitives at frame {frame} are no VDBs, expected VDBs alone; "
                    "put a Convert VDB, or a Delete, in between"
                )
            file = to / f"smoke.{frame:04d}.vdb"
            try:
                geometry.saveToFile(str(file))
            except hou.OperationFailed as error:
                raise CannotRun(
                    f"{file}: Houdini could not write it ({_one_line(error)}); see whether the disk has room"
                ) from error


def _start(node: hou.SopNode, command: list[str], folder: RunFolder, written: Input | None) -> None:
    run = _Run(Job(command, folder.log), folder, written, node.sessionId())
    run.job.start()
    _RUNS[os.path.realpath(folder.path)] = run
    if hou.isUIAvailable():
        _watch(node, run)
        return
    try:
        while not run.job.finished:
            time.sleep(0.1)
    except BaseException:
        run.job.cancel()
        raise
    _conclude(node, run)


def _watch(node: hou.SopNode, run: _Run) -> None:
    """Show the progress of a run in the status line while Houdini is idle, and its results, until it ends."""
    name, told, shown, next_look = node.name(), "", _stamp(node), 0.0

    def look() -> None:
        nonlocal told, shown, next_look
        if time.monotonic() < next_look:
            return  # Houdini asks many times a second
        next_look = time.monotonic() + _PAUSE
        if run.job.finished:
            hou.ui.removeEventLoopCallback(look)
            _conclude(node, run)
            return
        text = f"{name}: {run.job.poll().text}"
        if text != told:
            told = text
            _status(text)
        stamp = _stamp(node)
        if stamp is not None and stamp != shown:
            _cook(node)
        shown = stamp

    hou.ui.addEventLoopCallback(look)


def _stamp(node: hou.SopNode) -> int | None:
    """By which a new result of the current frame is told from an earlier one; None where there is none."""
    try:
        return os.stat(node.evalParm("result")).st_mtime_ns
    except (OSError, ValueError, hou.ObjectWasDeleted, hou.OperationFailed):
        return None


def _cook(node: hou.SopNode) -> None:
    # The node may be gone, or has no results at this frame, which it says itself.
    with suppress(hou.ObjectWasDeleted, hou.OperationFailed):
        node.cook(force=True)


def _conclude(node: hou.SopNode, run: _Run) -> None:
    """Show the results of a run that has ended, and say how it ended."""
    with suppress(OSError):
        run.folder.remove_superseded(run.input)
    _cook(node)
    if run.job.cancelled:
        _status("tnst-mi was stopped; Resume goes on from what is done")
    elif run.job.exit_code:
        message = f"{run.job.error} (all that was said is in {run.job.log})"
        if not hou.isUIAvailable():
            raise CannotRun(message)
        hou.ui.displayMessage(message, severity=hou.severityType.Error, title="tnst-mi")
    else:
        _status(f"tnst-mi is done; all that it said is in {run.job.log}")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _status(text: str) -> None:
    if hou.isUIAvailable():
        hou.ui.setStatusMessage(text)
    else:
        print(text)
