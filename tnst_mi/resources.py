"""Paths: of the files that come with the package (its data, and the scenes and weights beside it), and of homes."""

from __future__ import annotations

from pathlib import Path

from tnst_mi.errors import InputError

VERSION = "0.1.0"
"""Of the package, which need not be installed to be imported."""

DATA = Path(__file__).resolve().parent / "data"

#: In an installed package, and in a checkout.
_SCENES = (DATA.parent / "scenes", DATA.parents[1] / "scenes")

#: Network weights that several checkouts share, in a folder beside them (it need not exist).
SHARED_WEIGHTS = DATA.parents[2] / "shared" / "weights"


def expanded(path: Path) -> Path:
    """A path with ~ at its start replaced by the home folder; as it is if there is no such home."""
    try:
        return path.expanduser()
    except RuntimeError:
        return path


def scene_file(name: str) -> Path:
    """A bundled scene file, such as "looks/thin.xml".

    Raises:
        InputError: the installation lacks it.
    """
    for scenes in _SCENES:
        if (scenes / name).is_file():
            return scenes / name
    raise InputError(f"{_SCENES[0] / name}: is missing; install the package again")
