"""Choosing the LLVM library that Dr.Jit compiles with.

Dr.Jit loads LLVM on import: this module has to choose before that, so it imports neither Dr.Jit nor Mitsuba.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
from dataclasses import dataclass
from pathlib import Path

#: LLVM 14 and 15 abort the process on float minimum/maximum instructions that Dr.Jit emits.
OLDEST_LLVM = 16

#: The reason given for a library that the user chose.
USER_CHOICE = "named by DRJIT_LIBLLVM_PATH"

_SYSTEM_LIBRARY_FOLDERS = (
    f"/usr/lib/{platform.machine()}-linux-gnu",
    "/usr/lib64",
    "/usr/lib64/llvm*/lib*",
    "/usr/lib/llvm-*/lib",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm/lib",
    "/usr/local/opt/llvm/lib",
)

_LLVM_NAME = re.compile(r"libLLVM(?:-(\d+)[\d.]*)?\.(?:so|dylib)(?:\.(\d+)[\d.]*)?$")


@dataclass(frozen=True)
class LlvmLibrary:
    """The LLVM library that Dr.Jit compiles with: its path, major version (0: unknown) and why it was chosen."""

    path: Path
    version: int
    reason: str


def _version_of(path: Path) -> int:
    """Major LLVM version in a library's file name (`libLLVM-17.so.1`, `libLLVM.so.19.1`), or 0."""
    match = _LLVM_NAME.match(path.name)
    return int(match[1] or match[2] or 0) if match else 0


def _system_llvm() -> Path | None:
    """The newest usable LLVM library of the operating system."""
    found = [
        path
        for folder in _SYSTEM_LIBRARY_FOLDERS
        for path in Path("/").glob(f"{folder[1:]}/libLLVM*")
        # A development package may leave a link to a library that is not installed.
        if _version_of(path) >= OLDEST_LLVM and path.exists()
    ]
    return max(found, key=lambda path: (_version_of(path), str(path)), default=None)


def _wheel_llvm() -> Path | None:
    """The LLVM library inside the karellen-llvm-core package, if that is installed."""
    try:
        files = importlib.metadata.files("karellen-llvm-core") or []
    except importlib.metadata.PackageNotFoundError:
        return None
    for file in files:
        path = Path(str(file.locate())).resolve()
        if _version_of(path) >= OLDEST_LLVM and path.exists():
            return path
    return None


def llvm_library() -> LlvmLibrary | None:
    """Find the LLVM library for Dr.Jit: the user's choice, the system's newest, then the one installed by pip.

    Returns None if no usable library (version 16 or newer) is found.
    """
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH")
    if chosen and chosen != os.environ.get("_TNST_MI_LIBLLVM_PATH"):
        return LlvmLibrary(Path(chosen), _version_of(Path(chosen).resolve()), USER_CHOICE)
    if (path := _system_llvm()) is not None:
        return LlvmLibrary(path, _version_of(path), f"newest LLVM of the system that is {OLDEST_LLVM} or newer")
    if (path := _wheel_llvm()) is not None:
        return LlvmLibrary(
            path,
            _version_of(path),
            f"package karellen-llvm-core (the system has no LLVM {OLDEST_LLVM} or newer)",
        )
    return None


def choose_llvm() -> None:
    """Make Dr.Jit, which is imported later, load the chosen LLVM library."""
    library = llvm_library()
    if library is not None and os.environ.get("DRJIT_LIBLLVM_PATH") != str(library.path):
        # Our own variable marks this choice as ours, not the user's.
        os.environ["_TNST_MI_LIBLLVM_PATH"] = str(library.path)
        os.environ["DRJIT_LIBLLVM_PATH"] = str(library.path)
