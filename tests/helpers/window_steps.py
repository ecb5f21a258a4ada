"""For walks through Blender's window (`window_walks`): what artists press, and what they see."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np

ADDON = "tnst_mi_blender"

#: The left part of the status bar, which has its text: pixels from the window's lower left corner.
STATUS_WIDTH, STATUS_HEIGHT = 400, 18


def module(name: str) -> Any:
    """A module of the add-on."""
    return sys.modules[f"{ADDON}.{name}"]


def window() -> bpy.types.Window:
    """The window that is left when all others are closed."""
    return bpy.context.window_manager.windows[0]


def area(kind: str) -> bpy.types.Area:
    """An area of the window."""
    return next(each for each in window().screen.areas if each.type == kind)


def region(of: bpy.types.Area, kind: str) -> bpy.types.Region:
    """A region of an area."""
    return next(each for each in of.regions if each.type == kind)


def called(operator: Any, where: bpy.types.Window | None = None, **given: Any) -> list[str]:
    """Call an operator from the 3D view of a window, as a button there does: with a step of Undo."""
    shown = where or window()
    view = next(each for each in shown.screen.areas if each.type == "VIEW_3D")
    with bpy.context.temp_override(window=shown, area=view, region=region(view, "WINDOW")):
        return list(operator("EXEC_DEFAULT", True, **given))


def press(name: str, where: tuple[int, int] | None = None, **held: bool) -> None:
    """Press a key or a button of the mouse: where the mouse then is, in pixels of the window; else over the 3D view."""
    view = region(area("VIEW_3D"), "WINDOW")
    x, y = where or (view.x + view.width // 3, view.y + view.height // 2)
    window().event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=y)
    for value in ("PRESS", "RELEASE"):
        window().event_simulate(type=name, value=value, x=x, y=y, **held)


def draw(shown: bpy.types.Window | None = None) -> None:
    """Draw all of a window now."""
    with bpy.context.temp_override(window=shown or window()):
        bpy.ops.wm.redraw_timer(type="DRAW_WIN_SWAP", iterations=1)


def pixels(file: Path, shown: bpy.types.Window | None = None) -> np.ndarray:
    """What a window shows now, (height, width, 4) from the bottom up; the picture is written to the file.

    No other window may be before it.
    """
    draw(shown)
    with bpy.context.temp_override(window=shown or window()):
        bpy.ops.screen.screenshot(filepath=str(file))
    picture = bpy.data.images.load(str(file))
    width, height = picture.size
    colours = np.empty(width * height * 4, np.float32)
    picture.pixels.foreach_get(colours)
    bpy.data.images.remove(picture)
    return colours.reshape(height, width, 4)


def status(file: Path, shown: bpy.types.Window | None = None) -> str:
    """What the status bar of a window shows where its text is, as a number of its pixels."""
    return hashlib.sha256(pixels(file, shown)[:STATUS_HEIGHT, :STATUS_WIDTH].tobytes()).hexdigest()


def reports() -> str:
    """All that was reported, as the info editor shows it."""
    shown, clipboard = area("DOPESHEET_EDITOR"), bpy.context.window_manager.clipboard
    shown.type = "INFO"
    with bpy.context.temp_override(window=window(), area=shown, region=region(shown, "WINDOW")):
        bpy.ops.info.select_all(action="SELECT")
        bpy.ops.info.report_copy()
    shown.type = "DOPESHEET_EDITOR"
    copied, bpy.context.window_manager.clipboard = bpy.context.window_manager.clipboard, clipboard
    return copied


def starts(out: Path) -> list[dict[str, Any]]:
    """How the stand-in of tnst-mi was started so far."""
    file = out / "starts.jsonl"
    return [json.loads(line) for line in file.read_text("utf-8").splitlines()] if file.exists() else []


def processes(out: Path) -> list[int]:
    """What is left of all that was started: the stand-in, and what runs it."""
    return [number for start in starts(out) for number in start["processes"] if _is_alive(number)]


def _is_alive(number: int) -> bool:
    """Whether a process does anything still; what has ended and was not asked how does not."""
    try:
        return Path(f"/proc/{number}/stat").read_text("utf-8").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def begun(out: Path, number: int) -> Callable[[], bool]:
    """Whether a run, by its number, has told how far it got."""

    def is_true() -> bool:
        now = module("interface.running").running()
        return len(starts(out)) == number and now is not None and "octave 1/1" in now.progress.text

    return is_true


def nothing_runs() -> bool:
    """Whether the last run has ended and that was told."""
    return module("interface.running").running() is None


def end_run(out: Path) -> None:
    """Let the run go on to its end."""
    (out / "end").touch()


def save_own(out: Path) -> None:
    """Save the scene in the walk's folder, beside which results are."""
    bpy.ops.wm.save_as_mainfile(filepath=str(out / "scene.blend"))


def motifs_shown() -> int:
    """How many motifs have their thumbnails."""
    thumbnails = module("interface.thumbnails")
    pictures = thumbnails._Loaded.pictures
    return sum(
        choice[3] > 0 and tuple(pictures[choice[0]].image_size) == (64, 64) and choice[3] == pictures[choice[0]].icon_id
        for choice in thumbnails.motif_items()
        if choice[0] in pictures
    )


def visible(name: str) -> bool:
    """Whether an object is there and not hidden in the viewport."""
    item = bpy.data.objects.get(name)
    return item is not None and not item.hide_viewport
