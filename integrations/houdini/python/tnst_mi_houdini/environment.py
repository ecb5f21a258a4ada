"""Where tnst-mi is."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from .child import users_own

#: Names the program where the node does not.
PROGRAM = "TNST_MI_PROGRAM"


class ProgramMissing(Exception):
    """There is no tnst-mi to run; the message is one line with the remedy, made to be shown as it is."""


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
        found = shutil.which("tnst-mi", path=users_own(environment).get("PATH", ""))
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
