"""Transport-based neural style transfer for smoke, on Mitsuba 3, Dr.Jit and PyTorch.

`activate()` selects the Mitsuba variant; every public function calls it if none is active. Importing the package
imports Mitsuba, whose variants it waits for, and nothing else that is large: the plugins `emission_absorption` and
`orthographic_views` are registered for each variant as it becomes active, and the public names are imported with
their first use.
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

from tnst_mi.errors import InputError
from tnst_mi.machine.llvm import choose_llvm

__version__ = "0.1.0"

if TYPE_CHECKING:
    from tnst_mi.fields.advection import advect
    from tnst_mi.fields.potentials import velocity
    from tnst_mi.frame import Frame
    from tnst_mi.io import load_frames, save_frames
    from tnst_mi.machine.backend import activate
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
    "activate": "machine.backend",
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
    value = getattr(importlib.import_module(f"tnst_mi.{_PUBLIC[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])


def _register_plugins(old: str | None, new: str | None) -> None:
    importlib.import_module("tnst_mi.rendering.plugins").register()


def _prepare() -> None:
    """Decide what must be decided before Dr.Jit or torch are imported, and have the plugins follow the variant."""
    # While torch's OpenMP threads wait they would spin, taking cores from Dr.Jit's threads, with which they alternate,
    # and from other programs: on two shared cores the network took five times as long.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    # Dr.Jit, which Mitsuba imports, loads LLVM while it is imported.
    choose_llvm()
    if "drjit" in sys.modules:
        importlib.import_module("tnst_mi.machine.loaded_llvm").replace_unusable_llvm()
    mi = importlib.import_module("mitsuba")
    mi.detail.add_variant_callback(_register_plugins)
    if mi.variant() is not None:
        _register_plugins(None, mi.variant())


_prepare()
