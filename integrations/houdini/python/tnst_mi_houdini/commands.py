"""Command lines of tnst-mi, for a process of ours and for farms."""

from __future__ import annotations

import shlex
import subprocess
from collections.abc import Sequence

from .environment import HOUDINIS_OWN


def stylize_command(
    program: str, source: str, recipe: str, out: str, cluster: str = "", overwrite: bool = False
) -> list[str]:
    """Stylize a sequence by a recipe file; the results are in OUT/density.

    Args:
        program: `tnst-mi`.
        source: a pattern such as "smoke.####.vdb", a file or a folder.
        recipe: a recipe file (TOML).
        out: a new or empty folder.
        cluster: who does the work, "local:4", "tcp://…" or "slurm:FILE"; empty for this process alone.
        overwrite: replace the run that is in `out`.
    """
    flags = ["--overwrite"] if overwrite else []
    return [program, "stylize", source, "--recipe", recipe, "--out", out, *_cluster(cluster), *flags]


def resume_command(program: str, out: str, cluster: str = "") -> list[str]:
    """Go on with the run in a folder where it was stopped, by its own recipe and input."""
    return [program, "stylize", "--resume", "--out", out, *_cluster(cluster)]


def batch_command(
    program: str, recipes: Sequence[str], sources: Sequence[str], out: str, cluster: str = ""
) -> list[str]:
    """Stylize every source by every recipe, one after the other; the same command goes on where it was stopped."""
    return [program, "batch", *recipes, *sources, "--out", out, *_cluster(cluster)]


def farm_line(command: Sequence[str], windows: bool) -> str:
    """A command as one line for a farm whose processes inherit Houdini's environment, which is taken away first.

    Args:
        command: the program and its arguments.
        windows: whether the line is for cmd.exe, otherwise for a POSIX shell.

    Example:
        >>> line = farm_line(["tnst-mi", "info", "my smoke.####.vdb"], windows=False)
        >>> line.startswith("env -u PYTHONHOME "), line.endswith(" tnst-mi info 'my smoke.####.vdb'")
        (True, True)
    """
    if windows:
        unset = "&& ".join(f'set "{name}="' for name in HOUDINIS_OWN)
        return f'cmd /c "{unset}&& {subprocess.list2cmdline(command)}"'
    return " ".join(["env", *(f"-u {name}" for name in HOUDINIS_OWN), shlex.join(command)])


def _cluster(cluster: str) -> list[str]:
    return ["--cluster", cluster] if cluster else []
