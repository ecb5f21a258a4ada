"""The gate for damaged files: whatever a library raises or prints becomes one line that names the file."""

from __future__ import annotations

import errno
import lzma
import os
import struct
from pathlib import Path

import pytest

from tnst_mi.errors import InputError
from tnst_mi.machine.gate import gate, opening, silenced


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (lzma.LZMAError("Corrupt input data"), "a.npz: not an npz file, truncated, or damaged (Corrupt input data)"),
        (RecursionError(), "damaged (RecursionError)"),
        (struct.error("unpack requires\na buffer"), "damaged (unpack requires a buffer)"),
        (KeyError("x"), "damaged ('x')"),
        (OSError("Not a gzipped file"), "damaged (Not a gzipped file)"),
        (OSError(errno.ENAMETOOLONG, "File name too long"), "a.npz: cannot be read (File name too long)"),
        (MemoryError(), "a.npz: takes more memory than there is"),
        (FileNotFoundError(errno.ENOENT, "No such file"), "a.npz: no such file"),
        (PermissionError(errno.EACCES, "Permission denied"), "a.npz: cannot be read (no permission)"),
        (ValueError("\x1b[31m\x00" + "\\x00" * 50_000), "a.npz: not an npz file"),
        (InputError("a.npz: array '" + "n\x07" * 50_000), "a.npz: array 'n n"),
        (InputError("a.npz: density has 3 NaN"), "a.npz: density has 3 NaN"),
    ],
)
def test_one_line(error: Exception, words: str) -> None:
    with pytest.raises(InputError) as caught, gate(Path("a.npz"), "an npz file"):
        raise error
    message = str(caught.value)
    assert words in message and len(message) <= 300 and message.isprintable()


@pytest.mark.parametrize("error", [KeyboardInterrupt(), SystemExit(2)])
def test_interruptions_pass(error: BaseException) -> None:
    with pytest.raises(type(error)), gate(Path("a.npz"), "an npz file"):
        raise error


def test_the_cause_is_kept_for_debugging() -> None:
    cause = lzma.LZMAError("bad")
    with pytest.raises(InputError) as caught, gate(Path("a.npz"), "an npz file"):
        raise cause
    assert caught.value.__cause__ is cause


def test_a_path_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"), opening(tmp_path / ("n" * 5000), "an npz file"):
        pass


def test_what_libraries_print_is_dropped(capfd: pytest.CaptureFixture[str]) -> None:
    with silenced():
        os.write(2, b"library: corrupt\n")
    os.write(2, b"ours\n")
    assert capfd.readouterr().err == "ours\n"
