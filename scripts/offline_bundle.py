"""Packs everything that a machine without network access needs to run tnst_mi into one archive, with an installer.

    python scripts/offline_bundle.py --out bundle.tar [--limit 60MB] [--python 3.12] [--weights FILE]
        [--have torch,numpy,...] [--variants cuda_ad_rgb,llvm_ad_rgb] [--wheels FOLDER] [--without-project]

For render farms: Linux on x86-64, Python with pip, and PyTorch, which is too large to bundle. On the target,
`bash install.sh [TARGET]` puts everything into one folder, and `. TARGET/env.sh` makes Python find it.

The packages are those of constraints.txt that the project and its tests import, except those of `--have`; wheels that
are not in `--wheels` are downloaded. Packages with much machine code are stripped of what the chosen variants do not
need, and compressed better than wheels are. The weights of a GoogLeNet are stored in half precision. An `--out` that
ends in .tar becomes an archive, any other a folder.

Two tests of the suite switch to other variants; `--variants llvm_ad_rgb,llvm_ad_mono,scalar_rgb` includes what they
need.

If the limit would be exceeded, optional packages are left out, and the output and manifest.json say what does not
work without them. Exit code 2 if not even the minimum fits.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import lzma
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import zipfile
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from email.parser import HeaderParser
from pathlib import Path, PurePosixPath
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]

PROJECT = ("tnst_mi", "scenes", "scripts", "tests", "docs/*.md", "pyproject.toml", "constraints.txt", "*.md", "LICENSE")

#: The C library versions that a wheel may require, as pip names them.
PLATFORMS = ("2_28", "2_27", "2_17", "2_34", "2_35", "2_24", "2014")

#: What every target machine must already have.
ALWAYS_THERE = "torch"

LLVM = "karellen-llvm-core"

#: What can be left out, the most useful first, and what does not work without it.
OPTIONAL = {
    LLVM: "the variant llvm_ad_rgb, unless the machine has an LLVM library of version 16 or newer",
    "imageio-ffmpeg": "reading and writing videos (.mp4)",
}

#: Packages with much machine code and no files outside the folder of the package.
PACKED = ("blosc", "drjit", "mitsuba", "openexr")

#: Bytes for the installer, the manifest, and long names in an archive.
OVERHEAD = 1 << 15

#: Preset of xz; slow, which is acceptable since it runs once.
PRESET = 9 | lzma.PRESET_EXTREME

Files = dict[str, tuple[bytes, int]]
"""Contents and mode by name."""

_VARIANT = re.compile(r"mitsuba/((?:scalar|llvm|cuda)_\w+)\.[^/]*\.so")
_DEVELOPMENT = re.compile(
    r"""
    (mitsuba|drjit)/(include|cmake|pkgconfig|mitsuba_stubs)/.*  # for building on them
    | mitsuba/python/test/.*
    | share/.* | [^/]+\.data/.* | mitsuba/mitsuba               # documentation, libraries for C, programs
    | .*\.(pyi|pat|a) | .*/py\.typed
    """,
    re.VERBOSE,
)
_SPECTRA = "mitsuba/data/srgb.coeff"
_LLVM_FILE = re.compile(r"[^/]+\.data/data/(lib/(?:.+/)?(?:libLLVM\.so\..+|lib(?:c\+\+|c\+\+abi|unwind)\.so\.\d+))")


class DoesNotFit(Exception):
    """Not even the minimum fits into the limit."""


@dataclass(frozen=True)
class Part:
    """A file of the bundle, at `place` in it; its folder there tells the installer how to handle it."""

    path: Path
    place: str
    contents: str
    version: str | None = None

    @property
    def size(self) -> int:
        """Bytes."""
        return self.path.stat().st_size


def parse_size(text: str) -> int:
    """Bytes of a size such as 60MB (decimal), 45MiB (binary) or 1000."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(?:([KMG]?)(i?)B)?", text.strip(), re.IGNORECASE)
    if not match:
        raise argparse.ArgumentTypeError(f"{text!r} is no size; expected one such as 60MB or 45MiB")
    number, prefix, binary = match.groups()
    return int(float(number) * (1024 if binary else 1000) ** " KMG".index((prefix or " ").upper()))


def megabytes(size: int) -> str:
    """A size as `parse_size` reads it."""
    return f"{size / 1e6:.1f}MB"


def bundle_size(parts: Iterable[Part]) -> int:
    """Upper bound of an archive of these parts in bytes: each has a header, and blocks are 512 bytes."""
    return OVERHEAD + sum(512 * (1 + -(-part.size // 512)) for part in parts)


def is_kept(name: str, variants: Collection[str]) -> bool:
    """Whether a file of a wheel is needed to run these variants of Mitsuba.

    All plugins are kept, since a user's scene may name any of them. The table srgb.coeff takes half as much space as
    they do, and is only read where colours are converted to spectra.
    """
    if match := _VARIANT.fullmatch(name):
        return match[1] in variants
    if name == _SPECTRA:
        return any("spectral" in variant for variant in variants)
    return not _DEVELOPMENT.fullmatch(name)


def files_of(wheel: Path) -> Iterator[tuple[str, bytes, int]]:
    """The name, the contents and the mode of each file in a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        for member in archive.infolist():
            if not member.is_dir():
                yield member.filename, archive.read(member), member.external_attr >> 16 & 0o777 or 0o644


def trimmed(wheel: Path, variants: Collection[str]) -> Files:
    """The files of a wheel that are needed, with its list of files (RECORD) adapted."""
    kept = {name: (content, mode) for name, content, mode in files_of(wheel) if is_kept(name, variants)}
    for name, (content, mode) in kept.items():
        if name.endswith(".dist-info/RECORD"):
            lines = content.decode().splitlines(keepends=True)
            kept[name] = ("".join(line for line in lines if line.rsplit(",", 2)[0].strip('"') in kept).encode(), mode)
    return kept


def require_variants(wheel: Path, variants: Collection[str]) -> None:
    """Stop if a wheel of Mitsuba lacks one of the variants."""
    with zipfile.ZipFile(wheel) as archive:
        found = {match[1] for name in archive.namelist() if (match := _VARIANT.fullmatch(name))}
    if missing := sorted(set(variants) - found):
        raise SystemExit(f"{wheel.name} has no variant {', '.join(missing)}; expected of {', '.join(sorted(found))}")


def llvm_files(wheel: Path) -> Files:
    """The LLVM library in the wheel of karellen-llvm-core, and the C++ libraries that it loads, named as it needs them.

    The package itself is of no use here: its links are created when Python starts, and only in Python's own folder.
    """
    found: Files = {}
    for name, content, mode in files_of(wheel):
        # libc++.so.1.0 is loaded as libc++.so.1
        if match := _LLVM_FILE.fullmatch(re.sub(r"(/lib(?!LLVM)[^/]+\.so\.\d+)\.\d+$", r"\1", name)):
            found[match[1]] = (content, mode)
    if not any("libLLVM" in name for name in found):
        raise SystemExit(f"{wheel.name} has no LLVM library")
    return found


def write_packed(files: Files, path: Path) -> None:
    """Write a .tar.xz, as small as possible: x86 machine code passes a filter before it is compressed."""
    filters = [{"id": lzma.FILTER_X86}, {"id": lzma.FILTER_LZMA2, "preset": PRESET}]
    with lzma.open(path, "w", check=lzma.CHECK_CRC64, filters=filters) as compressed:
        with tarfile.open(fileobj=compressed, mode="w") as archive:
            # Files of the same type resemble one another, which helps compression.
            for name in sorted(files, key=lambda name: (PurePosixPath(name).suffix, name)):
                content, mode = files[name]
                entry = tarfile.TarInfo(name)
                entry.size, entry.mode = len(content), mode
                archive.addfile(entry, io.BytesIO(content))


def write_half_precision(source: Path, target: Path) -> None:
    """Copy a .safetensors file with float16 for float32, keeping the names and the metadata.

    The readers convert it back to float32. A file with 8-bit tensors is copied unchanged: it is small, and its reader
    expects the scales in float32.
    """
    import torch
    from safetensors import SafetensorError, safe_open
    from safetensors.torch import save_file

    try:
        with safe_open(source, framework="pt") as file:
            metadata, tensors = file.metadata(), {name: file.get_tensor(name) for name in file.keys()}
    except (OSError, SafetensorError) as error:
        raise SystemExit(f"--weights {source}: cannot be read as .safetensors ({error})") from None
    if any(tensor.dtype == torch.int8 for tensor in tensors.values()):
        shutil.copyfile(source, target)
        return
    for name, tensor in tensors.items():
        if tensor.dtype == torch.float32:
            tensors[name] = tensor.half().contiguous()
            if not bool(tensors[name].isfinite().all()):
                raise SystemExit(f"--weights {source}: {name!r} has values beyond the range of half precision")
    save_file(tensors, target, metadata)


def pinned_versions(text: str) -> dict[str, str]:
    """The versions in a constraints file, by canonical name."""
    pairs = (line.split("#")[0].split(";")[0].strip().partition("==") for line in text.splitlines())
    return {canonicalize_name(name): version for name, _, version in pairs if version}


def requirements_of(wheel: Path) -> list[str]:
    """The requirements that a wheel declares."""
    with zipfile.ZipFile(wheel) as archive:
        name = next(name for name in archive.namelist() if re.fullmatch(r"[^/]+\.dist-info/METADATA", name))
        return HeaderParser().parsestr(archive.read(name).decode()).get_all("Requires-Dist") or []


def needed_names(requirements: Iterable[str], python: str) -> list[str]:
    """The canonical names of the requirements that apply on Linux, x86-64, without extras."""
    environment = {
        "extra": "",
        "os_name": "posix",
        "platform_machine": "x86_64",
        "platform_python_implementation": "CPython",
        "platform_system": "Linux",
        "python_full_version": f"{python}.0",
        "python_version": python,
        "sys_platform": "linux",
    }
    parsed = map(Requirement, requirements)
    return [canonicalize_name(one.name) for one in parsed if not one.marker or one.marker.evaluate(environment)]


def find_wheel(name: str, version: str, python: str, folder: Path) -> Path | None:
    """The wheel of this version in a folder that fits the target's Python, if there is one."""
    tag, platform = f"cp{python.replace('.', '')}", re.compile(r"any|manylinux\w*_x86_64|linux_x86_64")
    for path in sorted(folder.glob("*.whl")):
        parts = path.stem.split("-")
        if canonicalize_name(parts[0]) != name or parts[1] != version:
            continue
        fits_python = parts[-3].startswith("py") or tag in parts[-3].split(".") or parts[-2] == "abi3"
        if fits_python and any(map(platform.fullmatch, parts[-1].split("."))):
            return path
    return None


def fetch_wheel(name: str, version: str, python: str, folder: Path) -> Path:
    """Download a wheel for the target."""
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:"]
    command += ["--python-version", python, "--implementation", "cp", "--dest", str(folder)]
    for platform in PLATFORMS:
        command += ["--platform", f"manylinux{platform if platform.isdigit() else f'_{platform}'}_x86_64"]
    finished = subprocess.run([*command, f"{name}=={version}"], check=False, capture_output=True, text=True)
    wheel = find_wheel(name, version, python, folder)
    if finished.returncode or wheel is None:
        raise SystemExit(f"no wheel of {name}=={version} for Python {python}: {finished.stderr.strip()[-500:]}")
    return wheel


def collect_wheels(
    have: Collection[str], python: str, given: Path | None, folder: Path
) -> tuple[dict[str, Path], list[str]]:
    """The wheels, by canonical name, that the project and its tests need; and what the target must already have."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pins = pinned_versions((ROOT / "constraints.txt").read_text(encoding="utf-8"))
    waiting = needed_names([*project["dependencies"], *project["optional-dependencies"]["test"]], python)
    wheels: dict[str, Path] = {}
    expected: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name in have:
            expected.add(name)
        elif name not in wheels:
            if name not in pins:
                raise SystemExit(f"{name} is needed, but constraints.txt has no version of it (--have {name}?)")
            wheel = find_wheel(name, pins[name], python, given) if given else None
            wheels[name] = wheel or fetch_wheel(name, pins[name], python, folder)
            if name != LLVM:  # only its library is used
                waiting += needed_names(requirements_of(wheels[name]), python)
    return wheels, sorted(expected)


def project_files() -> Files:
    """The project's files as in the working tree, including new ones, except those that git ignores."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "--", *PROJECT]
    listed = subprocess.run(command, cwd=ROOT, check=False, capture_output=True)
    if listed.returncode:
        raise SystemExit(f"{ROOT} is no git checkout, so its files are not known; --without-project leaves them out")
    files: Files = {}
    for name in filter(None, listed.stdout.decode().split("\0")):
        if (path := ROOT / name).is_file():
            files[name] = (path.read_bytes(), 0o755 if path.stat().st_mode & 0o100 else 0o644)
    return files


def fitting(required: Sequence[Part], optional: Sequence[Part], limit: int | None) -> tuple[list[Part], list[Part]]:
    """The parts to bundle, and the optional ones to leave out; `optional` is ordered by usefulness."""
    taken, left_out = list(required), []
    if limit is not None and bundle_size(taken) > limit:
        sizes = ", ".join(f"{part.contents} {megabytes(part.size)}" for part in sorted(taken, key=_by_size))
        raise DoesNotFit(
            f"does not fit: the least takes {megabytes(bundle_size(taken))} of {megabytes(limit)}: {sizes}"
        )
    for part in optional:
        fits = limit is None or bundle_size([*taken, part]) <= limit
        (taken if fits else left_out).append(part)
    return taken, left_out


def manifest(
    parts: Sequence[Part], left_out: dict[str, str], python: str, variants: Sequence[str], expected: Sequence[str]
) -> dict[str, Any]:
    """What the bundle contains, what it lacks, and what the target must already have; the installer reads it."""
    return {
        "python": python,
        "variants": list(variants),
        "files": [
            {
                "file": part.place,
                "contents": part.contents,
                "version": part.version,
                "bytes": part.size,
                "sha256": hashlib.sha256(part.path.read_bytes()).hexdigest(),
            }
            for part in parts
        ],
        "left_out": left_out,
        "expected": list(expected),
    }


def _by_size(part: Part) -> int:
    return -part.size


INSTALLER = r"""#!/usr/bin/env bash
# bash install.sh [TARGET]: installs this bundle into a folder (tnst_mi-offline without one). Needs no network.
# $PYTHON names the interpreter (python3 without it).
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
python="$(command -v "${PYTHON:-python3}")" || { echo "install.sh: no ${PYTHON:-python3} here" >&2; exit 1; }
mkdir -p "${1:-tnst_mi-offline}"
target="$(cd "${1:-tnst_mi-offline}" && pwd)"

"$python" - "$here" "$target" <<'END'
import hashlib, json, os, shutil, sys, tarfile

here, target = sys.argv[1:]
with open(os.path.join(here, "manifest.json"), encoding="utf-8") as file:
    manifest = json.load(file)
version = "%d.%d" % sys.version_info[:2]
if version != manifest["python"]:
    sys.exit("install.sh: made for Python %s, this is %s (PYTHON=... names another)" % (manifest["python"], version))
for entry in manifest["files"]:
    with open(os.path.join(here, entry["file"]), "rb") as file:
        if hashlib.sha256(file.read()).hexdigest() != entry["sha256"]:
            sys.exit("install.sh: %s is damaged" % entry["file"])
# An earlier installation is replaced; anything else of these names is not ours.
marker = os.path.join(target, "env.sh")
for folder in ("bin", "llvm", "project", "site", "weights"):
    path = os.path.join(target, folder)
    if os.path.exists(path):
        if not os.path.exists(marker):
            sys.exit("install.sh: %s exists, but no earlier installation; name another TARGET" % path)
        shutil.rmtree(path)
open(marker, "w").close()
os.mkdir(os.path.join(target, "site"))
for entry in manifest["files"]:
    source, (folder, name) = os.path.join(here, entry["file"]), entry["file"].split("/", 1)
    if folder in ("llvm", "project", "site"):
        with tarfile.open(source) as archive:
            safe = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
            archive.extractall(os.path.join(target, folder), **safe)
    elif folder == "weights":
        os.makedirs(os.path.join(target, folder))
        shutil.copyfile(source, os.path.join(target, folder, name))
END

wheels=("$here"/wheels/*.whl)
if [ -e "${wheels[0]}" ]; then
    PIP_CONFIG_FILE=/dev/null "$python" -m pip --isolated --disable-pip-version-check install --quiet --no-index \
        --no-deps --no-compile --no-warn-conflicts --root-user-action ignore --target "$target/site" "${wheels[@]}"
fi

path="$target/site"
if [ -d "$target/project" ]; then path="$target/project:$path"; fi
{
    printf 'export PYTHONPATH=%q${PYTHONPATH:+:$PYTHONPATH}\n' "$path"
    for file in "$target"/weights/*; do
        if [ -e "$file" ]; then printf 'export TNST_MI_WEIGHTS=%q\n' "$file"; fi
    done
    for file in "$target"/llvm/lib/libLLVM.so.*; do
        if [ -e "$file" ]; then printf 'export DRJIT_LIBLLVM_PATH=%q\n' "$file"; fi
    done
    if [ -d "$target/project" ]; then printf 'export PATH=%q:$PATH\n' "$target/bin"; fi
} >"$target/env.sh"
if [ -d "$target/project" ]; then
    mkdir "$target/bin"
    {
        printf '#!/usr/bin/env bash\n. %q\nexec %q -P -c ' "$target/env.sh" "$python"
        printf '%q "$@"\n' 'import sys; sys.argv[0] = "tnst-mi"; from tnst_mi.cli import main; sys.exit(main())'
    } >"$target/bin/tnst-mi"
    chmod +x "$target/bin/tnst-mi"
fi
cat "$target/env.sh"

. "$target/env.sh"
"$python" - "$here" <<'END'
import importlib.metadata, json, os, sys

with open(os.path.join(sys.argv[1], "manifest.json"), encoding="utf-8") as file:
    expected = json.load(file)["expected"]
missing = []
for name in expected:
    try:
        importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        missing.append(name)
if missing:
    print("install.sh: this Python lacks what the bundle expects it to have: " + ", ".join(missing), file=sys.stderr)
END
"""


def require_replaceable(out: Path) -> None:
    """Stop before replacing a folder that is not an earlier bundle."""
    if out.suffix == ".tar":
        if out.is_dir():
            raise SystemExit(f"--out {out}: is a folder")
    elif out.exists() and not (out / "manifest.json").is_file() and not (out.is_dir() and not any(out.iterdir())):
        raise SystemExit(f"--out {out}: exists and is no earlier bundle")


def write_bundle(parts: Sequence[Part], facts: dict[str, Any], out: Path) -> None:
    """Write a folder, or an archive of one; an earlier one is replaced once the new one is complete."""
    beside = out.resolve().parent
    beside.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=beside) as temporary:
        folder = Path(temporary) / out.resolve().name.removesuffix(".tar")
        folder.mkdir()
        (folder / "install.sh").write_text(INSTALLER, encoding="utf-8")
        (folder / "install.sh").chmod(0o755)
        (folder / "manifest.json").write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")
        for part in parts:
            (folder / part.place).parent.mkdir(exist_ok=True)
            shutil.copyfile(part.path, folder / part.place)
        if out.suffix == ".tar":
            packed = Path(temporary) / "packed.tar"
            with tarfile.open(packed, "w") as archive:
                archive.add(folder, folder.name)
            packed.replace(out)
        else:
            if out.exists():
                shutil.rmtree(out)
            folder.rename(out.resolve())


def make_parts(arguments: argparse.Namespace, wheels: dict[str, Path], folder: Path) -> tuple[list[Part], list[Part]]:
    """The required and the optional parts of the bundle, the most useful first; `folder` is for the files made here."""
    required, optional = [], {}
    for name, wheel in sorted(wheels.items()):
        version = wheel.stem.split("-")[1]
        packed = folder / f"{name}-{version}.tar.xz"
        if name == LLVM:
            write_packed(llvm_files(wheel), packed)
            optional[name] = Part(packed, f"llvm/{packed.name}", name, version)
        elif name in PACKED:
            write_packed(trimmed(wheel, arguments.variants), packed)
            required.append(Part(packed, f"site/{packed.name}", name, version))
        elif name in OPTIONAL:
            optional[name] = Part(wheel, f"wheels/{wheel.name}", name, version)
        else:
            required.append(Part(wheel, f"wheels/{wheel.name}", name, version))
    if arguments.weights:
        path = folder / f"{arguments.weights.stem}_half.safetensors"
        write_half_precision(arguments.weights, path)
        required.append(Part(path, f"weights/{path.name}", "weights"))
    if not arguments.without_project:
        path = folder / "tnst_mi.tar.xz"
        write_packed(project_files(), path)
        required.append(Part(path, f"project/{path.name}", "tnst_mi"))
    return required, [optional[name] for name in OPTIONAL if name in optional]


def build(arguments: argparse.Namespace, folder: Path) -> None:
    """Make the bundle; `folder` is for intermediate files."""
    require_replaceable(arguments.out)
    if arguments.weights and not arguments.weights.is_file():
        raise SystemExit(f"--weights {arguments.weights}: no such file")
    if arguments.wheels and not arguments.wheels.is_dir():
        raise SystemExit(f"--wheels {arguments.wheels}: no such folder")
    left_out = {}
    have = {canonicalize_name(name) for name in (*arguments.have, ALWAYS_THERE)}
    if not any(variant.startswith("llvm") for variant in arguments.variants) and LLVM not in have:
        left_out[LLVM] = "only variants that run without it were asked for"
    wheels, expected = collect_wheels({*have, *left_out}, arguments.python, arguments.wheels, folder)
    if "mitsuba" in wheels:
        require_variants(wheels["mitsuba"], arguments.variants)
    required, optional = make_parts(arguments, wheels, folder)
    parts, without = fitting(required, optional, arguments.limit)
    for part in without:
        left_out[part.contents] = (
            f"its {megabytes(part.size)} do not fit; what does not work without it: {OPTIONAL[part.contents]}"
        )
    expected = [name for name in expected if name not in left_out]
    write_bundle(parts, manifest(parts, left_out, arguments.python, arguments.variants, expected), arguments.out)
    for part in sorted(parts, key=_by_size):
        print(f"{megabytes(part.size):>8}  {part.contents} {part.version or ''}".rstrip())
    for name, reason in left_out.items():
        print(f"left out: {name} ({reason})")
    print(f"{arguments.out}: {megabytes(bundle_size(parts))}; the machine is to have: {', '.join(expected)}")


def names(text: str) -> list[str]:
    """The parts of a list separated by commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def python_version(text: str) -> str:
    """A version of Python such as 3.12."""
    if not re.fullmatch(r"3\.\d+", text):
        raise argparse.ArgumentTypeError(f"{text!r} is no version of Python; expected one such as 3.12")
    return text


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("--out", type=Path, required=True, help="the archive (.tar) or folder to write")
    add("--limit", type=parse_size, help="maximum size of the archive, such as 60MB or 45MiB")
    add("--python", type=python_version, default="3.12", help="the Python version of the target (default: 3.12)")
    add("--weights", type=Path, help="a GoogLeNet (.safetensors) to include")
    add("--have", type=names, default=[], help="packages that the target has besides torch, separated by commas")
    add("--variants", type=names, default=["cuda_ad_rgb", "llvm_ad_rgb"], help="of Mitsuba (default: both that run)")
    add("--wheels", type=Path, help="a folder of wheels to search before downloading")
    add("--without-project", action="store_true", help="leave out the files of this checkout")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parsed = parse(arguments)
    with tempfile.TemporaryDirectory() as folder:
        try:
            build(parsed, Path(folder))
        except DoesNotFit as error:
            print(f"offline_bundle: {error}", file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
