"""OptiX, the ray tracer in NVIDIA's driver: on a GPU, every Mitsuba scene needs it, and many containers lack it.

Stylization and rendering with emission–absorption create no scene and do not need it.
"""

from __future__ import annotations

import ctypes
import sys

from tnst_mi.errors import InputError
from tnst_mi.machine.backend import on_gpu

LIBRARY = "libnvoptix.so.1"

REMEDY = "install it with the driver (in a container, start it with NVIDIA_DRIVER_CAPABILITIES=all)"


def optix_answers() -> bool:
    """Whether Dr.Jit can load OptiX; on Windows every driver includes it."""
    if sys.platform == "win32":
        return True
    try:
        ctypes.CDLL(LIBRARY)
    except OSError:
        return False
    return True


def require_optix(what: str) -> None:
    """Check, before a scene is loaded, that the active variant can trace it.

    Args:
        what: the flag or command that needs the scene.

    Raises:
        InputError: the variant runs on a GPU, and OptiX cannot be loaded.
    """
    if on_gpu() and not optix_answers():
        raise InputError(
            f"{what}: traces paths, which on a GPU needs OptiX, and {LIBRARY} cannot be loaded; {REMEDY}, "
            "or compute on the CPU: CUDA_VISIBLE_DEVICES=-1"
        )
