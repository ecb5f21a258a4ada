"""What artists do with the add-on in Blender's window, step by step: see `inside_window`.

A walk is a generator. It gives what has to be true before it goes on, and notes in `told` what it saw.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from window_steps import (
    ADDON,
    area,
    begun,
    called,
    draw,
    end_run,
    module,
    motifs_shown,
    nothing_runs,
    pixels,
    press,
    processes,
    region,
    reports,
    save_own,
    starts,
    status,
    visible,
    window,
)

Walk = Iterator[Callable[[], Any]]


def panels(told: dict[str, Any], out: Path) -> Walk:
    """The thumbnails after each way to open a file, and the panels of each kind of object."""
    told["motifs"] = {}
    yield lambda: motifs_shown() == 64
    scene = bpy.data.filepath
    told["motifs"]["started with a file"] = motifs_shown()
    bpy.ops.wm.open_mainfile(filepath=str(Path(scene).with_name("other.blend")))
    told["motifs"]["File > Open"] = motifs_shown()
    bpy.ops.wm.read_homefile(use_factory_startup=False)
    told["motifs"]["File > New"] = motifs_shown()
    bpy.ops.wm.open_mainfile(filepath=scene)
    save_own(out)
    drawn = _watched_panels()
    yield _soon()
    view = area("VIEW_3D")
    view.spaces.active.show_region_ui = True
    yield lambda: region(view, "UI").width > 100
    below = 0
    while not drawn["TNST_MI_PT_sidebar", "Smoke"]:  # of the tabs at its edge, the one of the add-on is chosen
        side = region(view, "UI")
        below += 30
        press("LEFTMOUSE", (side.x + side.width - 8, side.y + side.height - below))
        yield _soon()
        draw()
    look = bpy.data.objects["Smoke"].tnst_mi.looks[0]
    look.motif = "spiral"
    before = pixels(out / "motif_spiral.png")
    look.motif = "net"
    told["pixels of another motif"] = int((np.abs(pixels(out / "motif_net.png") - before) > 0.1).any(-1).sum())
    told["drawn"] = {}
    for goal in ("PICTURE", "CHANNEL", "MOTIF"):
        look.goal = goal
        drawn.clear()
        draw()
        told["drawn"][goal] = drawn["TNST_MI_PT_sidebar", "Smoke"]
    for state in ("", ", running"):
        if state:
            _select("Smoke")
            called(bpy.ops.tnst_mi.stylize)
            yield begun(out, 1)
        for name in ("Smoke", "Domain", "Cube", "Camera", "Empty", "Linked", ""):
            yield from _drawn(name, state, drawn, told)
        yield from _preferences(state, drawn, told, out)
    end_run(out)
    yield nothing_runs
    yield from _drawn("Smoke_stylized", "", drawn, told)


def _soon(seconds: float = 0.15) -> Callable[[], bool]:
    """True a moment later, when events have been handled."""
    until = time.monotonic() + seconds
    return lambda: time.monotonic() > until


def _watched_panels() -> Counter[tuple[str, str]]:
    """Count how often each panel is drawn for each object; those of properties are opened."""
    drawn: Counter[tuple[str, str]] = Counter()

    def watched(draw: Callable[..., None]) -> Callable[..., None]:
        def counted(self: Any, context: bpy.types.Context) -> None:
            draw(self, context)
            drawn[type(self).__name__, context.object.name if context.object else ""] += 1

        return counted

    shown = module("interface.panel")
    shown.SmokePanel.draw = watched(shown.SmokePanel.draw)
    preferences = module("interface.preferences").TnstMiPreferences
    preferences.draw = watched(preferences.draw)
    for panel in (shown.TNST_MI_PT_volume, shown.TNST_MI_PT_domain):
        bpy.utils.unregister_class(panel)
        panel.bl_options = set()
        bpy.utils.register_class(panel)
    return drawn


def _select(name: str) -> None:
    """Make an object the active one, the only one that is selected; none for an empty name."""
    for item in bpy.context.view_layer.objects:
        item.select_set(item.name == name)
    bpy.context.view_layer.objects.active = bpy.data.objects[name] if name else None


def _drawn(name: str, state: str, drawn: Counter[tuple[str, str]], told: dict[str, Any]) -> Walk:
    """Note which panels are drawn for an object: in the sidebar, and in the properties that it has."""
    _select(name)
    yield _soon()
    drawn.clear()
    draw()
    properties = area("PROPERTIES").spaces.active
    for context in ("DATA", "PHYSICS"):
        try:
            properties.context = context
        except TypeError:  # it has no such properties
            continue
        draw()
    told["drawn"][f"{name or 'nothing'}{state}"] = sorted({panel for panel, _ in drawn})


def _preferences(state: str, drawn: Counter[tuple[str, str]], told: dict[str, Any], out: Path) -> Walk:
    """Note whether the preferences of the add-on are drawn."""
    shown = area("VIEW_3D")
    shown.type = "PREFERENCES"
    bpy.context.preferences.active_section = "ADDONS"
    bpy.context.window_manager.addon_search = "tnst_mi"
    drawn.clear()
    draw()
    yield _soon()
    if not drawn:
        bpy.ops.preferences.addon_expand(module=ADDON)
    drawn.clear()
    pixels(out / f"preferences{state}.png")
    told["drawn"][f"preferences{state}"] = sorted({panel for panel, _ in drawn})
    shown.type = "VIEW_3D"


def runs(told: dict[str, Any], out: Path) -> Walk:
    """A run outlives its window and a change of workspaces; results are steps of Undo."""
    save_own(out)
    told["status"] = {}

    def note_status(space: str, when: str) -> Walk:
        """Show a workspace, and note what its status bar shows."""
        window().workspace = bpy.data.workspaces[space]
        yield _soon(0.6)  # jobs are looked at four times in a second
        told["status"][f"{space}, {when}"] = status(out / f"{space}_{when}.png")

    def result_and_original() -> list[bool]:
        return [visible("Smoke_stylized"), visible("Smoke")]

    for space in ("Modeling", "Layout"):
        yield from note_status(space, "before")
    called(bpy.ops.wm.window_new_main)
    second = bpy.context.window_manager.windows[1]
    yield _soon()
    told["status"]["second window, before"] = status(out / "second_before.png", second)
    called(bpy.ops.tnst_mi.stylize, second)
    yield begun(out, 1)
    told["status"]["second window, during"] = status(out / "second_during.png", second)
    called(bpy.ops.wm.window_close, second)
    yield lambda: len(bpy.context.window_manager.windows) == 1
    for space in ("Layout", "Modeling"):
        yield from note_status(space, "during")
    told["before the end"] = result_and_original()
    end_run(out)
    yield nothing_runs
    told["at the end"] = result_and_original()
    for space in ("Modeling", "Layout"):
        yield from note_status(space, "after")
    told["reported"] = reports()

    press("Z", ctrl=True)
    yield _soon()
    told["undone"] = result_and_original()
    press("Z", ctrl=True, shift=True)
    yield _soon()
    told["redone"] = result_and_original()

    _select("Smoke")
    called(bpy.ops.tnst_mi.stylize)
    yield begun(out, 2)
    _select("Cube")
    called(bpy.ops.transform.translate, value=(1.0, 0.0, 0.0))
    told["moved"] = [bpy.data.objects["Cube"].location.x]
    press("Z", ctrl=True)
    yield _soon()
    told["moved"].append(bpy.data.objects["Cube"].location.x)
    end_run(out)
    yield nothing_runs
    told["undone during the run"] = result_and_original()

    _select("Smoke")
    called(bpy.ops.tnst_mi.stylize)
    yield begun(out, 3)
    bpy.data.objects["Smoke"].hide_viewport = False
    _select("Smoke")
    called(bpy.ops.object.delete)
    end_run(out)
    yield nothing_runs
    yield lambda: "deleted" in reports()
    told["of the deleted one"] = reports().splitlines()[-1]


def stops(told: dict[str, Any], out: Path) -> Walk:
    """All ways in which a run is stopped, and how it goes on; in the end, Blender is quit during one."""
    other = str(Path(bpy.data.filepath).with_name("other.blend"))
    save_own(out)
    own = bpy.data.filepath
    before = status(out / "before.png")
    watch = module("interface.running")._watch

    def stopped(how: str, stop: Callable[[], Any]) -> Walk:
        """Stop a run once it has begun, and note what is left of it."""
        yield begun(out, len(starts(out)))
        told[how] = {"status while it runs": status(out / "running.png") != before}
        asked = time.monotonic()
        stop()
        yield lambda: not processes(out)
        told[how]["seconds"] = time.monotonic() - asked
        yield _soon()
        told[how] |= {
            "timer": bpy.app.timers.is_registered(watch),
            "status": status(out / f"left_{how}.png") != before,
            "shown": [visible("Smoke"), visible("Smoke_stylized")],
        }

    called(bpy.ops.tnst_mi.stylize)
    yield lambda: len(starts(out)) == 1
    yield from stopped("Cancel", lambda: called(bpy.ops.tnst_mi.cancel))
    called(bpy.ops.tnst_mi.resume)
    yield lambda: len(starts(out)) == 2
    yield from stopped("disabled", lambda: bpy.ops.preferences.addon_disable(module=ADDON))
    told["operators of the disabled one"] = hasattr(bpy.types, "TNST_MI_OT_stylize")
    bpy.ops.preferences.addon_enable(module=ADDON)
    called(bpy.ops.tnst_mi.stylize)
    yield lambda: len(starts(out)) == 3
    yield from stopped("another file", lambda: bpy.ops.wm.open_mainfile(filepath=other))
    told["opened"] = sorted(item.name for item in bpy.data.objects)
    bpy.ops.wm.open_mainfile(filepath=own)
    called(bpy.ops.tnst_mi.resume)
    yield begun(out, 4)
    end_run(out)
    yield nothing_runs
    told["resumed in the first file"] = [visible("Smoke"), visible("Smoke_stylized")]
    # A run that replaces the one before, whose results are gone as it begins; the scene does not know it, or does.
    bpy.ops.wm.save_mainfile()
    for number, stop in enumerate(
        (
            lambda: bpy.ops.wm.open_mainfile(filepath=other),
            lambda: bpy.ops.preferences.addon_disable(module=ADDON),
        ),
        5,
    ):
        bpy.context.view_layer.objects.active = bpy.data.objects["Smoke"]
        called(bpy.ops.tnst_mi.stylize)
        yield begun(out, number)
        stop()
        yield lambda: not processes(out)
        if hasattr(bpy.types, "TNST_MI_OT_stylize"):
            bpy.ops.wm.open_mainfile(filepath=own)
        else:
            bpy.ops.preferences.addon_enable(module=ADDON)
        yield nothing_runs
        kept = [run.text for run in bpy.context.scene.tnst_mi_runs]
        told[f"run {number} replaces another"] = [visible("Smoke"), kept]
    bpy.ops.wm.open_mainfile(filepath=own)
    bpy.context.view_layer.objects.active = bpy.data.objects["Smoke"]
    called(bpy.ops.tnst_mi.stylize)
    yield begun(out, 7)
    told["started"] = [start["arguments"][:2] for start in starts(out)]
    told["running when Blender is quit"] = len(processes(out))
