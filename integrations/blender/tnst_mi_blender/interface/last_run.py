"""What an object keeps of its last run: the folder of it, and how it ended. Both are saved with the scene.

So a run is found again after the object was renamed, and from a scene that was saved elsewhere. Copies of an object
have that too, though the run is not theirs: `require_own` tells them apart.
"""

from __future__ import annotations

import os
from pathlib import Path

import bpy

from ..problems import CannotStylizeError

#: What is said of a run that nobody has seen ending: Blender was closed, or another file was opened.
_UNFINISHED = "Not finished: Resume goes on"


def begun(item: bpy.types.Object, folder: Path) -> None:
    """A run has begun, which is kept until the next one.

    Args:
        item: the object whose smoke it is.
        folder: that of its plan.
    """
    run = item.tnst_mi.last_run
    run.folder, run.item = os.path.abspath(folder), item.name
    run.text, run.log = _UNFINISHED, ""


def ended(item: bpy.types.Object, text: str = "", log: Path | None = None) -> None:
    """The last run has ended.

    Args:
        item: the object whose smoke it is.
        text: what is said of it until the next run; empty if it has ended well.
        log: of a run that has failed, to be read.
    """
    run = item.tnst_mi.last_run
    run.text, run.log = text, "" if log is None else os.path.abspath(log)


def text_of(item: bpy.types.Object) -> str:
    """What is said of the last run of an object; empty if it has ended well, or was that of the object's original."""
    run = item.tnst_mi.last_run
    return run.text if run.text and _owners(Path(run.folder), run.item) == [item] else ""


def require_own(folder: Path, name: str, item: bpy.types.Object) -> None:
    """Check that the results in a folder are not those of another object.

    Args:
        folder: of a plan.
        name: of the plan's object as its run began.
        item: the object that they are to be of.

    Raises:
        CannotStylizeError: they are of another one, or of one of several copies.
    """
    owners = _owners(folder, name)
    if not owners or owners == [item]:
        return
    if item not in owners:
        raise CannotStylizeError(
            f"{folder}: has the results of {owners[0].name}; choose another folder in Results for {item.name}, and "
            "press Stylize"
        )
    names = " or ".join(owner.name for owner in owners)
    raise CannotStylizeError(
        f"{folder}: has the results of {name}, which is {names} now: name the right one {name} again, or choose "
        "another folder in Results and press Stylize"
    )


def _owners(folder: Path, name: str) -> list[bpy.types.Object]:
    """The objects that may be the one whose results are in a folder, which was named `name` as its run began.

    These are the one that has this name still, or else those whose last run was there: one that was renamed, and
    copies. A new object that was given the name has no run.
    """
    there = [item for item in bpy.data.objects if item.library is None and item.users_collection]
    claiming = [item for item in there if item.tnst_mi.last_run.folder == os.path.abspath(folder)]
    for item in there:
        if item.name == name and (item in claiming or item.tnst_mi.last_run.folder or not claiming):
            return [item]
    return claiming
