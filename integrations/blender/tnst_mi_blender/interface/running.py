"""The job that runs beside Blender: one at a time, watched by a timer, in the status bar and the panel."""

from __future__ import annotations

import time
from collections.abc import Callable

import bpy

from ..problems import CannotStylizeError
from ..processes.environment import EnvironmentMissing
from ..processes.job import Job
from ..processes.progress import Progress

#: Seconds between two looks at a job.
_EVERY = 0.25


class Running:
    """A job and what comes after it.

    Attributes:
        job: that runs.
        title: what it does, in a few words.
        done: called in the end if it has succeeded; returns what is reported.
        progress: how far it has got.
    """

    def __init__(self, job: Job, title: str, done: Callable[[], str]) -> None:
        self.job, self.title, self.done = job, title, done
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

    _timer: bpy.types.Timer | None = None

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
        if bpy.app.background:
            while not now.job.finished:
                now.progress = now.job.poll()
                time.sleep(_EVERY)
            return self._end(context)
        self._timer = context.window_manager.event_timer_add(_EVERY, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Look at the job at each tick of the timer; everything else is Blender's."""
        now = _Watched.running
        if event.type != "TIMER" or now is None:
            return {"PASS_THROUGH"}
        now.progress = now.job.poll()
        if not now.job.finished:
            _show(context, now)
            return {"PASS_THROUGH"}
        return self._end(context)

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends the operator, since it opens another file or quits: the job goes with it."""
        end_job()
        self._clear(context)

    def _end(self, context: bpy.types.Context) -> set[str]:
        """Say what has become of the job."""
        ended = _Watched.running
        assert ended is not None
        self._clear(context)
        if ended.job.cancelled:
            self.report({"INFO"}, f"{ended.title}: stopped")
            return {"CANCELLED"}
        if ended.job.error is not None:
            self.report({"ERROR"}, ended.job.error)
            return {"CANCELLED"}
        try:
            self.report({"INFO"}, ended.done())
        except (CannotStylizeError, OSError, ReferenceError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}

    def _clear(self, context: bpy.types.Context) -> None:
        _Watched.running = None
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
            context.workspace.status_text_set(None)
            _redraw(context)


class TNST_MI_OT_cancel(bpy.types.Operator):
    """Stop what runs. A stylization can be resumed where it was"""

    bl_idname = "tnst_mi.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """While something runs."""
        return _Watched.running is not None and not _Watched.running.job.cancelled

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ask it to end; the operator that watches it says when it has."""
        end_job()
        return {"FINISHED"}


def end_job() -> None:
    """Ask what runs to end."""
    if _Watched.running is not None:
        _Watched.running.job.cancel()


def _show(context: bpy.types.Context, shown: Running) -> None:
    """Show how far a job has got."""
    text = "stopping" if shown.job.cancelled else shown.progress.text
    context.workspace.status_text_set(f"{shown.title}: {text}")
    _redraw(context)


def _redraw(context: bpy.types.Context) -> None:
    """Let panels show what is new."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in ("VIEW_3D", "PROPERTIES", "PREFERENCES"):
                area.tag_redraw()
