"""Makes the private environment: a virtual environment with tnst-mi in it. Run as a process of its own.

    python installer.py PRIVATE MARKER VERSION SOURCE CONSTRAINTS

SOURCE is a wheel or a checkout, which has to be of VERSION. Each installation makes a folder of its own in PRIVATE, and
stays there, since environments hold their own paths. The marker, which names the folder that is complete, is written
last: an earlier environment is used until then, and an interrupted one never is. There is one installation at a time.

Exit codes: 0 done, 1 failed, 3 interrupted.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

_PREFIX = "env-"

#: Holds the system's lock of who installs, which ends with that process. The file stays.
_LOCK = ".lock"

#: Bytes that an environment takes, with a torch for CPUs. One with CUDA takes several times as much.
_NEEDED = 2 * 10**9

#: Bytes that are written to find out whether the disk has room at all.
_PROBE = 1 << 20


class _Failed(Exception):
    """What was wrong and the remedy, in one line; empty if it has been said already."""


def main(private: Path, marker: str, version: str, source: Path, constraints: Path) -> int:
    """Make the environment."""
    try:
        private.mkdir(parents=True, exist_ok=True)
        with (private / _LOCK).open("ab") as lock:
            _take(lock, private)
            return _replace(private, private / marker, version, source, constraints)
    except KeyboardInterrupt:
        return 3
    except _Failed as error:
        problem = str(error)
    except OSError as error:
        problem = f"{error.filename or private}: {error.strerror}"
    if problem:
        print(f"ERROR: {problem}", flush=True)
    return 1


def _replace(private: Path, marker: Path, version: str, source: Path, constraints: Path) -> int:
    """Make an environment, and remove whatever the marker does not name then, which may be that environment."""
    _remove_others(private, _complete(marker))
    _require_space(private)
    folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=private))
    try:
        _install(folder, version, source, constraints)
        _write(marker, folder.name)
    except KeyboardInterrupt:
        if _complete(marker) != folder.name:  # else it came after the last step
            raise
    except subprocess.CalledProcessError as error:
        _require_room(folder)
        raise _Failed from error  # pip and venv say themselves what is wrong
    finally:
        # One that is interrupted is completed by the next installation.
        with suppress(KeyboardInterrupt):
            _remove_others(private, _complete(marker))
    return 0


def _install(folder: Path, version: str, source: Path, constraints: Path) -> None:
    """What README says to do by hand."""
    print("making the environment", flush=True)
    subprocess.run([sys.executable, "-I", "-m", "venv", folder], check=True)
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    # Isolated: packages on a PYTHONPATH are not those of this environment.
    pip = [python, "-I", "-m", "pip", "install", "--disable-pip-version-check", "--no-input", "--progress-bar", "off"]
    editable = ["-e"] if source.is_dir() else []
    subprocess.run([*pip, "-c", constraints, *editable, source], check=True)
    print("trying it", flush=True)
    tried = subprocess.run([python, "-I", "-m", "tnst_mi", "--version"], check=True, stdout=subprocess.PIPE)
    said = tried.stdout.decode("utf-8", "replace").strip()
    if said != f"tnst-mi {version}":
        raise _Failed(
            f"{source}: is {said}, and this add-on is of {version}; name a checkout of that version, or install the "
            "add-on that is built from this checkout"
        )


def _take(lock: IO[bytes], private: Path) -> None:
    """Take the system's lock on a file, which ends when the file is closed, or the process ends."""
    try:
        if importlib.util.find_spec("fcntl") is not None:
            fcntl: Any = importlib.import_module("fcntl")
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        else:
            msvcrt: Any = importlib.import_module("msvcrt")
            msvcrt.locking(lock.fileno(), msvcrt.LK_NBLCK, 1)
    except (BlockingIOError, PermissionError):
        raise _Failed(
            f"{private}: another installation is going on there, of another Blender perhaps; wait for its end"
        ) from None
    except OSError as error:
        print(f"note: {private}: cannot be locked ({error.strerror}); let no other Blender install there", flush=True)


def _require_space(private: Path) -> None:
    """Check that an environment fits, before it is downloaded."""
    free = shutil.disk_usage(private).free
    if free < _NEEDED:
        raise _Failed(
            f"{private}: {free / 1e9:.1f} GB are free on its disk, and the environment takes about "
            f"{_NEEDED / 1e9:g} GB, with the torch of CUDA several times as much; free some space"
        )


def _require_room(folder: Path) -> None:
    """Find out whether it was for the disk that a program failed: not all of them say so."""
    try:
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(bytes(_PROBE))
            probe.flush()
            os.fsync(probe.fileno())
    except OSError as error:
        raise _Failed(
            f"{folder.parent}: cannot be written to ({error.strerror}); an environment takes about "
            f"{_NEEDED / 1e9:g} GB, with the torch of CUDA several times as much: free some space"
        ) from None


def _complete(marker: Path) -> str | None:
    """The name of the folder that a marker names."""
    try:
        return json.loads(marker.read_text("utf-8"))["folder"]
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _write(marker: Path, name: str) -> None:
    """Write the marker, whole or not at all."""
    beside = marker.with_name(f".{marker.name}.{os.getpid()}")
    try:
        beside.write_text(json.dumps({"folder": name}) + "\n", "utf-8")
        os.replace(beside, marker)
    finally:
        beside.unlink(missing_ok=True)


def _remove_others(private: Path, kept: str | None) -> None:
    """Remove what installations have left, but for one."""
    for folder in private.glob(f"{_PREFIX}*"):
        if folder.name != kept:
            shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2], sys.argv[3], Path(sys.argv[4]), Path(sys.argv[5])))
