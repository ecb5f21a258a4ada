"""The Python environment that tnst-mi runs in, which is never Blender's own: found, checked, installed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from .job import Job


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

    The first that is named is taken, and has to be of the add-on's version. Checking takes up to a few seconds the
    first time, and is remembered as long as the program does not change.

    Args:
        chosen: `tnst-mi` as the preferences name it, a file or the folder of an environment; empty for none.
        private: the folder of the private environment, which need not exist.

    Raises:
        EnvironmentMissing: there is none, it does not start, or has another version.
    """
    raise NotImplementedError


class Installation(Job):
    """Makes the private environment: a virtual environment with tnst-mi in it. One that is there is used until the
    new one is complete, and an interrupted one is never taken for an environment.

    Args:
        private: its folder.
        log: see `Job`.
        checkout: a checkout of tnst_mi to install; None for the wheel that the add-on carries.

    Raises:
        EnvironmentMissing: there is no Python that can make one, no wheel, or no such checkout.
    """

    def __init__(self, private: Path, log: Path, checkout: Path | None = None) -> None:
        super().__init__([], log)
