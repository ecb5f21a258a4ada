"""The job that runs beside Blender: one at a time, watched by a timer, in the status bar and the panel.

The timer is Blender's own and no window's: windows are closed, and workspaces changed, while something runs.
"""

# Blender reads the annotations of classes: they are no texts here.

import time
from collections.abc import Callable

import bpy
from bpy.props import EnumProperty, StringProperty

from ..problems import CannotStylizeError
from ..processes.environment import EnvironmentMissing
from ..processes.job import Job
from ..processes.progress import Progress
from .kept import Kept
from .labels import in_panel_words

#: Seconds between two looks at a job.
_EVERY = 0.25


class Running:
    """A job and what comes after it.

    Attributes:
        job: that runs.
        title: what it does, in a few words.
        done: called in the end if it has succeeded; returns what is reported.
        item: the object that it is for; None of installations, which go on when another file is opened.
        stopped: called in the end if it has not succeeded, with what was wrong; with None if it was cancelled.
        progress: how far it has got.
    """

    def __init__(
        self,
        job: Job,
        title: str,
        done: Callable[[], str],
        item: Kept | None = None,
        stopped: Callable[[str | None], None] = lambda _problem: None,
    ) -> None:
        self.job, self.title, self.done, self.item, self.stopped = job, title, done, item, stopped
        self.progress = Progress(None, "starting")


class _Watched:
    """What runs now; None if nothing does."""

    running: Running | None = None


def running() -> Running | None:
    """What runs; None if nothing does."""
    return _Watched.running


class RunsJob:
    """An operator that starts a job. In the background of a script, it waits for its end; else Blender stays usable."""

    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Not while another one runs."""
        return _Watched.running is None

    def begin(self, context: bpy.types.Context) -> Running:
        """Prepare and start the job.

        Raises:
            CannotStylizeError, EnvironmentMissing, OSError: it cannot be started.
        """
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start, and watch."""
        try:
            now = _Watched.running = self.begin(context)
        except (CannotStylizeError, EnvironmentMissing, ValueError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if not bpy.app.background:
            bpy.app.timers.register(_watch, first_interval=_EVERY, persistent=True)
            return {"FINISHED"}
        while not now.job.finished:
            now.progress = now.job.poll()
            time.sleep(_EVERY)
        kind, text = _end(now)
        self.report({kind}, text)
        return {"CANCELLED"} if kind == "ERROR" or now.job.cancelled else {"FINISHED"}


class TNST_MI_OT_cancel(bpy.types.Operator):
    """Stop what runs. A stylization can be resumed where it was"""

    bl_idname = "tnst_mi.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """While something runs."""
        return _Watched.running is not None and not _Watched.running.job.cancelled

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ask it to end; it is said when it has."""
        end_job()
        return {"FINISHED"}


class TNST_MI_OT_report(bpy.types.Operator):
    """Say what has become of a job: what timers report themselves is not shown"""

    bl_idname = "tnst_mi.report"
    bl_label = "Report"
    bl_options = {"INTERNAL"}

    kind: EnumProperty(items=[(kind, kind.capitalize(), "") for kind in ("INFO", "ERROR")])
    text: StringProperty()

    _timer: bpy.types.Timer | None = None

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Wait for an event of the window, since Blender shows what is reported then."""
        self._timer = context.window_manager.event_timer_add(0.01, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Report."""
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self._timer)
        self.report({self.kind}, self.text)
        return {"FINISHED"}


def end_job() -> None:
    """Ask what runs to end."""
    if _Watched.running is not None:
        _Watched.running.job.cancel()


def _watch() -> float | None:
    """Look at the job, and return the seconds until the next time; None once it has ended."""
    now = _Watched.running
    if now is None:
        return None
    now.progress = now.job.poll()
    if now.item is not None:
        now.item.find()
    if not now.job.finished:
        _show(f"{now.title}: {now.progress.text}")
        return _EVERY
    try:
        kind, text = _end(now)
    finally:
        _show(None)
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
        if kind != "ERROR" and now.item is not None and not now.job.cancelled:
            # The result is a step of its own, that Undo takes back and Redo brings back.
            bpy.ops.ed.undo_push(message=now.title)
        bpy.ops.tnst_mi.report("INVOKE_DEFAULT", kind=kind, text=text)
    return None


def _end(ended: Running) -> tuple[str, str]:
    """Use what a job has made; returns the kind and the words of a report."""
    _Watched.running = None
    ended.progress = ended.job.poll()
    if ended.job.cancelled:
        ended.stopped(None)
        return "INFO", f"{ended.title}: stopped"
    problem = ended.job.error
    if problem is None:
        try:
            return "INFO", ended.done()
        except (CannotStylizeError, OSError) as error:
            problem = str(error)
    problem = in_panel_words(problem)
    ended.stopped(problem)
    return "ERROR", problem


def _show(text: str | None) -> None:
    """Show how far a job has got, in panels and in each window's status bar; None when it has ended."""
    windows = bpy.context.window_manager.windows
    for window in windows:
        # Those that were left during the run have its text still.
        for workspace in [window.workspace] if text else bpy.data.workspaces:
            # One in the other: together with a window, the workspace is that of the window.
            with bpy.context.temp_override(window=window), bpy.context.temp_override(workspace=workspace):
                workspace.status_text_set(text)
        for area in window.screen.areas:
            if area.type in ("VIEW_3D", "PROPERTIES", "PREFERENCES"):
                area.tag_redraw()


@bpy.app.handlers.persistent
def _end_with_scene(*_: object) -> None:
    """Another file was opened: what runs for an object of the last one is ended."""
    if _Watched.running is not None and _Watched.running.item is not None:
        _Watched.running.item.forget()
        end_job()


_CLASSES = (TNST_MI_OT_cancel, TNST_MI_OT_report)


def register() -> None:
    """Add the operators."""
    for each in _CLASSES:
        bpy.utils.register_class(each)
    bpy.app.handlers.load_post.append(_end_with_scene)


def unregister() -> None:
    """Remove them; what runs is ended, by a process that does not need Blender."""
    bpy.app.handlers.load_post.remove(_end_with_scene)
    if bpy.app.timers.is_registered(_watch):
        bpy.app.timers.unregister(_watch)
    if _Watched.running is not None:
        end_job()
        # Nobody is left to see it ending.
        _Watched.running.stopped(None)
        _Watched.running = None
        _show(None)
    for each in reversed(_CLASSES):
        bpy.utils.unregister_class(each)
