"""How programs are started from Houdini: with the user's environment variables, and without a window of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

#: For `subprocess`: on Windows, a console that nobody sees.
NO_WINDOW = subprocess.CREATE_NO_WINDOW if sys.platform == "win32" else 0

#: Lists of files and folders, to which Houdini adds its own: another Python that finds these loads the wrong libraries
#: under the right names.
LISTS = (
    *("PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "LD_PRELOAD", "PXR_PLUGINPATH_NAME", "QT_PLUGIN_PATH"),
    *("DYLD_LIBRARY_PATH", "DYLD_FRAMEWORK_PATH", "DYLD_INSERT_LIBRARIES"),
)

#: What is of Houdini's Python alone.
PYTHONS = ("PYTHONHOME", "PYTHONEXECUTABLE", "PYTHONPLATLIBDIR")

#: Where this package is, which is of no use to others.
_PACKAGES = str(Path(__file__).resolve().parents[1])


def variables(program: Path) -> dict[str, str]:
    """The environment variables of a program: those of the user, whichever it is."""
    # UTF-8 on Windows too, and progress that a status line can follow: logs have a line each half minute.
    return users_own(os.environ) | {"PYTHONUTF8": "1", "TNST_MI_PROGRESS_SECONDS": "1"}


def users_own(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment of the user, from that of Houdini: without its Python, and its entries in lists.

    Example:
        >>> users_own({"PATH": "/opt/hfs/bin:/usr/bin", "HFS": "/opt/hfs", "PYTHONHOME": "/opt/hfs/python"})
        {'PATH': '/usr/bin', 'HFS': '/opt/hfs'}
    """
    houdinis = [folder for folder in (environment.get("HFS"), _PACKAGES) if folder]
    kept = {}
    for name, value in environment.items():
        if name.upper() in PYTHONS:
            continue
        if name.upper() in LISTS:
            # The entries of LD_PRELOAD may be separated by spaces too.
            entries = value.replace(" ", os.pathsep) if name == "LD_PRELOAD" else value
            left = [entry for entry in entries.split(os.pathsep) if not any(_within(entry, each) for each in houdinis)]
            if len(left) < len(entries.split(os.pathsep)):
                value = os.pathsep.join(left)
                if not value:
                    continue
        kept[name] = value
    return kept


def _within(path: str, parent: str) -> bool:
    """Whether a path is another one or below it, by their names."""
    names, above = (Path(os.path.normcase(os.path.normpath(each))).parts for each in (path, parent))
    return names[: len(above)] == above
