"""Registers the package's Mitsuba plugins with the active variant.

Types are bound to a variant when a class is created, so the modules are reloaded whenever the variant changes: by the
callback that `import tnst_mi` installs, and from Mitsuba 3.10 on by the `mitsuba` entry point, which names this module.
"""

from __future__ import annotations

import importlib
import sys

import mitsuba as mi

from tnst_mi.machine.loaded_llvm import check_llvm

#: The sensor first: the integrator refers to it.
_MODULES = (
    "tnst_mi.rendering.cameras.sensor",
    "tnst_mi.rendering.march.integrator",
    "tnst_mi.rendering.scattered_light",
)


def register() -> None:
    """Import or reload the plugin modules; does nothing for variants without automatic differentiation."""
    if mi.variant() is None or "_ad_" not in mi.variant():
        return
    if mi.variant().startswith("llvm"):
        check_llvm()
    # Mitsuba reloads the base classes after the callbacks have run, which is too late for ours.
    importlib.reload(mi.ad.integrators.common)
    for name in _MODULES:
        if name in sys.modules:
            importlib.reload(sys.modules[name])
        else:
            importlib.import_module(name)


register()
