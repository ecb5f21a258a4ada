"""Does this machine have what the main job needs? Every check names its remedy."""

from __future__ import annotations

import importlib.metadata
import platform
import sys
from dataclasses import dataclass

from tnst_mi.errors import InputError
from tnst_mi.machine import backend, environment
from tnst_mi.network import shipped
from tnst_mi.network.shipped import DOWNLOAD_COMMAND, PATTERNS

#: Free memory below which even the bundled scene may not fit, in bytes.
_LEAST_MEMORY = 2 << 30


@dataclass(frozen=True)
class Check:
    """One finding.

    Attributes:
        name: what was looked at.
        found: what is there.
        remedy: what to do; empty if there is nothing to do.
        required: the main job cannot run without it.
    """

    name: str
    found: str
    remedy: str = ""
    required: bool = False

    @property
    def ok(self) -> bool:
        """Nothing needs to be done."""
        return not self.remedy

    def __str__(self) -> str:
        """The finding on one line, its remedy on a second."""
        state = "ok" if self.ok else "missing" if self.required else "note"
        line = f"{state:8}{self.name:10}{self.found}"
        return line if self.ok else f"{line}\n{'':18}→ {self.remedy}"


def examine() -> list[Check]:
    """Look at everything that the main job depends on; nothing is downloaded."""
    return [
        _python(),
        *(_package(name) for name in ("mitsuba", "drjit", "torch")),
        _llvm(),
        _gpu(),
        _variant(),
        _weights(),
        _memory(),
    ]


def _python() -> Check:
    remedy = "" if sys.version_info >= (3, 11) else "install Python 3.11 or newer"
    return Check("Python", f"{platform.python_version()} at {sys.executable}", remedy, required=True)


def _package(name: str) -> Check:
    try:
        return Check(name, importlib.metadata.version(name), required=True)
    except importlib.metadata.PackageNotFoundError:
        return Check(name, "not installed", f"pip install {name}", required=True)


def _llvm() -> Check:
    library = backend.llvm_library()
    if library is None:
        return Check(
            "LLVM",
            f"none from version {backend.OLDEST_LLVM} on",
            "pip install karellen-llvm-core (Linux x86-64), or install libllvm19 (Debian, Ubuntu) or llvm "
            "(Homebrew); without it only an NVIDIA GPU can compute",
        )
    return Check("LLVM", f"{library.version or 'of unknown version'} at {library.path}: {library.reason}")


def _gpu() -> Check:
    gpus = environment.gpus()
    if not gpus:
        return Check("GPU", "no NVIDIA GPU answers; the CPU computes")
    found = "; ".join(
        f"{gpu['name']}, driver {gpu['driver']}, compute capability {gpu['compute_capability']}, "
        f"{gpu['free_memory']} of {gpu['memory']} free"
        for gpu in gpus
    )
    if all(float(gpu["compute_capability"]) < 7.5 for gpu in gpus):
        return Check("GPU", found, "Dr.Jit needs compute capability 7.5 or newer; the CPU computes")
    if all(int(gpu["driver"].split(".")[0]) < 535 for gpu in gpus):
        return Check("GPU", found, "Dr.Jit needs driver R535 or newer: update it; until then the CPU computes")
    if not _torch_has_cuda():
        return Check("GPU", found, "this torch is built for the CPU alone: install a CUDA build of torch")
    return Check("GPU", found)


def _torch_has_cuda() -> bool:
    try:
        import torch
    except ImportError:
        return False
    return torch.cuda.is_available()


def _variant() -> Check:
    try:
        variant = backend.activate()
    except (InputError, ImportError) as error:
        return Check("variant", "none can be used", " ".join(str(error).split()), required=True)
    import mitsuba as mi

    usable = [name for name in backend.VARIANTS if name in mi.variants()]
    return Check("variant", f"{variant} (this Mitsuba has {', '.join(usable)})", required=True)


def _weights() -> Check:
    from tnst_mi.network.weights import find_weights

    try:
        weights = find_weights()
    except InputError as error:
        return Check("weights", "unusable", str(error), required=True)
    if weights.fallback:
        return Check("weights", f"{PATTERNS} (shipped); the paper's network: {DOWNLOAD_COMMAND}", required=True)
    place = "(shipped)" if weights.path == shipped.FILE else f"at {weights.path}"
    return Check("weights", f"{weights.flavour} {place}", required=True)


def _memory() -> Check:
    free = environment.free_memory()
    if free is None:
        return Check("memory", "this system does not tell how much is free")
    remedy = "" if free >= _LEAST_MEMORY else "close other programs; large grids need more than this"
    return Check("memory", f"{free / 2**30:.1f} GiB free", remedy)
