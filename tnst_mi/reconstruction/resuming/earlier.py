"""What an earlier reconstruction has left in a folder: with --overwrite, nothing of it stays among the new results."""

from __future__ import annotations

import re
from pathlib import Path

from tnst_mi.io.formats import FORMATS, files_around
from tnst_mi.reconstruction.resuming.records import frame_name

#: What the names of a frame's files begin with.
_OURS = re.compile(rf"{frame_name(None)}(_\d{{4,}})?[._]")


def remove_earlier(out: Path, state: Path) -> None:
    """Remove the densities and the pictures of all frames, and what was told of them.

    Where there is no state, there was no reconstruction, and nothing is touched. The state itself goes last: as long as
    it is there, what a killed process has left is found again.

    Args:
        out: folder of the results.
        state: file of the state.

    Raises:
        OSError: something cannot be removed.
    """
    if not state.is_file():
        return
    files = [out / "report.json", out / "report.html"]
    for folder in ("density", "images"):
        ours = [file for file in (out / folder).glob("*") if _OURS.match(file.name)]
        beside = [near for file in ours if file.suffix in FORMATS for near in files_around(file)]
        files += [*ours, *beside]
    for file in (*files, state):
        file.unlink(missing_ok=True)
