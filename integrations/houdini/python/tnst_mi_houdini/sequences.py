"""Names of numbered files: as Houdini writes them ($F4), as tnst-mi reads them (####), and of one frame."""

from __future__ import annotations

import re
from collections.abc import Callable

# Houdini's variable of the whole frame: $F, $F4, ${F4}; <F4> in its file choosers. $FF (with fractions), $FSTART, $FEND
# and $FPS are others. After a name without braces Houdini reads on, so that $F4_a is none of ours.
_VARIABLE = re.compile(r"\$\{F(?P<braced>\d?)\}|<F(?P<chosen>\d?)>|\$F(?P<plain>\d?)(?![A-Za-z0-9_])")


class NoFrameNumber(ValueError):
    """A name does not say where the number of the frame is; the message is one line with the remedy."""


def frame_pattern(path: str) -> str:
    """The name of a sequence as tnst-mi reads it, from Houdini's.

    Raises:
        NoFrameNumber: it has no variable of the frame, or several.

    Example:
        >>> frame_pattern("/shot/smoke.$F4.vdb"), frame_pattern("/shot/smoke_${F}.vdb")
        ('/shot/smoke.####.vdb', '/shot/smoke_#.vdb')
    """
    return _replaced(path, lambda digits: "#" * max(digits, 1))


def frame_file(path: str, frame: int) -> str:
    """The name of the file of one frame, from Houdini's name of the sequence.

    Raises:
        NoFrameNumber: as `frame_pattern`.

    Example:
        >>> frame_file("/shot/smoke.$F4.vdb", 12)
        '/shot/smoke.0012.vdb'
    """
    return _replaced(path, lambda digits: f"{frame:0{digits}d}" if digits else str(frame))


def _replaced(path: str, number: Callable[[int], str]) -> str:
    """The path with what `number` makes of the digits of its only variable, 0 for none."""
    found = list(_VARIABLE.finditer(path))
    if len(found) != 1:
        raise NoFrameNumber(
            f"{path}: {'no' if not found else 'more than one'} number of the frame, expected one $F4 or ${{F4}}, as in "
            "smoke.$F4.vdb"
        )
    digits = next((group for group in found[0].groups() if group is not None), "")
    return path[: found[0].start()] + number(int(digits or 0)) + path[found[0].end() :]
