"""The files of the private environment: which of the folders in it is complete, and what runs there."""

from __future__ import annotations

import json
import os
from pathlib import Path

#: In the folder of the private environment: names the environment that is complete. See `installer.py`.
MARKER = "environment.json"


def installed_program(private: Path) -> Path | None:
    """`tnst-mi` of the private environment; None if there is none that is complete.

    Args:
        private: its folder, which need not exist.
    """
    try:
        name = json.loads((private / MARKER).read_text("utf-8"))["folder"]
        program = program_in(private / name)
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return program if program.is_file() else None


def program_in(environment: Path) -> Path:
    """Where a virtual environment has `tnst-mi`."""
    return environment / "Scripts" / "tnst-mi.exe" if os.name == "nt" else environment / "bin" / "tnst-mi"


def is_private(program: Path) -> bool:
    """Whether a program is in a private environment."""
    folders = program.parents
    return len(folders) > 2 and (folders[2] / MARKER).is_file()
