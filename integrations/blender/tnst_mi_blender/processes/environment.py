"""The Python environment that tnst-mi runs in, which is never Blender's own: found, checked, installed."""

from __future__ import annotations

import functools
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from ..version import VERSION
from .child import NO_WINDOW, variables
from .job import Job
from .private import MARKER, installed_program, program_in
from .progress import InstallationReader
from .pythons import OLDEST, environment_python

#: What other programs set to say which tnst-mi is meant.
VARIABLE = "TNST_MI_PROGRAM"

#: What the zip of the add-on carries: the wheel of tnst_mi, and the versions of packages that it was tested with.
CARRIED = Path(__file__).parents[1] / "carried"

_INSTALLER = Path(__file__).with_name("installer.py")

#: Seconds in which `tnst-mi --version` answers, on a slow disk and the first time.
_PATIENCE = 60.0


class EnvironmentMissing(Exception):
    """There is no tnst-mi that can be used; the message is one line with the remedy, made to be shown as it is."""


@dataclass(frozen=True)
class Environment:
    """A tnst-mi that can be run.

    Attributes:
        program: path of `tnst-mi`.
        origin: where it was found, for the preferences: "preferences", "$TNST_MI_PROGRAM", "PATH" or "private".
        version: what `tnst-mi --version` says.
    """

    program: Path
    origin: str
    version: str


def find_environment(chosen: str, private: Path) -> Environment:
    """The environment that is used: the program chosen, or $TNST_MI_PROGRAM, or on the PATH, or the private one.

    One that was named is taken or refused. One on the PATH, which may be there for something else, gives way to a
    private one if it has another version. Checking takes up to a few seconds. That a program can be used is remembered
    as long as its file does not change, or until `forget_checks`; what cannot be is asked again each time, since what
    mends it may be any of its packages.

    Args:
        chosen: `tnst-mi` as the preferences name it, a file or the folder of an environment; empty for none.
        private: the folder of the private environment, which need not exist.

    Raises:
        EnvironmentMissing: there is none, it does not start, or has another version.
    """
    for named, origin in ((chosen.strip(), "preferences"), (os.environ.get(VARIABLE, ""), f"${VARIABLE}")):
        if named:
            return _checked(_named(named, origin), origin)
    on_path, installed = shutil.which("tnst-mi"), installed_program(private)
    problem = None
    for program, origin in ((on_path, "PATH"), (installed, "private")):
        if program is not None:
            try:
                return _checked(Path(program), origin)
            except EnvironmentMissing as error:
                problem = problem or error
    raise problem or EnvironmentMissing(
        "tnst-mi is not installed: press Install in the preferences of the add-on, or name the tnst-mi of an "
        "environment there"
    )


def forget_checks() -> None:
    """Have every program asked again, also those that could be used."""
    _require_usable.cache_clear()


def _named(text: str, origin: str) -> Path:
    """The program that a file, the folder of an environment, or a name on the PATH means."""
    path = Path(text).expanduser()
    found = shutil.which(text)
    for program in (path, program_in(path), Path(found) if found else None):
        if program is not None and program.is_file():
            return program.absolute()
    raise EnvironmentMissing(f"{text} ({origin}): no such program, expected tnst-mi or the folder of its environment")


def _checked(program: Path, origin: str) -> Environment:
    try:
        status = program.stat()
    except OSError as error:
        raise EnvironmentMissing(f"{program} ({origin}): cannot be read ({error.strerror})") from None
    _require_usable(program, origin, status.st_mtime_ns)
    return Environment(program, origin, VERSION)


@functools.lru_cache(maxsize=16)  # which remembers nothing of what is refused
def _require_usable(program: Path, origin: str, _changed: int) -> None:
    version = _version(program)
    if version is None:
        raise EnvironmentMissing(
            f"{program} ({origin}): does not start as tnst-mi; run {program} --version in a terminal to see why, or "
            "install the environment again in the preferences of the add-on"
        )
    if version != VERSION:
        raise EnvironmentMissing(
            f"{program} ({origin}): is tnst-mi {version}, and this add-on is of {VERSION}; install an environment in "
            "the preferences of the add-on, or the add-on of that version"
        )


def _version(program: Path) -> str | None:
    """What a program says that its version is; None if it does not say so as tnst-mi does."""
    try:
        ran = subprocess.run(
            [program, "--version"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            env=variables(program),
            timeout=_PATIENCE,
            check=False,
            creationflags=NO_WINDOW,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    name, _, version = ran.stdout.decode("utf-8", "replace").strip().partition(" ")
    return version if ran.returncode == 0 and name == "tnst-mi" else None


class Installation(Job):
    """Makes the private environment: a virtual environment with tnst-mi in it.

    One that is there is used until the new one is complete, and then removed, so that nothing should run in it. An
    interrupted one is never taken for an environment; the next installation removes it. What turns out to have another
    version than the add-on fails, and leaves the earlier environment.

    Args:
        private: its folder.
        log: see `Job`.
        checkout: a checkout of tnst_mi to install; None for the wheel that the add-on carries.

    Raises:
        EnvironmentMissing: there is no Python that can make one, no wheel, or no such checkout.
    """

    def __init__(self, private: Path, log: Path, checkout: Path | None = None) -> None:
        source, constraints = _carried() if checkout is None else _of_checkout(checkout)
        python = environment_python()
        if python is None:
            raise EnvironmentMissing(
                f"there is no Python {OLDEST[0]}.{OLDEST[1]} or newer with venv and pip: install one and put it on the "
                "PATH (Debian and Ubuntu: apt-get install python3-venv; otherwise from python.org)"
            )
        command = (python, "-I", _INSTALLER, private, MARKER, VERSION, source, constraints)
        super().__init__([str(each) for each in command], log)

    def _new_reader(self) -> InstallationReader:
        return InstallationReader()

    def _is_complaint(self, line: str) -> bool:
        return line.startswith(("ERROR: ", "Error: ", "tnst-mi: "))


def _carried() -> tuple[Path, Path]:
    wheels = sorted(CARRIED.glob("tnst_mi-*.whl"))
    if not wheels:
        raise EnvironmentMissing(
            "this add-on was built without the wheel of tnst_mi: name a checkout of tnst_mi in the preferences of the "
            "add-on, or the tnst-mi of an environment"
        )
    return wheels[-1], CARRIED / "constraints.txt"


def _of_checkout(checkout: Path) -> tuple[Path, Path]:
    constraints = checkout / "constraints.txt"
    if not (constraints.is_file() and (checkout / "pyproject.toml").is_file()):
        raise EnvironmentMissing(f"{checkout}: is no checkout of tnst_mi, expected pyproject.toml and constraints.txt")
    return checkout, constraints
