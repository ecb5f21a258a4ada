"""Where tnst-mi is, and the environment that it runs in: that of the user, without what Houdini adds for itself."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

#: Names the program where the node does not.
PROGRAM = "TNST_MI_PROGRAM"

#: What Houdini sets for its own Python, libraries and USD plugins. Another Python that finds them starts with the wrong
#: standard library, or loads the wrong libraries under the right names.
HOUDINIS_OWN = (
    *("PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP", "PYTHONEXECUTABLE", "PYTHONPLATLIBDIR"),
    *("LD_LIBRARY_PATH", "LD_PRELOAD", "DYLD_LIBRARY_PATH", "DYLD_FRAMEWORK_PATH", "DYLD_INSERT_LIBRARIES"),
    *("PXR_PLUGINPATH_NAME", "QT_PLUGIN_PATH"),
)


class ProgramMissing(Exception):
    """There is no tnst-mi to run; the message is one line with the remedy, made to be shown as it is."""


def process_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment for tnst-mi, from that of Houdini.

    Example:
        >>> process_environment({"PATH": "/opt/hfs/bin:/usr/bin", "HFS": "/opt/hfs", "PYTHONHOME": "/opt/hfs/python"})
        {'PATH': '/usr/bin', 'HFS': '/opt/hfs'}
    """
    kept = {name: value for name, value in environment.items() if name.upper() not in HOUDINIS_OWN}
    if environment.get("HFS"):
        for name in kept:
            if name.upper() == "PATH":
                kept[name] = os.pathsep.join(
                    folder for folder in kept[name].split(os.pathsep) if not _within(folder, environment["HFS"])
                )
    return kept


def find_program(chosen: str, environment: Mapping[str, str]) -> str:
    """The program that is run: the chosen one, or that of $TNST_MI_PROGRAM, or the `tnst-mi` on the PATH.

    Args:
        chosen: a program, or the folder of a Python environment that has it; empty for none.
        environment: that of Houdini.

    Raises:
        ProgramMissing: it is not there. The first that is named is taken: nothing else is looked for then.
    """
    named = chosen or environment.get(PROGRAM, "")
    if not named:
        found = shutil.which("tnst-mi", path=process_environment(environment).get("PATH", ""))
        if found is None:
            raise ProgramMissing(
                "tnst-mi was not found on the PATH; name the program, or the folder of its Python environment, in the "
                f"parameter tnst-mi Program or in ${PROGRAM}"
            )
        return found
    path = Path(named).expanduser()
    for candidate in (path, path / "bin" / "tnst-mi", path / "Scripts" / "tnst-mi.exe"):
        if candidate.is_file():
            if not os.access(candidate, os.X_OK):
                raise ProgramMissing(f"{candidate}: is not a program, expected tnst-mi; choose it in tnst-mi Program")
            return str(candidate)
    raise ProgramMissing(
        f"{named}: no tnst-mi there, expected the program or the folder of the Python environment that it was "
        "installed in (pip install tnst_mi); choose it in tnst-mi Program"
    )


def _within(folder: str, parent: str) -> bool:
    """Whether a folder is another one or below it, by their names."""
    names, above = Path(os.path.normpath(folder)).parts, Path(os.path.normpath(parent)).parts
    return names[: len(above)] == above
