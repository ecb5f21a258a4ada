"""Makes the private environment: a virtual environment with tnst-mi in it. Run as a process of its own.

    python installer.py PRIVATE MARKER SOURCE CONSTRAINTS

SOURCE is a wheel or a checkout. Each installation makes a folder of its own in PRIVATE, and stays there, since
environments hold their own paths. The marker, which names the folder that is complete, is written last: an earlier
environment is used until then, and an interrupted one never is.

Exit codes: 0 done, 1 failed, 3 interrupted.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

_PREFIX = "env-"


def main(private: Path, marker: str, source: Path, constraints: Path) -> int:
    """Make the environment."""
    try:
        private.mkdir(parents=True, exist_ok=True)
        _remove_others(private, _complete(private / marker))
        folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=private))
    except OSError as error:
        print(f"ERROR: {error.filename}: {error.strerror}", flush=True)
        return 1
    try:
        _install(folder, source, constraints)
        _write(private / marker, folder.name)
    except KeyboardInterrupt:
        shutil.rmtree(folder, ignore_errors=True)
        return 3
    except (OSError, subprocess.CalledProcessError) as error:
        if isinstance(error, OSError):
            print(f"ERROR: {error.filename}: {error.strerror}", flush=True)  # pip and venv say themselves what is wrong
        shutil.rmtree(folder, ignore_errors=True)
        return 1
    _remove_others(private, folder.name)
    return 0


def _install(folder: Path, source: Path, constraints: Path) -> None:
    """What README says to do by hand."""
    print("making the environment", flush=True)
    subprocess.run([sys.executable, "-I", "-m", "venv", folder], check=True)
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    # Isolated: packages on a PYTHONPATH are not those of this environment.
    pip = [python, "-I", "-m", "pip", "install", "--disable-pip-version-check", "--no-input", "--progress-bar", "off"]
    editable = ["-e"] if source.is_dir() else []
    subprocess.run([*pip, "-c", constraints, *editable, source], check=True)
    print("trying it", flush=True)
    subprocess.run([python, "-I", "-m", "tnst_mi", "--version"], check=True)


def _complete(marker: Path) -> str | None:
    """The name of the folder that a marker names."""
    try:
        return json.loads(marker.read_text("utf-8"))["folder"]
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _write(marker: Path, name: str) -> None:
    """Write the marker, whole or not at all."""
    beside = marker.with_name(f".{marker.name}.{os.getpid()}")
    beside.write_text(json.dumps({"folder": name}) + "\n", "utf-8")
    os.replace(beside, marker)


def _remove_others(private: Path, kept: str | None) -> None:
    """Remove what earlier installations have left."""
    for folder in private.glob(f"{_PREFIX}*"):
        if folder.name != kept:
            shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]), Path(sys.argv[4])))
