"""tnst_mi in Blender: smoke of volumes and fluid domains is stylized by `tnst-mi`, which runs beside Blender."""

from __future__ import annotations

from .interface import last_run, lists, panel, preferences, run_operators, running, settings, thumbnails

bl_info = {
    "name": "tnst_mi: stylized smoke",
    "author": "The tnst_mi contributors",
    "version": (0, 1, 0),
    "blender": (3, 4, 0),
    "location": "3D View > Sidebar > Stylize; properties of volumes and of fluid domains",
    "description": "Stylize smoke and fire by pictures and motifs, by transporting it",
    "category": "Physics",
}

_MODULES = (preferences, settings, last_run, lists, running, run_operators, panel, thumbnails)


def register() -> None:
    """Called by Blender when the add-on is switched on."""
    for module in _MODULES:
        module.register()


def unregister() -> None:
    """Called by Blender when it is switched off; what runs is ended."""
    for module in reversed(_MODULES):
        module.unregister()
