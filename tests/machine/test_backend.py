"""Choosing LLVM and the variant: every source of the library, bad choices, and how imports and switches behave."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import pytest

import tnst_mi
from tnst_mi.machine import backend

#: Defines `image()`: the plugin in a small scene, and `expected()`: the same by `tnst_mi.render`.
SCENE = """
import mitsuba as mi, numpy as np, tnst_mi
density = np.random.default_rng(0).random((4, 5, 6)).astype(np.float32)
def image():
    to_world = mi.ScalarTransform4f()
    return mi.render(mi.load_dict({
        "type": "scene",
        "integrator": {"type": "emission_absorption", "gamma": 0.5},
        "sensor": {
            "type": "orthographic_views", "distance": 50.0,
            "film": {"type": "hdrfilm", "width": 6, "height": 5, "pixel_format": "luminance",
                     "component_format": "float32", "rfilter": {"type": "box"}},
            "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
        },
        "smoke": {
            "type": "cube", "to_world": to_world.scale([3, 2.5, 2]), "bsdf": {"type": "null"},
            "interior": {"type": "heterogeneous", "sigma_t": {
                "type": "gridvolume", "grid": mi.VolumeGrid(0.5 * density[..., None]),
                "to_world": to_world.scale([6, 5, 4]).translate(-0.5),
            }},
        },
    })).numpy()[..., 0]
def expected():
    return tnst_mi.render(density, gamma=0.5)
"""


def run(program: str) -> list[str]:
    """The lines printed by a Python program in a process of its own, where no LLVM was chosen yet."""
    chosen = ("DRJIT_LIBLLVM_PATH", "_TNST_MI_LIBLLVM_PATH")
    environment = {name: value for name, value in os.environ.items() if name not in chosen}
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout.split("\n")[:-1]


# --------------------------------------------------------------------
# The LLVM library
# --------------------------------------------------------------------


@pytest.fixture
def environment(monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Environment variables of a process in which nothing was chosen yet."""
    variables: dict[str, str] = {}
    monkeypatch.setattr(os, "environ", variables)
    return variables


@pytest.fixture
def system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a system's libraries, still empty; no LLVM is installed by pip."""
    folder = tmp_path / "system"
    folder.mkdir()
    monkeypatch.setattr(backend, "_SYSTEM_LIBRARY_FOLDERS", (str(tmp_path / "sys*"),))
    monkeypatch.setattr(backend, "_wheel_llvm", lambda: None)
    return folder


def add(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).touch()


@pytest.mark.parametrize(
    ("names", "chosen", "version"),
    [
        (["libLLVM-16.so.1"], "libLLVM-16.so.1", 16),
        (["libLLVM.so.19.1"], "libLLVM.so.19.1", 19),
        (["libLLVM-17.so"], "libLLVM-17.so", 17),
        (["libLLVM-18.1.8.so"], "libLLVM-18.1.8.so", 18),
        (["libLLVM-19.dylib"], "libLLVM-19.dylib", 19),
        (["libLLVM-9.so.1", "libLLVM-16.so.1", "libLLVM.so.19.1", "libLLVM-18.so.1"], "libLLVM.so.19.1", 19),
        (["libLLVM-14.0.6.so.1", "libLLVM-14.so", "libLLVM-14.so.1", "libLLVM-15.so.1", "libLLVM.so.15.0"], None, 0),
        (["libLLVM.so", "libLLVM-C.so.19", "libLLVM-16.so.1.old", "libLLVMSupport.so.19", "libLLVM19.a"], None, 0),
        ([], None, 0),
    ],
)
def test_the_newest_system_library_from_16_on_is_chosen(
    environment: dict, system: Path, names: list[str], chosen: str | None, version: int
) -> None:
    add(system, *names)
    found = backend.llvm_library()
    if chosen is None:
        assert found is None
    else:
        assert (found.path, found.version) == (system / chosen, version)
        assert found.reason == "newest LLVM of the system that is 16 or newer"


def test_a_link_that_leads_nowhere_is_not_chosen(environment: dict, system: Path) -> None:
    add(system, "libLLVM-16.so.1")
    (system / "libLLVM-19.so").symlink_to(system / "libLLVM-19.so.1")
    assert backend.llvm_library().path == system / "libLLVM-16.so.1"


def test_the_user_s_choice_wins_whatever_it_is(environment: dict, system: Path, tmp_path: Path) -> None:
    add(system, "libLLVM-19.so.1")
    add(tmp_path, "libLLVM-14.so.1", "libLLVM-20.so.1")
    (tmp_path / "my-llvm.so").symlink_to(tmp_path / "libLLVM-20.so.1")
    for name, version in (("libLLVM-14.so.1", 14), ("my-llvm.so", 20)):
        environment["DRJIT_LIBLLVM_PATH"] = str(tmp_path / name)
        found = backend.llvm_library()
        assert (found.path, found.version, found.reason) == (tmp_path / name, version, "named by DRJIT_LIBLLVM_PATH")


def test_our_own_choice_is_not_taken_for_the_user_s(environment: dict, system: Path) -> None:
    """A child process inherits what its parent chose, and chooses anew."""
    add(system, "libLLVM-17.so.1")
    backend.select_llvm()
    assert environment["DRJIT_LIBLLVM_PATH"] == str(system / "libLLVM-17.so.1")
    assert backend.llvm_library().reason.startswith("newest LLVM of the system")
    add(system, "libLLVM-18.so.1")
    backend.select_llvm()
    assert environment["DRJIT_LIBLLVM_PATH"] == str(system / "libLLVM-18.so.1")


def test_selecting_respects_the_user_s_choice(environment: dict, system: Path) -> None:
    add(system, "libLLVM-17.so.1")
    environment["DRJIT_LIBLLVM_PATH"] = "/opt/libLLVM-16.so"
    for _ in range(2):
        backend.select_llvm()
        assert environment["DRJIT_LIBLLVM_PATH"] == "/opt/libLLVM-16.so"
        assert backend.llvm_library().reason == "named by DRJIT_LIBLLVM_PATH"


@pytest.mark.parametrize(
    ("system_names", "installed", "expected"),
    [
        (["libLLVM-14.so.1"], "libLLVM.so.23.1", "wheel"),
        (["libLLVM-16.so.1"], "libLLVM.so.23.1", "system"),
        (["libLLVM-15.so.1"], "libLLVM.so.15.0", None),
        ([], None, None),
    ],
)
def test_the_library_installed_by_pip_comes_after_the_system_s(
    environment: dict,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    system_names: list[str],
    installed: str | None,
    expected: str | None,
) -> None:
    system, site = tmp_path / "system", tmp_path / "site"
    package = site / "karellen_llvm_core-23.1.4.dist-info"
    system.mkdir()
    package.mkdir(parents=True)
    monkeypatch.setattr(backend, "_SYSTEM_LIBRARY_FOLDERS", (str(system),))
    monkeypatch.syspath_prepend(site)
    add(system, *system_names)
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: karellen-llvm-core\nVersion: 23.1.4\n")
    (package / "RECORD").write_text(
        "libLLVM-gone.so.22.1,,\nlibLLVM.so.99.1,,\n" + (f"{installed},,\n" * bool(installed))
    )
    if installed:
        add(site, installed)
    found = backend.llvm_library()
    if expected is None:
        assert found is None
    elif expected == "system":
        assert found.path == system / "libLLVM-16.so.1"
    else:
        assert (found.path, found.version) == ((site / installed).resolve(), 23)
        assert found.reason == "package karellen-llvm-core (the system has no LLVM 16 or newer)"


@pytest.mark.parametrize(
    ("loaded", "usable", "parts"),
    [
        (15, "/usr/lib/libLLVM-19.so.1", ["has loaded LLVM 15", "DRJIT_LIBLLVM_PATH=/usr/lib/libLLVM-19.so.1"]),
        (0, "/usr/lib/libLLVM-19.so.1", ["found no LLVM", "DRJIT_LIBLLVM_PATH=/usr/lib/libLLVM-19.so.1"]),
        (15, None, ["no LLVM library 16 or newer was found", "pip install karellen-llvm-core"]),
        (0, None, ["no LLVM library 16 or newer was found", "pip install karellen-llvm-core"]),
    ],
)
def test_an_unusable_llvm_is_reported_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch, loaded: int, usable: str | None, parts: list[str]
) -> None:
    library = backend.LlvmLibrary(Path(usable), 19, "") if usable else None
    monkeypatch.setattr(backend, "_loaded_llvm", lambda: loaded)
    monkeypatch.setattr(backend, "llvm_library", lambda: library)
    monkeypatch.setattr(backend, "select_llvm", lambda: None)
    for call in (backend.check_llvm, lambda: tnst_mi.activate("llvm_ad_rgb")):
        with pytest.raises(tnst_mi.InputError) as error:
            call()
        assert all(part in str(error.value) for part in parts), error.value
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(("loaded", "name"), [(15, "libLLVM-15.so.1"), (0, "missing.so")])
def test_an_unusable_choice_of_the_user_is_not_recommended(
    environment: dict, system: Path, monkeypatch: pytest.MonkeyPatch, loaded: int, name: str
) -> None:
    environment["DRJIT_LIBLLVM_PATH"] = str(system / name)
    monkeypatch.setattr(backend, "_loaded_llvm", lambda: loaded)
    with pytest.raises(tnst_mi.InputError, match="DRJIT_LIBLLVM_PATH") as error:
        backend.check_llvm()
    assert f"set DRJIT_LIBLLVM_PATH={system / name}" not in str(error.value)
    assert str(system / name) in str(error.value)


def test_llvm_16_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backend, "_loaded_llvm", lambda: 16)
    backend.check_llvm()


# --------------------------------------------------------------------
# The variant
# --------------------------------------------------------------------


def test_activating_again_changes_nothing(variant: str) -> None:
    changes = []
    note = lambda old, new: changes.append(new)  # noqa: E731
    mi.detail.add_variant_callback(note)
    plugin = tnst_mi.rendering.march.integrator.EmissionAbsorption
    assert [tnst_mi.activate(), tnst_mi.activate(variant), tnst_mi.activate()] == [variant] * 3
    mi.detail.remove_variant_callback(note)
    assert mi.variant() == variant
    assert changes == []
    assert tnst_mi.rendering.march.integrator.EmissionAbsorption is plugin


@pytest.mark.parametrize("name", ["scalar_rgb", "llvm_ad_mono", "gpu", ""])
def test_an_unsupported_variant_is_named(variant: str, name: str) -> None:
    with pytest.raises(tnst_mi.InputError, match=rf"variant '{name}' .*expected one of cuda_ad_rgb, llvm_ad_rgb"):
        tnst_mi.activate(name)
    assert mi.variant() == variant


def test_a_gpu_variant_without_a_gpu_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    has_backend = dr.has_backend
    monkeypatch.setattr(dr, "has_backend", lambda kind: kind != dr.JitBackend.CUDA and has_backend(kind))
    monkeypatch.setattr(mi, "variant", lambda: "llvm_ad_rgb")
    with pytest.raises(tnst_mi.InputError, match=r"needs an NVIDIA GPU .*use llvm_ad_rgb"):
        tnst_mi.activate("cuda_ad_rgb")


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="the system has no CPU affinity")
def test_all_allowed_cores_and_no_others_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    cores = len(os.sched_getaffinity(0))
    try:
        for allowed in ({0}, {0, 1, 2}):
            monkeypatch.setattr(os, "sched_getaffinity", lambda process, allowed=allowed: allowed)
            tnst_mi.activate()
            assert dr.thread_count() == torch.get_num_threads() == len(allowed)
    finally:
        monkeypatch.undo()
        tnst_mi.activate()
    assert dr.thread_count() == torch.get_num_threads() == cores


def test_torch_shares_the_variant_s_memory(variant: str) -> None:
    assert backend.torch_device().type == ("cuda" if variant.startswith("cuda") else "cpu")


# --------------------------------------------------------------------
# Imports and switches, each in a process of its own
# --------------------------------------------------------------------


def test_importing_the_package_sets_no_variant_and_imports_no_torch() -> None:
    program = "import sys, tnst_mi, mitsuba as mi; print(mi.variant(), 'torch' in sys.modules, dir(tnst_mi))"
    assert run(program) == [f"None False {dir(tnst_mi)}"]


def test_numeric_functions_work_without_torch_and_pick_a_variant_themselves() -> None:
    program = SCENE + "print(expected().shape, mi.variant()[-7:], 'torch' in __import__('sys').modules)"
    assert run(program) == ["(5, 6) _ad_rgb False"]


def test_mitsuba_may_be_imported_first() -> None:
    """Dr.Jit has loaded the system's LLVM by then, whatever its version; it must end up with a usable one."""
    program = (
        "import mitsuba"
        + SCENE
        + (
            "import drjit as dr\n"
            "print(mi.variant())\n"
            "tnst_mi.activate('llvm_ad_rgb')\n"
            "print(dr.detail.llvm_version()[0] >= 16)\n"
            "print(dr.minimum(mi.Float(1, 2), mi.Float(2, 1)))\n"
            "print(abs(image() - expected()).max() < 1e-5)\n"
        )
    )
    assert run(program) == ["None", "True", "[1, 1]", "True"]


def test_a_variant_may_be_active_before_the_import_if_its_llvm_is_usable() -> None:
    """Else there is an error that says what to do, never an aborted process."""
    program = (
        "import mitsuba as mi, drjit as dr\n"
        "mi.set_variant('llvm_ad_rgb')\n"
        "usable = dr.detail.llvm_version()[0] >= 16\n"
        "try:\n"
        "    import tnst_mi\n"
        "    mi.load_dict({'type': 'emission_absorption'})\n"
        "    print(usable)\n"
        "except ValueError as error:\n"
        "    print(not usable and 'import tnst_mi before a variant is set' in str(error))\n"
    )
    assert run(program) == ["True"]


def test_the_plugins_follow_every_change_of_the_variant() -> None:
    program = SCENE + (
        "for variant in ('llvm_ad_rgb', 'llvm_ad_mono', 'scalar_rgb', 'llvm_ad_mono', 'llvm_ad_rgb'):\n"
        "    mi.set_variant(variant)\n"
        "    images = image() if 'ad' in variant else None\n"
        "    if variant == 'llvm_ad_rgb':\n"
        "        first = expected()\n"
        "    print(variant, images is None or bool(abs(images - first).max() < 1e-5))\n"
    )
    assert run(program) == [
        f"{variant} True" for variant in ("llvm_ad_rgb", "llvm_ad_mono", "scalar_rgb", "llvm_ad_mono", "llvm_ad_rgb")
    ]


def test_public_functions_leave_an_unsupported_variant() -> None:
    program = SCENE + (
        "mi.set_variant('llvm_ad_rgb')\n"
        "first = expected()\n"
        "mi.set_variant('scalar_rgb')\n"
        "print((expected() == first).all(), mi.variant())\n"
    )
    assert run(program)[0].startswith("True ")
