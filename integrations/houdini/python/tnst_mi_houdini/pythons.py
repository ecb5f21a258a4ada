"""A Python for the process that watches over tnst-mi: Houdini's own as a program of its own, or one on the PATH."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

#: On the PATH, where python3 may be too old: 3.10 is needed.
_NAMES = ("python3.13", "python3.12", "python3.11", "python3.10", "python3", "python")


def any_python() -> Path | None:
    """A Python; None if there is none."""
    # sys.executable may be Houdini itself.
    folder, version = Path(sys.base_prefix), f"{sys.version_info[0]}.{sys.version_info[1]}"
    own = [folder / "bin" / f"python{version}", folder / "bin" / "python3", folder / "python.exe"]
    if Path(sys.executable or "").name.lower().startswith("python"):
        own.insert(0, Path(sys.executable))
    on_path = [Path(found) for name in _NAMES if (found := shutil.which(name)) is not None]
    return next((python for python in [*own, *on_path] if python.is_file()), None)
