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
    told["seen"] = {}
    look = bpy.data.objects["Smoke"].tnst_mi.looks[0]
    look.motif = "spiral"
    before = pixels(out / "motif_spiral.png")
    look.motif = "net"
    told["pixels of another motif"] = int((np.abs(pixels(out / "motif_net.png") - before) > 0.1).any(-1).sum())
    told["drawn"] = {}
    for running in (False, True):
        if running:
            _select("Smoke")
            called(bpy.ops.tnst_mi.stylize)
            yield begun(out, 1)
        for name in ("Smoke", "Domain", "Cube", "Camera", "Empty", "Linked", ""):
            yield from _drawn(name, drawn, told, out, running)
        yield from _preferences(drawn, told, out, running)
    end_run(out)
    yield nothing_runs
    yield from _drawn("Smoke_stylized", drawn, told, out, False)


def _soon() -> Callable[[], bool]:
    """True a moment later, when events have been handled."""
    until = time.monotonic() + 0.15
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


def _drawn(name: str, drawn: Counter[tuple[str, str]], told: dict[str, Any], out: Path, running: bool) -> Walk:
    """Look at an object's panels, in the sidebar and in the properties that it has."""
    _select(name)
    yield _soon()
    drawn.clear()
    properties = area("PROPERTIES").spaces.active
    for context in ("DATA", "PHYSICS"):
        try:
            properties.context = context
        except TypeError:  # it has no such properties
            continue
        draw()
    told["drawn"][f"{name or 'nothing'}{', running' if running else ''}"] = sorted({panel for panel, _ in drawn})


def _preferences(drawn: Counter[tuple[str, str]], told: dict[str, Any], out: Path, running: bool) -> Walk:
    """Look at the preferences of the add-on."""
    shown = area("VIEW_3D")
    shown.type = "PREFERENCES"
    bpy.context.preferences.active_section = "ADDONS"
    bpy.context.window_manager.addon_search = "tnst_mi"
    yield _soon()
    if not drawn["TnstMiPreferences", ""]:
        bpy.ops.preferences.addon_expand(module=ADDON)
    drawn.clear()
    picture = f"preferences{'_running' if running else ''}.png"
    told["seen"][picture] = float(pixels(out / picture).std())
    told["drawn"][picture] = sorted({panel for panel, _ in drawn})
    shown.type = "VIEW_3D"


def runs(told: dict[str, Any], out: Path) -> Walk:
    """A run outlives its window and a change of workspaces; results are steps of Undo."""
    save_own(out)
    spaces = ("Layout", "Modeling")
    told["status"] = {space: [] for space in spaces}

    def note_status(space: str, when: str) -> Walk:
        window().workspace = bpy.data.workspaces[space]
        yield lambda: window().workspace.name == space
        yield _soon()
        told["status"][space].append(status(out / f"{space}_{when}.png"))

    for space in reversed(spaces):
        yield from note_status(space, "before")
    called(bpy.ops.wm.window_new)
    second = bpy.context.window_manager.windows[1]
    told["pressed"] = called(bpy.ops.tnst_mi.stylize, second)
    yield begun(out, 1)
    yield from note_status("Layout", "during")
    called(bpy.ops.wm.window_close, bpy.context.window_manager.windows[1])
    yield lambda: len(bpy.context.window_manager.windows) == 1
    yield from note_status("Modeling", "during")
    end_run(out)
    yield nothing_runs
    told["shown"] = [visible("Smoke"), visible("Smoke_stylized")]
    for space in reversed(spaces):
        yield from note_status(space, "after")
    told["reported"] = reports()

    told["undone"] = []
    for name, held in (("Z", {"ctrl": True}), ("Z", {"ctrl": True, "shift": True})):
        press(name, **held)
        yield _soon()
        told["undone"].append([visible("Smoke"), visible("Smoke_stylized")])

    told["again"] = called(bpy.ops.tnst_mi.stylize)
    yield begun(out, 2)
    called(bpy.ops.transform.translate, value=(1.0, 0.0, 0.0))
    told["moved"] = [bpy.data.objects["Smoke"].location.x]
    press("Z", ctrl=True)
    yield lambda: bpy.data.objects["Smoke"].location.x == 0.0
    end_run(out)
    yield nothing_runs
    told["after Undo during the run"] = [visible("Smoke"), visible("Smoke_stylized")]

    bpy.context.view_layer.objects.active = bpy.data.objects["Smoke"]
    told["third"] = called(bpy.ops.tnst_mi.stylize)
    yield begun(out, 3)
    bpy.data.objects["Smoke"].hide_viewport = False
    _select("Smoke")
    called(bpy.ops.object.delete)
    end_run(out)
    yield nothing_runs
    yield _soon()
    told["of the deleted one"] = reports()


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
    bpy.context.view_layer.objects.active = bpy.data.objects["Smoke"]
    called(bpy.ops.tnst_mi.stylize)
    yield begun(out, 5)
    told["started"] = [start["arguments"][:2] for start in starts(out)]
    told["running when Blender is quit"] = len(processes(out))
