"""Lines for a terminal: what files and libraries put into messages neither controls nor floods it."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence

#: Longest error message in characters, whatever paths it names.
LONGEST = 300

#: Longest name in a message, as it is shown.
LONGEST_NAME = 60

_ESCAPE_CODE = re.compile(r"\x1b\[[0-?]*[ -/]*[@-~]")
_FOLDERS = re.compile(r"(?<!\S)([\"'(]?)/(?:[^\s/]+/){2,}")


def printable(text: str) -> str:
    """A text without escape codes of libraries, and with a space for each control character of a name.

    Example:
        >>> printable("smoke\\x1b[31m red\\x07.npz")
        'smoke red .npz'
    """
    # Bytes of file names that are not UTF-8 are surrogates here, which no stream can write.
    text = _ESCAPE_CODE.sub("", text.encode("utf-8", "replace").decode("utf-8"))
    return "".join(character if character.isprintable() else " " for character in text)


def quoted(name: str, most: int = LONGEST_NAME) -> str:
    """A name that a file has for something, in quotes, with at most so many characters after escaping.

    Example:
        >>> quoted("density"), quoted("a name\\n that is far too long", 16)
        ("'density'", "'a name\\\\n tha…'")
    """
    # What cannot be printed becomes up to ten characters.
    shown, kept = repr(name), name[:most]
    while len(shown) > most:
        kept = kept[:-1]
        shown = f"{repr(kept)[:-1]}…{repr(kept)[-1]}"
    return shown


def shortened(text: str, most: int = LONGEST_NAME) -> str:
    """The start of a word that a file has for something, with at most so many characters.

    Example:
        >>> shortened("float"), shortened("a word that is far too long", 12)
        ('float', 'a word that…')
    """
    return text if len(text) <= most else f"{text[: most - 1]}…"


def some_of(texts: Sequence[str], most: int = 3) -> str:
    """The first of some texts, and how many more there are.

    Example:
        >>> some_of(["a", "b", "c", "d", "e"])
        'a, b, c and 2 more'
    """
    rest = len(texts) - most
    return ", ".join(texts[:most]) + (f" and {rest} more" if rest > 0 else "")


def displayable(name: str) -> str:
    """A file name with a replacement for each byte that is not UTF-8, so that results and records can have it."""
    return os.fsencode(name).decode("utf-8", "replace")


def amount(size: int) -> str:
    """A number of bytes with three digits, in the unit that suits it.

    Example:
        >>> amount(1_234_567_890), amount(1_050_000), amount(0)
        ('1.23 GB', '1.05 MB', '0 MB')
    """
    return f"{size / 1e9:.3g} GB" if size >= 1e9 else f"{size / 1e6:.3g} MB"


def one_line(message: str) -> str:
    """A message in one line of at most `LONGEST` characters: paths lose their folders first, then the text its middle.

    Example:
        >>> one_line("/" + "folder/" * 50 + "smoke.npz: is empty")
        '…/smoke.npz: is empty'
    """
    line = " ".join(printable(message).split())
    if len(line) > LONGEST:
        line = _FOLDERS.sub(r"\1…/", line)
    if len(line) > LONGEST:
        kept = (LONGEST - 1) // 2
        line = f"{line[:kept]}…{line[-kept:]}"
    return line


def duration(seconds: float) -> str:
    """A time in the units that suit it, to the second above a minute.

    Example:
        >>> duration(0.32), duration(42.4), duration(135), duration(7300)
        ('0.3 s', '42 s', '2 min 15 s', '2 h 1 min')
    """
    if seconds < 60:
        return f"{seconds:.1f} s" if seconds < 9.95 else f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
