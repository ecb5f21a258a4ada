"""Python programs on this machine: the one that Blender brings, and those that can hold tnst-mi."""

from __future__ import annotations

import functools
import shutil
import subprocess
import sys
from pathlib import Path

#: The oldest Python that tnst-mi runs on.
OLDEST = (3, 11)

#: Programs on the PATH that may be Python, first the one that tnst-mi is tested with.
_NAMES = ("python3.11", "python3.12", "python3.13", "python3", "python")

#: Makes a virtual environment with pip, or fails: distributions split both from Python.
_CHECK = f"import sys, venv, ensurepip; sys.exit(sys.version_info < {OLDEST})"

#: Seconds in which a Python answers, on a slow disk too.
_PATIENCE = 30.0


def own_python() -> Path | None:
    """Blender's own Python as a program of its own; None where Blender comes without one."""
    program = Path(sys.executable or "")
    return program if program.name.lower().startswith("python") and program.is_file() else None


def any_python() -> Path | None:
    """A Python of whatever version, Blender's own if it has one; None if there is none."""
    found = own_python()
    return found if found is not None else next(iter(_on_path()), None)


@functools.cache
def environment_python() -> Path | None:
    """A Python that can make the environment of tnst-mi, Blender's own if it can; None if there is none.

    It asks each of them, which takes a fraction of a second each.
    """
    own = own_python()
    return next((python for python in [*([own] if own else []), *_on_path()] if _makes_environments(python)), None)


def _on_path() -> list[Path]:
    return [Path(found) for name in _NAMES if (found := shutil.which(name)) is not None]


def _makes_environments(python: Path) -> bool:
    try:
        ran = subprocess.run([python, "-I", "-c", _CHECK], capture_output=True, timeout=_PATIENCE, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return ran.returncode == 0
