"""OptiX, the ray tracer of NVIDIA's driver: on a GPU every Mitsuba scene needs it, and many containers lack it.

Stylizing and rendering by emission–absorption make no scene, and do without.
"""

from __future__ import annotations

import ctypes
import sys

import mitsuba as mi

from tnst_mi.errors import InputError

LIBRARY = "libnvoptix.so.1"

REMEDY = "install it with the driver (in a container, start it with NVIDIA_DRIVER_CAPABILITIES=all)"


def optix_answers() -> bool:
    """Whether Dr.Jit can load OptiX; on Windows every driver has it."""
    if sys.platform == "win32":
        return True
    try:
        ctypes.CDLL(LIBRARY)
    except OSError:
        return False
    return True


def require_optix(what: str) -> None:
    """Check, before a scene is loaded, that it can be traced where the active variant computes.

    Args:
        what: the flag or command that needs the scene.

    Raises:
        InputError: that is a GPU, and OptiX does not answer.
    """
    variant = mi.variant()
    if variant is not None and variant.startswith("cuda") and not optix_answers():
        raise InputError(
            f"{what}: traces paths, which on a GPU needs OptiX, and {LIBRARY} cannot be loaded; {REMEDY}, "
            "or compute on the CPU: CUDA_VISIBLE_DEVICES=-1"
        )
