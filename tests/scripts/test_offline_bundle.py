"""scripts/offline_bundle.py: what of a wheel is kept, what fits, what is written, what the installer makes of it."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import offline_bundle
import pytest
import safetensors.numpy
from networks import random_googlenet
from offline_bundle import Part

from tnst_mi.network.readers import flavour_of, read_weights

VERSION = f"{sys.version_info.major}.{sys.version_info.minor}"
TAG = f"cpython-{VERSION.replace('.', '')}-x86_64-linux-gnu"
CP = f"cp{VERSION.replace('.', '')}"

MITSUBA = {
    "mitsuba/__init__.py": "VARIANTS = 'of a stand-in'\n",
    "mitsuba/__init__.pyi": "stub",
    "mitsuba/config.py": "",
    "mitsuba/py.typed": "",
    "mitsuba/mitsuba": "program",
    f"mitsuba/mitsuba_alias.{TAG}.so": "alias",
    f"mitsuba/mitsuba_ext.{TAG}.so": "extension",
    f"mitsuba/cuda_ad_rgb.{TAG}.so": "CUDA",
    f"mitsuba/cuda_ad_mono.{TAG}.so": "CUDA mono",
    f"mitsuba/llvm_ad_rgb.{TAG}.so": "LLVM",
    f"mitsuba/llvm_ad_spectral.{TAG}.so": "LLVM spectral",
    f"mitsuba/scalar_rgb.{TAG}.so": "scalar",
    "mitsuba/libmitsuba.so": "core",
    "mitsuba/libembree3.so": "rays",
    "mitsuba/libfoo.a": "static",
    "mitsuba/include/mitsuba/mitsuba.h": "header",
    "mitsuba/cmake/mitsubaConfig.cmake": "build",
    "mitsuba/pkgconfig/mitsuba.pc": "build",
    "mitsuba/data/srgb.coeff": "table",
    "mitsuba/data/ior/Ag.eta.spd": "silver",
    "mitsuba/plugins/path.so": "plugin",
    "mitsuba/python/util.py": "",
    "mitsuba/python/test/test_it.py": "",
    "share/doc/readme": "documentation",
}
LLVM = "karellen_llvm_core-23.1.data/data"
LLVM_FILES = {
    f"{LLVM}/lib/libLLVM.so.23.1": "LLVM",
    f"{LLVM}/lib/libLTO.so.23.1": "linker",
    f"{LLVM}/lib/x86_64-unknown-linux-gnu/libc++.so": "script",
    f"{LLVM}/lib/x86_64-unknown-linux-gnu/libc++.so.1.0": "C++",
    f"{LLVM}/lib/x86_64-unknown-linux-gnu/libc++abi.so.1.0": "exceptions",
    f"{LLVM}/lib/x86_64-unknown-linux-gnu/libunwind.so.1.0": "unwinder",
    f"{LLVM}/share/libc++/v1/std.cppm": "module",
}


def make_wheel(
    folder: Path, name: str, version: str, files: dict[str, str], tag: str = "py3-none-any", needs: tuple[str, ...] = ()
) -> Path:
    """A wheel that pip installs."""
    stem = f"{name}-{version}"
    metadata = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
    metadata += "".join(f"Requires-Dist: {need}\n" for need in needs)
    contents = files | {
        f"{stem}.dist-info/METADATA": metadata,
        f"{stem}.dist-info/WHEEL": f"Wheel-Version: 1.0\nGenerator: a test\nRoot-Is-Purelib: true\nTag: {tag}\n",
    }
    record = "".join(f"{member},,\n" for member in (*contents, f"{stem}.dist-info/RECORD"))
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{stem}-{tag}.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for member, text in (contents | {f"{stem}.dist-info/RECORD": record}).items():
            entry = zipfile.ZipInfo(member)
            entry.external_attr = (0o755 if member.endswith(".so") else 0o644) << 16
            archive.writestr(entry, text)
    return path


def part(folder: Path, name: str, size: int) -> Part:
    (folder / name).write_bytes(bytes(size))
    return Part(folder / name, f"wheels/{name}", name)


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small project with the wheels of all that it needs; nothing is downloaded, nothing compressed for long."""
    root, wheels = tmp_path / "project", tmp_path / "wheels"
    (root / "tnst_mi").mkdir(parents=True)
    (root / "tnst_mi" / "__init__.py").touch()
    (root / "tnst_mi" / "cli.py").write_text(
        "import sys\n\ndef main():\n    import mitsuba, small\n    print(mitsuba.VARIANTS, *sys.argv)\n    return 3\n"
    )
    (root / "tnst_mi" / "ignored.pyc").touch()
    (root / ".gitignore").write_text("*.pyc\n")
    (root / "elsewhere.txt").touch()
    (root / "pyproject.toml").write_text(
        '[project]\nname = "tnst_mi"\n'
        'dependencies = ["mitsuba>=3", "karellen-llvm-core; sys_platform == \'linux\'", "imageio-ffmpeg", "torch",\n'
        '                "numpy", "winonly; sys_platform == \'win32\'"]\n'
        '[project.optional-dependencies]\ntest = ["small>=1"]\n'
    )
    pins = ("mitsuba==3.9", "drjit==1.5", "karellen-llvm-core==23.1", "imageio-ffmpeg==0.8", "small==1.0", "Deep.er==2")
    (root / "constraints.txt").write_text("# those that work\n" + "\n".join(pins) + "\n")
    subprocess.run(["git", "init", "--quiet", root], check=True)
    native = f"{CP}-{CP}-manylinux_2_28_x86_64"
    make_wheel(wheels, "mitsuba", "3.9", MITSUBA, native, ("drjit==1.5",))
    make_wheel(wheels, "drjit", "1.5", {"drjit/__init__.py": "", "drjit/include/drjit/a.h": ""}, native)
    make_wheel(wheels, "karellen_llvm_core", "23.1", LLVM_FILES, "py3-none-manylinux_2_28_x86_64", ("axle",))
    make_wheel(wheels, "imageio_ffmpeg", "0.8", {"imageio_ffmpeg/ffmpeg": "x" * 200_000})
    make_wheel(
        wheels, "small", "1.0", {"small.py": "import deeper\n"}, needs=("deep-er", "numpy", "extra; extra == 'x'")
    )
    make_wheel(wheels, "deep_er", "2", {"deeper.py": ""})
    monkeypatch.setattr(offline_bundle, "ROOT", root)
    monkeypatch.setattr(offline_bundle, "PRESET", 0)
    monkeypatch.setattr(offline_bundle, "fetch_wheel", lambda name, *_: pytest.fail(f"{name} was to be downloaded"))
    return root


def bundle(out: Path, project: Path, *more: object) -> int:
    """Make a bundle of the small project for this Python."""
    wheels = project.parent / "wheels"
    arguments = ("--out", out, "--wheels", wheels, "--python", VERSION, "--have", "numpy", *more)
    return offline_bundle.main([str(argument) for argument in arguments])


def install(folder: Path, target: Path) -> subprocess.CompletedProcess[str]:
    pytest.importorskip("pip")
    environment = {"PATH": os.environ["PATH"], "PYTHON": sys.executable}
    command = ["bash", str(folder / "install.sh"), str(target)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


# ---- sizes -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "size"),
    [("60MB", 60_000_000), ("45MiB", 45 << 20), ("1.5kb", 1500), ("2 GiB", 2 << 30), ("10B", 10), ("1000", 1000)],
)
def test_sizes_are_decimal_or_binary(text: str, size: int) -> None:
    assert offline_bundle.parse_size(text) == size


@pytest.mark.parametrize("text", ["", "MB", "-1MB", "60 M", "60TB", "1,5MB", "nan"])
def test_what_is_no_size_is_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="is no size; expected one such as 60MB"):
        offline_bundle.parse_size(text)


def test_an_archive_takes_no_more_than_was_reckoned(tmp_path: Path) -> None:
    parts = [part(tmp_path, f"{'long' * 40}{size}", size) for size in (0, 1, 511, 512, 513, 100_000)]
    offline_bundle.write_bundle(parts, offline_bundle.manifest(parts, {}, "3.12", [], []), tmp_path / "b.tar")
    taken, reckoned = (tmp_path / "b.tar").stat().st_size, offline_bundle.bundle_size(parts)
    assert reckoned - offline_bundle.OVERHEAD < taken <= reckoned


def test_optional_parts_go_in_by_use_as_far_as_they_fit(tmp_path: Path) -> None:
    required = [part(tmp_path, "must", 1000)]
    useful, large, small = (part(tmp_path, *one) for one in (("useful", 50_000), ("large", 90_000), ("small", 5000)))
    optional = [useful, large, small]
    assert offline_bundle.fitting(required, optional, None) == ([*required, *optional], [])
    assert offline_bundle.fitting(required, optional, 100_000) == ([*required, useful, small], [large])
    exactly = offline_bundle.bundle_size(required)
    assert offline_bundle.fitting(required, optional, exactly) == (required, optional)
    with pytest.raises(offline_bundle.DoesNotFit, match=r"must 0\.0MB"):
        offline_bundle.fitting(required, optional, exactly - 1)


# ---- what of a wheel is kept -----------------------------------------------------------------------------


def test_of_mitsuba_what_the_variants_need_is_kept(tmp_path: Path) -> None:
    wheel = make_wheel(tmp_path, "mitsuba", "3.9", MITSUBA)
    kept = offline_bundle.trimmed(wheel, ["cuda_ad_rgb"])
    code = {"mitsuba/__init__.py", "mitsuba/config.py", "mitsuba/python/util.py"}
    libraries = {"mitsuba/libmitsuba.so", "mitsuba/libembree3.so", "mitsuba/plugins/path.so"}
    native = {f"mitsuba/{name}.{TAG}.so" for name in ("mitsuba_alias", "mitsuba_ext", "cuda_ad_rgb")}
    about = {f"mitsuba-3.9.dist-info/{name}" for name in ("METADATA", "RECORD", "WHEEL")}
    assert set(kept) == code | libraries | native | about | {"mitsuba/data/ior/Ag.eta.spd"}
    assert kept["mitsuba/plugins/path.so"] == (b"plugin", 0o755)
    assert kept["mitsuba/config.py"][1] == 0o644
    listed = kept["mitsuba-3.9.dist-info/RECORD"][0].decode().splitlines()
    assert {line.split(",")[0] for line in listed} == set(kept)


@pytest.mark.parametrize(
    ("variants", "files"),
    [
        (["cuda_ad_rgb", "llvm_ad_rgb"], ["cuda_ad_rgb", "llvm_ad_rgb"]),
        (["scalar_rgb"], ["scalar_rgb"]),
        (["llvm_ad_spectral"], ["llvm_ad_spectral", "srgb"]),
    ],
)
def test_variants_bring_their_file_and_spectral_ones_their_table(variants: list[str], files: list[str]) -> None:
    special = [name for name in MITSUBA if re.search(r"(cuda|llvm|scalar)_|srgb", name)]
    kept = [name for name in special if offline_bundle.is_kept(name, variants)]
    assert sorted(Path(name).name.split(".")[0] for name in kept) == sorted(files)


def test_a_variant_that_the_wheel_lacks_is_refused(tmp_path: Path) -> None:
    wheel = make_wheel(tmp_path, "mitsuba", "3.9", MITSUBA)
    offline_bundle.require_variants(wheel, ["llvm_ad_rgb", "cuda_ad_mono"])
    with pytest.raises(SystemExit, match="has no variant cuda_rgb; expected of cuda_ad_mono, cuda_ad_rgb, llvm_ad_rgb"):
        offline_bundle.require_variants(wheel, ["cuda_rgb", "llvm_ad_rgb"])


def test_of_llvm_the_library_is_kept_and_what_it_loads(tmp_path: Path) -> None:
    wheel = make_wheel(tmp_path, "karellen_llvm_core", "23.1", LLVM_FILES)
    found = {name: content for name, (content, _) in offline_bundle.llvm_files(wheel).items()}
    assert found == {
        "lib/libLLVM.so.23.1": b"LLVM",
        "lib/x86_64-unknown-linux-gnu/libc++.so.1": b"C++",
        "lib/x86_64-unknown-linux-gnu/libc++abi.so.1": b"exceptions",
        "lib/x86_64-unknown-linux-gnu/libunwind.so.1": b"unwinder",
    }
    with pytest.raises(SystemExit, match=r"other-1\.0-py3-none-any\.whl has no LLVM library"):
        offline_bundle.llvm_files(make_wheel(tmp_path, "other", "1.0", {}))


def test_what_is_packed_comes_back(tmp_path: Path) -> None:
    code = bytes(np.random.default_rng(0).integers(0, 256, 10_000, dtype=np.uint8)) + b"\xe8\0\0\0\0" * 100
    files = {"a/b.so": (code, 0o755), "a/c.py": (b"", 0o644)}
    offline_bundle.write_packed(files, tmp_path / "p.tar.xz")
    with tarfile.open(tmp_path / "p.tar.xz") as archive:
        back = {entry.name: (archive.extractfile(entry).read(), entry.mode) for entry in archive}
    assert back == files


# ---- weights ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("flavour", ["bvlc", "inception5h"])
def test_weights_in_half_precision_are_read_as_the_same_network(tmp_path: Path, flavour: str) -> None:
    source = random_googlenet(tmp_path / "w.safetensors", flavour, narrow=8)
    offline_bundle.write_half_precision(source, tmp_path / "h.safetensors")
    assert {tensor.dtype.name for tensor in safetensors.numpy.load_file(tmp_path / "h.safetensors").values()} == {
        "float16"
    }
    assert flavour_of(tmp_path / "h.safetensors") == flavour
    whole, half = read_weights(source).tensors, read_weights(tmp_path / "h.safetensors").tensors
    assert half.keys() == whole.keys()
    for name, tensor in half.items():
        assert tensor.dtype == whole[name].dtype
        np.testing.assert_allclose(tensor, whole[name], rtol=2**-11, atol=2**-25)


def test_weights_of_8_bits_stay_as_they_are(tmp_path: Path) -> None:
    source = random_googlenet(tmp_path / "w.safetensors", "patterns", narrow=8)
    offline_bundle.write_half_precision(source, tmp_path / "h.safetensors")
    assert (tmp_path / "h.safetensors").read_bytes() == source.read_bytes()


def test_weights_that_do_not_fit_half_precision_are_refused(tmp_path: Path) -> None:
    safetensors.numpy.save_file({"large": np.float32([1e5])}, tmp_path / "w.safetensors")
    with pytest.raises(SystemExit, match="'large' has values beyond the range of half precision"):
        offline_bundle.write_half_precision(tmp_path / "w.safetensors", tmp_path / "h.safetensors")
    (tmp_path / "w.safetensors").write_bytes(b"none")
    with pytest.raises(SystemExit, match=r"--weights .*w\.safetensors: cannot be read as \.safetensors"):
        offline_bundle.write_half_precision(tmp_path / "w.safetensors", tmp_path / "h.safetensors")


# ---- which packages --------------------------------------------------------------------------------------


def test_versions_are_read_from_constraints() -> None:
    text = "# comment\nJinja2==3.1.6\ntyping_extensions==4.16.0  # why\n\ntorch==2.13.0; python_version > '3'\nfree\n"
    assert offline_bundle.pinned_versions(text) == {"jinja2": "3.1.6", "typing-extensions": "4.16.0", "torch": "2.13.0"}


def test_requirements_of_other_systems_and_extras_are_passed_over() -> None:
    lines = [
        "A_b>=1",
        "c; extra == 'x'",
        "d; sys_platform == 'win32'",
        "e; python_version < '3.12'",
        "f; os_name != 'nt'",
    ]
    assert offline_bundle.needed_names(lines, "3.12") == ["a-b", "f"]
    assert offline_bundle.needed_names(lines, "3.11") == ["a-b", "e", "f"]


def test_a_wheel_fits_by_version_python_and_system(tmp_path: Path) -> None:
    for tag in ("cp311-cp311-manylinux_2_28_x86_64", "cp312-cp312-win_amd64", "cp312-cp312-musllinux_1_2_x86_64"):
        make_wheel(tmp_path, "one", "1.0", {}, tag)
    assert offline_bundle.find_wheel("one", "1.0", "3.12", tmp_path) is None
    fitting = make_wheel(tmp_path, "one", "1.0", {}, "cp312-cp312-manylinux2014_x86_64.manylinux_2_17_x86_64")
    assert offline_bundle.find_wheel("one", "1.0", "3.12", tmp_path) == fitting
    assert offline_bundle.find_wheel("one", "1.1", "3.12", tmp_path) is None
    stable = make_wheel(tmp_path, "T_wo", "1.0", {}, "cp39-abi3-manylinux_2_17_x86_64")
    assert offline_bundle.find_wheel("t-wo", "1.0", "3.12", tmp_path) == stable


def test_packages_are_followed_to_what_they_need(project: Path, tmp_path: Path) -> None:
    wheels = tmp_path / "wheels"
    found, expected = offline_bundle.collect_wheels({"numpy", "torch", "imageio-ffmpeg"}, VERSION, wheels, tmp_path)
    # Not `axle`, which the package of LLVM asks for: only its library is taken.
    assert set(found) == {"mitsuba", "drjit", "karellen-llvm-core", "small", "deep-er"}
    assert expected == ["imageio-ffmpeg", "numpy", "torch"]
    with pytest.raises(SystemExit, match=r"numpy is needed, but constraints\.txt has no version of it"):
        offline_bundle.collect_wheels({"torch"}, VERSION, wheels, tmp_path)


# ---- the bundle ------------------------------------------------------------------------------------------


def test_a_bundle_says_what_is_in_it(project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    weights = random_googlenet(tmp_path / "net.safetensors", narrow=8)
    assert bundle(tmp_path / "out", project, "--weights", weights) == 0
    facts = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert (facts["python"], facts["variants"]) == (VERSION, ["cuda_ad_rgb", "llvm_ad_rgb"])
    assert (facts["left_out"], facts["expected"]) == ({}, ["numpy", "torch"])
    contents = {entry["file"]: (entry["contents"], entry["version"]) for entry in facts["files"]}
    assert contents == {
        "site/mitsuba-3.9.tar.xz": ("mitsuba", "3.9"),
        "site/drjit-1.5.tar.xz": ("drjit", "1.5"),
        "llvm/karellen-llvm-core-23.1.tar.xz": ("karellen-llvm-core", "23.1"),
        "wheels/imageio_ffmpeg-0.8-py3-none-any.whl": ("imageio-ffmpeg", "0.8"),
        "wheels/small-1.0-py3-none-any.whl": ("small", "1.0"),
        "wheels/deep_er-2-py3-none-any.whl": ("deep-er", "2"),
        "weights/net_half.safetensors": ("weights", None),
        "project/tnst_mi.tar.xz": ("tnst_mi", None),
    }
    for entry in facts["files"]:
        content = (tmp_path / "out" / entry["file"]).read_bytes()
        assert (entry["bytes"], entry["sha256"]) == (len(content), hashlib.sha256(content).hexdigest())
    with tarfile.open(tmp_path / "out" / "project" / "tnst_mi.tar.xz") as archive:
        assert set(archive.getnames()) == {
            *("tnst_mi/__init__.py", "tnst_mi/cli.py", "pyproject.toml", "constraints.txt")
        }
    assert capsys.readouterr().out.splitlines()[-1].endswith("the machine is to have: numpy, torch")


def test_what_does_not_fit_is_left_out_and_said(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert bundle(tmp_path / "out.tar", project, "--limit", "150kB", "--without-project") == 0
    assert (tmp_path / "out.tar").stat().st_size <= 150_000
    left = "its 0.2MB do not fit; what does not work without it: reading and writing videos (.mp4)"
    assert f"left out: imageio-ffmpeg ({left})" in capsys.readouterr().out.splitlines()
    with tarfile.open(tmp_path / "out.tar") as archive:
        assert json.load(archive.extractfile("out/manifest.json"))["left_out"] == {"imageio-ffmpeg": left}
        assert not [name for name in archive.getnames() if "imageio" in name or "project" in name]


def test_llvm_is_left_out_where_no_variant_needs_it(project: Path, tmp_path: Path) -> None:
    assert bundle(tmp_path / "out", project, "--variants", "cuda_ad_rgb") == 0
    facts = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert facts["left_out"] == {"karellen-llvm-core": "only variants that run without it were asked for"}
    assert facts["expected"] == ["numpy", "torch"]
    assert not (tmp_path / "out" / "llvm").exists()


def test_a_limit_below_the_least_is_refused_in_a_line(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert bundle(tmp_path / "out.tar", project, "--limit", "1kB") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("offline_bundle: does not fit: the least takes 0.0MB of 0.0MB: ")
    assert all(name in line for name in ("mitsuba", "drjit", "small", "deep-er", "tnst_mi"))
    assert "imageio-ffmpeg" not in line and not (tmp_path / "out.tar").exists()


def test_only_an_earlier_bundle_is_replaced(project: Path, tmp_path: Path) -> None:
    for _ in range(2):
        assert bundle(tmp_path / "out", project) == 0
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "picture.png").touch()
    with pytest.raises(SystemExit, match="exists and is no earlier bundle"):
        bundle(mine, project)
    (tmp_path / "folder.tar").mkdir()
    with pytest.raises(SystemExit, match="is a folder"):
        bundle(tmp_path / "folder.tar", project)
    assert [path.name for path in mine.iterdir()] == ["picture.png"]


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--weights", "no.safetensors"), "--weights no.safetensors: no such file"),
        (("--wheels", "nowhere"), "--wheels nowhere: no such folder"),
        (("--variants", "cuda_rgb"), "has no variant cuda_rgb"),
    ],
)
def test_wrong_arguments_are_refused(project: Path, tmp_path: Path, more: tuple[str, ...], message: str) -> None:
    with pytest.raises(SystemExit, match=message):
        bundle(tmp_path / "out", project, *more)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("version", ["3", "2.7", "3.12.1", "cp312"])
def test_a_wrong_version_of_python_is_refused(version: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        offline_bundle.parse(["--out", "b.tar", "--python", version])
    assert f"{version!r} is no version of Python" in capsys.readouterr().err


# ---- the installer ---------------------------------------------------------------------------------------


def test_the_installer_makes_a_folder_that_runs(project: Path, tmp_path: Path) -> None:
    weights = random_googlenet(tmp_path / "net.safetensors", narrow=8)
    assert bundle(tmp_path / "out.tar", project, "--weights", weights) == 0
    with tarfile.open(tmp_path / "out.tar") as archive:
        archive.extractall(tmp_path / "far", filter="data")
    target = tmp_path / "a target"
    for _ in range(2):  # over an earlier installation
        installed = install(tmp_path / "far" / "out", target)
        assert installed.returncode == 0, installed.stderr
        stale = target / "site" / "stale.py"
        assert not stale.exists()
        stale.touch()
    assert installed.stdout == (target / "env.sh").read_text()
    assert not (target / "site" / "mitsuba" / "include").exists()
    shown = 'printf \'%s\\n\' "$PYTHONPATH" "$TNST_MI_WEIGHTS" "$DRJIT_LIBLLVM_PATH"; tnst-mi info \'a b\''
    environment = {"PATH": os.environ["PATH"], "PYTHONPATH": "/before"}
    ran = subprocess.run(
        ["bash", "-euc", f'. "$1"; {shown}', "-", target / "env.sh"],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ran.returncode, ran.stderr) == (3, "")
    assert ran.stdout.splitlines() == [
        f"{target}/project:{target}/site:/before",
        f"{target}/weights/net_half.safetensors",
        f"{target}/llvm/lib/libLLVM.so.23.1",
        "of a stand-in tnst-mi info a b",
    ]


def test_the_installer_without_the_project_leaves_the_path_to_it(project: Path, tmp_path: Path) -> None:
    assert bundle(tmp_path / "out", project, "--variants", "cuda_ad_rgb", "--without-project") == 0
    assert install(tmp_path / "out", tmp_path / "target").returncode == 0
    assert (tmp_path / "target" / "env.sh").read_text().splitlines() == [
        f"export PYTHONPATH={tmp_path}/target/site${{PYTHONPATH:+:$PYTHONPATH}}"
    ]


def test_the_installer_says_what_the_machine_lacks(project: Path, tmp_path: Path) -> None:
    assert bundle(tmp_path / "out", project) == 0
    facts = json.loads((tmp_path / "out" / "manifest.json").read_text())
    facts["expected"] += ["not-to-be-had"]
    (tmp_path / "out" / "manifest.json").write_text(json.dumps(facts))
    installed = install(tmp_path / "out", tmp_path / "target")
    assert installed.returncode == 0
    assert installed.stderr == "install.sh: this Python lacks what the bundle expects it to have: not-to-be-had\n"


def test_the_installer_refuses_what_it_cannot_install(project: Path, tmp_path: Path) -> None:
    assert bundle(tmp_path / "out", project) == 0
    taken = tmp_path / "taken"
    (taken / "site").mkdir(parents=True)
    refused = install(tmp_path / "out", taken)
    assert refused.returncode == 1 and "site exists, but no earlier installation" in refused.stderr

    wheel = next((tmp_path / "out" / "wheels").glob("small*"))
    content = wheel.read_bytes()
    wheel.write_bytes(content[:-1])
    refused = install(tmp_path / "out", tmp_path / "target")
    assert refused.returncode == 1 and "wheels/small-1.0-py3-none-any.whl is damaged" in refused.stderr
    wheel.write_bytes(content)

    facts = json.loads((tmp_path / "out" / "manifest.json").read_text())
    (tmp_path / "out" / "manifest.json").write_text(json.dumps(facts | {"python": "3.9"}))
    refused = install(tmp_path / "out", tmp_path / "target")
    assert refused.returncode == 1 and f"made for Python 3.9, this is {VERSION}" in refused.stderr
    assert list((tmp_path / "target").iterdir()) == []
