"""The SOP `tnst_mi::stylize` inside Houdini: what its buttons do, and what it shows.

Houdini waits while the input is written, which Escape interrupts. tnst-mi then runs beside it: the status line shows
how far it has got, and the node each frame that is done. Without a user interface (hython, TOPs), `stylize` and
`resume` wait for its end.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import hou  # pyright: ignore[reportMissingModuleSource]

from .commands import resume_command, stylize_command
from .environment import PROGRAM, ProgramMissing, find_program, process_environment
from .job import Job
from .recipe_text import recipe_text
from .run_folder import RunFolder, written_whole
from .values import BadValue, recipe_values

# The runs of nodes, by the identity of these in the session.
_JOBS: dict[int, Job] = {}


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
    job = _JOBS.get(node.sessionId())
    if job is not None and job.exit_code is None:
        job.cancel()
        _status(f"{node.name()}: stopping; Resume goes on from what is done")


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
    except (CannotRun, ProgramMissing, BadValue, OSError) as error:
        if not hou.isUIAvailable():
            raise hou.NodeError(str(error)) from error
        hou.ui.displayMessage(str(error), severity=hou.severityType.Error, title=node.name())
    except hou.OperationInterrupted:
        _status(f"{node.name()}: interrupted while the input was written; nothing was stylized")


def _stylize(node: hou.SopNode) -> None:
    _require_idle(node)
    program = _program(node)
    folder = RunFolder(Path(node.evalParm("folder")))
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
    if "fps" not in values:
        values["fps"] = float(hou.fps())
        notes.append(f"fps is Houdini's, {hou.fps():g}; the folder Run has it")
    _write_input(node, folder, frames)
    with written_whole(folder.recipe) as beside:
        beside.write_text(recipe_text(values, f"{node.path()} of {hou.hipFile.path()}"), encoding="utf-8")
    for note in notes:
        print(f"{node.path()}: {note}")
    command = stylize_command(
        program, folder.sequence, str(folder.recipe), str(folder.out), node.evalParm("cluster"), replace
    )
    _start(node, command, folder)


def _resume(node: hou.SopNode) -> None:
    _require_idle(node)
    folder = RunFolder(Path(node.evalParm("folder")))
    if not folder.has_run:
        raise CannotRun(f"{folder.out}: no run to go on with; press Stylize")
    program = _program(node)
    _start(node, resume_command(program, str(folder.out), node.evalParm("cluster")), folder)


def _program(node: hou.SopNode) -> str:
    # What packages set is known to Houdini, and not always to Python.
    return find_program(node.evalParm("program") or hou.getenv(PROGRAM) or "", os.environ)


def _require_idle(node: hou.SopNode) -> None:
    job = _JOBS.get(node.sessionId())
    if job is not None and job.exit_code is None:
        raise CannotRun(f"{node.name()}: a run is under way; press Cancel, or wait for it")


def _write_input(node: hou.SopNode, folder: RunFolder, frames: range) -> None:
    """Write the VDBs of the node's input at each frame."""
    inputs = node.inputs()
    if not inputs or inputs[0] is None:
        raise CannotRun(f"{node.name()}: nothing is connected; connect the VDBs of the smoke")
    folder.remove_other_inputs(frames)
    with hou.InterruptableOperation("Writing the input of tnst-mi", open_interrupt_dialog=True) as operation:
        for done, frame in enumerate(frames):
            operation.updateProgress(done / len(frames))
            geometry = inputs[0].geometryAtFrame(frame)
            others = [prim for prim in geometry.iterPrims() if prim.type() != hou.primType.VDB]
            if others:
                raise CannotRun(
                    f"{inputs[0].path()}: {len(others)} primitives at frame {frame} are no VDBs, expected VDBs alone; "
                    "put a Convert VDB, or a Delete, in between"
                )
            _save(geometry, folder.input_file(frame))


def _save(geometry: hou.Geometry, file: Path) -> None:
    try:
        with written_whole(file) as beside:
            geometry.saveToFile(str(beside))
    except hou.OperationFailed as error:
        said = " ".join(str(error).split())
        raise CannotRun(f"{file}: Houdini could not write it ({said}); see whether the disk has room") from error


def _start(node: hou.SopNode, command: list[str], folder: RunFolder) -> None:
    job = Job(command, folder.log, process_environment(os.environ))
    _JOBS[node.sessionId()] = job
    if hou.isUIAvailable():
        _watch(node, job)
        return
    job.wait()
    _conclude(node, job)


def _watch(node: hou.SopNode, job: Job) -> None:
    """Show the progress of a run in the status line while Houdini is idle, until it ends."""
    name, shown = node.name(), ""

    def look() -> None:
        nonlocal shown
        ended = job.exit_code is not None
        progress = job.progress
        text = f"{name}: {'preparing' if progress is None else progress.text}"
        if not ended and not job.cancelled and text != shown:
            shown = text
            _status(text)
        if ended:
            hou.ui.removeEventLoopCallback(look)
            _conclude(node, job)

    hou.ui.addEventLoopCallback(look)


def _conclude(node: hou.SopNode, job: Job) -> None:
    """Show the results of a run that has ended, and say how it ended."""
    try:
        node.cook(force=True)
    except (hou.ObjectWasDeleted, hou.OperationFailed):
        # The node is gone, or has no results at this frame, which it says itself.
        pass
    if job.cancelled:
        _status("tnst-mi was stopped; Resume goes on from what is done")
    elif job.exit_code:
        if not hou.isUIAvailable():
            raise CannotRun(job.error)
        hou.ui.displayMessage(job.error, severity=hou.severityType.Error, title="tnst-mi")
    else:
        _status(f"tnst-mi is done; all that it said is in {job.log}")


def _status(text: str) -> None:
    if hou.isUIAvailable():
        hou.ui.setStatusMessage(text)
    else:
        print(text)
