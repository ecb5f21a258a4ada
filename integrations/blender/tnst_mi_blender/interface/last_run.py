"""What a scene keeps of the last run of each object: its identifier, its folder, and how it ended.

The identifier is in the plan of the run too. So it is known whose results a folder has, whatever objects, scenes and
files are named since. It is the scene that keeps it, and not the object: copies of an object, and what is linked or
appended from another file, would have it too, though the run is not theirs.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import bpy

from ..problems import CannotStylizeError
from ..recipes.plan import Plan, UnreadablePlanError, read_plan
from ..scene.results import show_original_of_lost

#: What is said of a run that nobody has seen ending: Blender was closed, or another file was opened.
UNFINISHED = "Not finished: Resume goes on"
_UNKNOWN = "Not finished, or the scene was not saved since: Resume goes on"


def keep(item: bpy.types.Object, plan: Plan, folder: Path, text: str = "", log: Path | None = None) -> None:
    """Keep what has become of the last run of an object, until the next one.

    Args:
        item: the object whose smoke it is.
        plan: of the run.
        folder: that of the plan.
        text: what is said of it: how it was stopped or has failed, or the notes of one that has ended well.
        log: of a run that has failed, to be read.
    """
    run = next((run for run in _runs() if run.item == item), None)
    if run is None:
        there = [scene for scene in item.users_scene if scene.library is None]
        run = (there or [bpy.context.scene])[0].tnst_mi_runs.add()
        run.item = item
    run.identifier, run.folder = plan.identifier, os.path.abspath(folder)
    run.text, run.log = text, "" if log is None else os.path.abspath(log)


def run_of(item: bpy.types.Object) -> bpy.types.PropertyGroup | None:
    """What is kept of the last run of an object; None if it has had none, as a copy of one that has."""
    return next((run for run in _runs() if run.item == item and _owner(run.identifier) == item), None)


def require_own(folder: Path, plan: Plan, item: bpy.types.Object) -> None:
    """Check that the results in a folder are not those of another object.

    Of a run that nothing here knows, that is an object of another file, if it was started in one and that still
    exists. A scene of the same file does not know it if it was not saved since, or after Undo.

    Args:
        folder: of a plan.
        plan: that is in it.
        item: the object that they are to be of.

    Raises:
        CannotStylizeError: they are of another one.
    """
    owner = _owner(plan.identifier)
    if owner is not None:
        whose = "" if owner == item else owner.name
    else:
        whose = f"{plan.item} in {plan.scene}" if _is_another_file(plan.scene) else ""
    if whose:
        raise CannotStylizeError(
            f"{folder}: has the results of {whose}; choose another folder in Results for {item.name}, and press Stylize"
        )


def _runs() -> Iterator[bpy.types.PropertyGroup]:
    """What is kept by the scenes of this file."""
    return (run for scene in bpy.data.scenes if scene.library is None for run in scene.tnst_mi_runs)


def _owner(identifier: str) -> bpy.types.Object | None:
    """The object that a run is of. A full copy of a scene has copies of what it keeps: the first one counts."""
    return next((run.item for run in _runs() if run.identifier == identifier and _is_there(run.item)), None)


def _is_there(item: bpy.types.Object | None) -> bool:
    # What is deleted is left without a collection, since something refers to it.
    return item is not None and bool(item.users_collection)


def _is_another_file(scene: str) -> bool:
    return bool(scene) and os.path.exists(scene) and not _is_this_file(scene)


def _is_this_file(scene: str) -> bool:
    return os.path.normcase(os.path.realpath(scene)) == os.path.normcase(os.path.realpath(bpy.data.filepath))


@bpy.app.handlers.persistent
def _look_after_opening(*_: object) -> None:
    """A file was opened: objects are forgotten that were deleted, and those shown whose results are gone.

    That is where a run was stopped that replaces an earlier one. If it began after the file was saved, it is known
    from its plan. Where the folder cannot be read, as on a disk that is not there now, all stays as it is.
    """
    for scene in bpy.data.scenes:
        if scene.library is not None:
            continue
        for index in reversed(range(len(scene.tnst_mi_runs))):
            if not _is_there(scene.tnst_mi_runs[index].item):
                scene.tnst_mi_runs.remove(index)
        for run in scene.tnst_mi_runs:
            try:
                plan = read_plan(Path(run.folder))
            except UnreadablePlanError:
                continue
            if not show_original_of_lost(run.item) or plan.identifier == run.identifier:
                continue
            if _is_this_file(plan.scene) and _owner(plan.identifier) is None:
                run.identifier, run.text, run.log = plan.identifier, _UNKNOWN, ""


def register() -> None:
    """Look after each file that is opened."""
    bpy.app.handlers.load_post.append(_look_after_opening)


def unregister() -> None:
    """No longer."""
    bpy.app.handlers.load_post.remove(_look_after_opening)
