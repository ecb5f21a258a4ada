"""Runs scripts inside Blender, a program beside this one with a Python of its own."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

from tnst_mi.errors import InputError

#: Of lines without an end, which broken files make Blender print, as much is shown.
_LONGEST = 1000


def require_blender(program: str = "blender") -> str:
    """The path of a program that is Blender.

    Raises:
        InputError: there is none.
    """
    found = shutil.which(program)
    if found is None:
        raise InputError(f"no program {program}: install Blender (apt-get install blender), or put it on the PATH")
    return found


def run_in_blender(
    script: Path, arguments: Sequence[str], said: Callable[[str], object], program: str = "blender"
) -> int:
    """Run a Python script inside Blender, without a window and with the settings of a new installation.

    Args:
        script: the file; its arguments follow "--" in `sys.argv`.
        arguments: of the script.
        said: called with each line that Blender or the script prints, less the progress of renders.
        program: Blender.

    Returns:
        The exit code; a script has to end Blender by `sys.exit` to set it.

    Raises:
        InputError: there is no such program.
    """
    command = [require_blender(program), "--background", "--factory-startup", "--python", str(script), "--"]
    with subprocess.Popen(
        [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    ) as process:
        assert process.stdout is not None
        output, fresh = process.stdout, True
        for piece in iter(lambda: output.readline(_LONGEST), ""):
            if fresh and not piece.startswith("Fra:"):
                said(piece.rstrip())
            fresh = piece.endswith("\n")
    return process.returncode
