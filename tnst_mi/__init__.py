"""Transport-based neural style transfer for smoke, on Mitsuba 3, Dr.Jit and PyTorch.

`activate()` selects the Mitsuba variant; every public function calls it if none is active. Importing the package
touches no Mitsuba type: the plugins `emission_absorption` and `orthographic_views` are registered for each variant
as it becomes active.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from tnst_mi.errors import InputError
from tnst_mi.machine.backend import activate, let_idle_threads_sleep, select_llvm

__version__ = "0.1.0"

if TYPE_CHECKING:
    from tnst_mi.fields.advection import advect
    from tnst_mi.fields.potentials import velocity
    from tnst_mi.frame import Frame
    from tnst_mi.io import load_frames, save_frames
    from tnst_mi.network.googlenet import GoogLeNet
    from tnst_mi.recipe.recipe import Recipe
    from tnst_mi.rendering.cameras.views import sample_views
    from tnst_mi.rendering.renderer import render
    from tnst_mi.run.api import Result, stylize

#: Public names and the modules they live in; a module is imported at the first use of its name.
_PUBLIC = {
    "Frame": "frame",
    "GoogLeNet": "network.googlenet",
    "Recipe": "recipe.recipe",
    "Result": "run.api",
    "advect": "fields.advection",
    "load_frames": "io",
    "render": "rendering.renderer",
    "sample_views": "rendering.cameras.views",
    "save_frames": "io",
    "stylize": "run.api",
    "velocity": "fields.potentials",
}

__all__ = [
    "Frame",
    "GoogLeNet",
    "InputError",
    "Recipe",
    "Result",
    "activate",
    "advect",
    "load_frames",
    "render",
    "sample_views",
    "save_frames",
    "stylize",
    "velocity",
]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'tnst_mi' has no attribute {name!r}")
    # The field and Mitsuba modules need an active variant when they are imported.
    if _PUBLIC[name] in ("advection", "potentials", "renderer"):
        activate()
    value = getattr(importlib.import_module(f"tnst_mi.{_PUBLIC[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])


def _register_plugins(old: str | None, new: str | None) -> None:
    importlib.import_module("tnst_mi.rendering.plugins").register()


def _install_plugins() -> None:
    """Have the plugins registered now, if a variant is active, and at each change of the variant."""
    # Dr.Jit, which Mitsuba imports, loads LLVM while it is imported.
    select_llvm()
    let_idle_threads_sleep()
    mi = importlib.import_module("mitsuba")
    mi.detail.add_variant_callback(_register_plugins)
    if mi.variant() is not None:
        _register_plugins(None, mi.variant())


_install_plugins()
