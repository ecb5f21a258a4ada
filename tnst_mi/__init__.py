"""Transport-based neural style transfer for smoke, on Mitsuba 3, Dr.Jit and PyTorch.

`activate()` selects the Mitsuba variant; every public function calls it if none is active, and puts back one that it
cannot work in. Importing the package imports Mitsuba but no other large dependency: a callback registers the plugins
`emission_absorption` and `camera_views` for each variant as it becomes active, and the public names are imported
on first use.
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

from tnst_mi.errors import InputError
from tnst_mi.machine.address_space import allows_reading, require_address_space
from tnst_mi.machine.notebook_display import show_by
from tnst_mi.resources import VERSION

__version__ = VERSION

if TYPE_CHECKING:
    from tnst_mi.fields.advection import advect
    from tnst_mi.fields.potentials import velocity
    from tnst_mi.frame import Frame
    from tnst_mi.io import load_frames, save_frames
    from tnst_mi.machine.backend import activate
    from tnst_mi.network.googlenet import GoogLeNet
    from tnst_mi.notebook.viewer import view
    from tnst_mi.recipe.recipe import Recipe
    from tnst_mi.reconstruction.reconstruct import Reconstruction, reconstruct
    from tnst_mi.rendering.cameras.camera import Camera
    from tnst_mi.rendering.cameras.views import sample_views
    from tnst_mi.rendering.render import render
    from tnst_mi.run.api import Result, stylize
    from tnst_mi.run.from_model import recipe_of_model
    from tnst_mi.training.train import Training, train

#: Public names and the modules that define them; a module is imported on first use of its name.
_PUBLIC = {
    "Camera": "rendering.cameras.camera",
    "Frame": "frame",
    "GoogLeNet": "network.googlenet",
    "Recipe": "recipe.recipe",
    "Reconstruction": "reconstruction.reconstruct",
    "Result": "run.api",
    "Training": "training.train",
    "activate": "machine.backend",
    "advect": "fields.advection",
    "load_frames": "io",
    "recipe_of_model": "run.from_model",
    "reconstruct": "reconstruction.reconstruct",
    "render": "rendering.render",
    "sample_views": "rendering.cameras.views",
    "save_frames": "io",
    "stylize": "run.api",
    "train": "training.train",
    "velocity": "fields.potentials",
    "view": "notebook.viewer",
}

__all__ = [
    "Camera",
    "Frame",
    "GoogLeNet",
    "InputError",
    "Recipe",
    "Reconstruction",
    "Result",
    "Training",
    "activate",
    "advect",
    "load_frames",
    "recipe_of_model",
    "reconstruct",
    "render",
    "sample_views",
    "save_frames",
    "stylize",
    "train",
    "velocity",
    "view",
]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'tnst_mi' has no attribute {name!r}")
    require_address_space(reading_only=True)
    value = getattr(importlib.import_module(f"tnst_mi.{_PUBLIC[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])


def _register_plugins(old: str | None, new: str | None) -> None:
    importlib.import_module("tnst_mi.rendering.plugins").register()


def _prepare() -> None:
    """Make the choices that must precede the import of Dr.Jit and torch, and register the plugins for each variant."""
    # By default, torch's OpenMP threads spin while they wait and take cores from Dr.Jit's threads, which run in
    # alternation with them, and from other programs: on two shared cores the network took five times as long.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    # Mitsuba imports Dr.Jit, which loads LLVM on import.
    importlib.import_module("tnst_mi.machine.llvm").choose_llvm()
    if "drjit" in sys.modules:
        importlib.import_module("tnst_mi.machine.loaded_llvm").replace_unusable_llvm()
    mi = importlib.import_module("mitsuba")
    importlib.import_module("tnst_mi.machine.forks").prepare_for_forks()
    mi.detail.add_variant_callback(_register_plugins)
    if mi.variant() is not None:
        _register_plugins(None, mi.variant())


def _card(shown: object) -> str:
    return importlib.import_module("tnst_mi.notebook.cards").card(shown)


show_by(_card)

# Without it nothing works, but the command and the public names can say why.
if allows_reading():
    _prepare()
