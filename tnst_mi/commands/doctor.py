"""`tnst-mi doctor`: does this machine have what the main job needs? Every check names its remedy."""

from __future__ import annotations

import importlib.metadata
import platform
import sys
from dataclasses import dataclass

import mitsuba as mi

from tnst_mi.commands.arguments import DoctorArguments
from tnst_mi.errors import InputError
from tnst_mi.machine import environment, llvm, optix
from tnst_mi.network import shipped
from tnst_mi.network.shipped import DOWNLOAD_COMMAND, PATTERNS

try:
    import torch

    from tnst_mi.machine import backend
    from tnst_mi.network.weights import find_weights

    _broken_torch = ""
except ImportError as error:  # the doctor reports a missing or broken torch
    _broken_torch = str(error)

#: Free memory below which even the bundled scene may not fit, in bytes.
_LEAST_MEMORY = 2 << 30

_OPTIX_USES = (
    "compare, --integrator prbvolpath, render --look and Mitsuba scenes of your own; without these, stylize and render "
    "do not need it"
)


@dataclass(frozen=True)
class Requirement:
    """One thing that the main job depends on, and what was found.

    Attributes:
        name: what was looked at.
        found: what is there.
        remedy: what to do; empty if there is nothing to do.
        required: whether the main job needs it.
    """

    name: str
    found: str
    remedy: str = ""
    required: bool = False

    @property
    def ok(self) -> bool:
        """Whether nothing needs to be done."""
        return not self.remedy

    def __str__(self) -> str:
        """The finding on one line, its remedy on a second."""
        state = "ok" if self.ok else "missing" if self.required else "note"
        line = f"{state:8}{self.name:10}{self.found}"
        return line if self.ok else f"{line}\n{'':18}→ {self.remedy}"


def run(arguments: DoctorArguments) -> int:
    """Print what is present and what is missing; return 0 if the main job can run, else 1."""
    found = examine()
    for requirement in found:
        print(requirement)
    if all(requirement.ok for requirement in found if requirement.required):
        print("The main job can run: tnst-mi demo")
        return 0
    print("The main job lacks what is marked as missing above.")
    return 1


def examine() -> list[Requirement]:
    """Check everything that the main job depends on; nothing is downloaded."""
    found = [_python(), _package("mitsuba"), _package("drjit"), _torch(), _llvm()]
    if not _broken_torch:
        found += [_gpu(), _variant(), _optix(), _weights()]
    return [*found, _memory()]


def _python() -> Requirement:
    remedy = "" if sys.version_info >= (3, 11) else "install Python 3.11 or newer"
    return Requirement("Python", f"{platform.python_version()} at {sys.executable}", remedy, required=True)


def _package(name: str) -> Requirement:
    try:
        return Requirement(name, importlib.metadata.version(name), required=True)
    except importlib.metadata.PackageNotFoundError:
        return Requirement(name, "not installed", f"pip install {name}", required=True)


def _torch() -> Requirement:
    if _broken_torch:
        return Requirement("torch", f"cannot be imported: {_broken_torch}", "pip install torch", required=True)
    return _package("torch")


def _llvm() -> Requirement:
    library = llvm.llvm_library()
    if library is None:
        return Requirement(
            "LLVM",
            f"none from version {llvm.OLDEST_LLVM} on",
            "pip install karellen-llvm-core (Linux x86-64), or install libllvm19 (Debian, Ubuntu) or llvm "
            "(Homebrew); without it only an NVIDIA GPU can compute",
        )
    return Requirement("LLVM", f"{library.version or 'of unknown version'} at {library.path}: {library.reason}")


def _gpu() -> Requirement:
    gpus = environment.gpus()
    if not gpus:
        return Requirement("GPU", "no NVIDIA GPU answers; the CPU computes")
    found = "; ".join(
        f"{gpu['name']}, driver {gpu['driver']}, compute capability {gpu['compute_capability']}, "
        f"{gpu['free_memory']} of {gpu['memory']} free"
        for gpu in gpus
    )
    if all(float(gpu["compute_capability"]) < 7.5 for gpu in gpus):
        return Requirement("GPU", found, "Dr.Jit needs compute capability 7.5 or newer; the CPU computes")
    if all(int(gpu["driver"].split(".")[0]) < 535 for gpu in gpus):
        return Requirement("GPU", found, "Dr.Jit needs driver R535 or newer: update it; until then the CPU computes")
    if not torch.cuda.is_available():
        return Requirement("GPU", found, "this torch is built for the CPU alone: install a CUDA build of torch")
    return Requirement("GPU", found)


def _variant() -> Requirement:
    try:
        variant = backend.activate()
    except (InputError, ImportError) as error:
        return Requirement("variant", "none can be used", " ".join(str(error).split()), required=True)
    usable = [name for name in backend.VARIANTS if name in mi.variants()]
    return Requirement("variant", f"{variant} (this Mitsuba has {', '.join(usable)})", required=True)


def _optix() -> Requirement:
    """OptiX, which path tracing on a GPU needs; checked once a variant is active."""
    if not backend.on_gpu():
        return Requirement("OptiX", "not needed: no GPU computes")
    if optix.optix_answers():
        return Requirement("OptiX", f"answers; needed by {_OPTIX_USES}")
    return Requirement("OptiX", f"{optix.LIBRARY} cannot be loaded; needed by {_OPTIX_USES}", optix.REMEDY)


def _weights() -> Requirement:
    try:
        weights = find_weights()
    except InputError as error:
        return Requirement("weights", "unusable", str(error), required=True)
    if weights.fallback:
        return Requirement("weights", f"{PATTERNS} (shipped); the paper's network: {DOWNLOAD_COMMAND}", required=True)
    place = "(shipped)" if weights.path == shipped.FILE else f"at {weights.path}"
    return Requirement("weights", f"{weights.flavour} {place}", required=True)


def _memory() -> Requirement:
    free = environment.free_memory()
    remedy = "" if free >= _LEAST_MEMORY else "close other programs; large grids need more than this"
    return Requirement("memory", f"{free / 2**30:.1f} GiB free", remedy)
