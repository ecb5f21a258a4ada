"""A Blender with a window, on an X server without a screen, of which nothing is left in the end."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

#: Is in the environment of all that is started here, and of what that starts.
MARK = "TNST_MI_WINDOW_TEST"

#: Seconds that a walk may take on a busy machine.
PATIENCE = 240


@contextmanager
def screen() -> Iterator[str]:
    """An X server; the value is its DISPLAY. It also ends by itself, when its last window is closed."""
    reading, writing = os.pipe()
    command = ["Xvfb", "-displayfd", str(writing), "-terminate", "-nolisten", "tcp", "-screen", "0", "1280x960x24"]
    with subprocess.Popen(command, pass_fds=[writing], stderr=subprocess.DEVNULL) as server:
        os.close(writing)
        try:
            with os.fdopen(reading) as told:
                number = told.readline().strip()
            assert number, "Xvfb has not started"
            yield f":{number}"
        finally:
            server.terminate()


def run(arguments: Sequence[str], user: Path, mark: str, display: str | None = None, **variables: str) -> str:
    """Run Blender to its end and return what it has printed; of what it has started, nothing is killed.

    Args:
        arguments: its own.
        user: folder of its users' settings and scripts.
        mark: value of `MARK`.
        display: the X server; None for a Blender without a window.
        variables: of its environment.
    """
    environment = {name: value for name, value in os.environ.items() if name not in ("TNST_MI_PROGRAM", "PYTHONPATH")}
    environment |= {MARK: mark, "LIBGL_ALWAYS_SOFTWARE": "1", "TMPDIR": str(user), **variables}
    for name in ("RESOURCES", "CONFIG", "SCRIPTS", "DATAFILES", "EXTENSIONS"):
        folder = user / name.lower()
        folder.mkdir(parents=True, exist_ok=True)
        environment[f"BLENDER_USER_{name}"] = str(folder)
    if display is not None:
        environment["DISPLAY"] = display
    blender = shutil.which("blender")
    assert blender is not None
    ran = subprocess.run(
        [blender, *arguments],
        cwd=user,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        timeout=PATIENCE,
        check=False,
    )
    return ran.stdout


def marked(mark: str) -> list[psutil.Process]:
    """What runs of all that was started with a mark."""
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            if process.environ().get(MARK) == mark and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found
