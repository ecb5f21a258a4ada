"""The gate for damaged files: whatever a library raises or prints becomes one line that names the file."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import io
import lzma
import os
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from tnst_mi.errors import InputError, UnforeseenError
from tnst_mi.losses.pictures import read_image
from tnst_mi.machine.gate import decoding, gate, opening, silenced


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (
            lzma.LZMAError("Corrupt input data"),
            "a.npz: not an npz file, truncated, or damaged (Corrupt input data); save or copy it again",
        ),
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
    with pytest.raises(InputError) as caught, decoding(Path("a.npz"), "an npz file"):
        raise error
    message = str(caught.value)
    assert words in message and len(message) <= 300 and message.isprintable()


@pytest.mark.parametrize("error", [KeyboardInterrupt(), SystemExit(2)])
def test_interruptions_pass(error: BaseException) -> None:
    with pytest.raises(type(error)), gate(Path("a.npz"), "an npz file"):
        raise error


def test_the_cause_is_kept_for_debugging() -> None:
    cause = lzma.LZMAError("bad")
    for guard in (gate, decoding):
        with pytest.raises(InputError) as caught, guard(Path("a.npz"), "an npz file"):
            raise cause
        assert caught.value.__cause__ is cause


def test_what_our_own_code_raises_is_not_called_damage() -> None:
    with pytest.raises(UnforeseenError) as caught, gate(Path("a.npz"), "an npz file"):
        raise IndexError("list index out of range\n" * 100)
    message = str(caught.value)
    assert message.startswith("a.npz: cannot be used as an npz file (IndexError: list index") and len(message) <= 300
    assert "damaged" not in message and "--debug" in message


def test_the_file_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"b\.uni: no such file"), gate(Path("a.npz"), "an npz file"):
        (tmp_path / "b.uni").read_bytes()


def test_a_path_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"), opening(tmp_path / ("n" * 5000), "an npz file"):
        pass


def test_what_libraries_print_is_dropped(capfd: pytest.CaptureFixture[str]) -> None:
    with silenced():
        os.write(2, b"library: corrupt\n")
        print("library in Python: corrupt")
        ctypes.CDLL(None).puts(b"library in C: corrupt")
    os.write(1, b"ours\n")
    os.write(2, b"ours too\n")
    assert capfd.readouterr() == ("ours\n", "ours too\n")


def test_streams_that_are_closed_or_used_by_several_threads() -> None:
    """In a process of its own, as it takes the streams away."""
    script = """
import os, sys, threading
from tnst_mi.machine.gate import silenced
def often():
    for _ in range(50):
        with silenced():
            os.write(2, b"library")
before = os.readlink("/proc/self/fd/2"), len(os.listdir("/proc/self/fd"))
threads = [threading.Thread(target=often) for _ in range(4)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
assert (os.readlink("/proc/self/fd/2"), len(os.listdir("/proc/self/fd"))) == before
os.close(2)
sys.stderr = None
with silenced():
    pass
assert not os.path.exists("/proc/self/fd/2")
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


class WithoutFlush:
    """What a host may put in the place of stdout."""

    def write(self, text: str) -> int:
        return len(text)


def test_a_stream_that_cannot_be_flushed_is_no_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is closed, has none of it, or lost its reader."""
    Image.new("RGB", (4, 4), "red").save(tmp_path / "p.png")
    closed = io.StringIO()
    closed.close()
    end, start = os.pipe()
    os.close(end)
    left = os.fdopen(start, "w")
    left.write("ours")
    for stream in (closed, WithoutFlush(), left, None):
        monkeypatch.setattr("sys.stdout", stream)
        assert read_image(tmp_path / "p.png").grey.shape == (4, 4)
    # What it kept is still to be written, and that fails where it is.
    with pytest.raises(BrokenPipeError):
        left.flush()
    with contextlib.suppress(BrokenPipeError):
        left.close()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks on this system")
def test_silence_within_silence_and_forks_within_it() -> None:
    """In a process of its own, which a lock that knows no owner would hang."""
    script = """
import os
from tnst_mi.machine.gate import silenced
with silenced():
    with silenced():
        os.write(1, b"library")
    os.write(1, b"library")
    child = os.fork()
    if child == 0:
        os.write(1, b"library")
if child == 0:
    with silenced():
        os.write(1, b"library")
    os.write(1, b"child ")
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
with silenced():
    pass
os.write(1, b"parent")
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "child parent", "")
