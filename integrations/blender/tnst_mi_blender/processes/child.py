"""How programs are started from Blender: with which environment variables, and without a window of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from .private import is_private

#: For `subprocess`: on Windows, a console that nobody sees.
NO_WINDOW = subprocess.CREATE_NO_WINDOW if sys.platform == "win32" else 0


def variables(program: Path) -> dict[str, str]:
    """The environment variables of a program.

    PYTHONHOME is that of Blender's Python. PYTHONPATH may be what a tnst-mi was set up with, but the private
    environment has all that it needs, and what a studio puts there for its other programs does harm.
    """
    left_out = {"PYTHONHOME", "PYTHONPATH"} if is_private(program) else {"PYTHONHOME"}
    kept = {name: value for name, value in os.environ.items() if name not in left_out}
    # UTF-8 on Windows too, and progress that a status bar can follow: logs have a line each half minute.
    return kept | {"PYTHONUTF8": "1", "TNST_MI_PROGRESS_SECONDS": "1"}
