"""The LLVM library: every place that it is found in, and bad choices."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import tnst_mi
from tnst_mi.machine import llvm, loaded_llvm


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
    monkeypatch.setattr(llvm, "_SYSTEM_LIBRARY_FOLDERS", (str(tmp_path / "sys*"),))
    monkeypatch.setattr(llvm, "_wheel_llvm", lambda: None)
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
    found = llvm.llvm_library()
    if chosen is None:
        assert found is None
    else:
        assert (found.path, found.version) == (system / chosen, version)
        assert found.reason == "newest LLVM of the system that is 16 or newer"


def test_a_link_that_leads_nowhere_is_not_chosen(environment: dict, system: Path) -> None:
    add(system, "libLLVM-16.so.1")
    (system / "libLLVM-19.so").symlink_to(system / "libLLVM-19.so.1")
    assert llvm.llvm_library().path == system / "libLLVM-16.so.1"


def test_the_user_s_choice_wins_whatever_it_is(environment: dict, system: Path, tmp_path: Path) -> None:
    add(system, "libLLVM-19.so.1")
    add(tmp_path, "libLLVM-14.so.1", "libLLVM-20.so.1")
    (tmp_path / "my-llvm.so").symlink_to(tmp_path / "libLLVM-20.so.1")
    for name, version in (("libLLVM-14.so.1", 14), ("my-llvm.so", 20)):
        environment["DRJIT_LIBLLVM_PATH"] = str(tmp_path / name)
        found = llvm.llvm_library()
        assert (found.path, found.version, found.reason) == (tmp_path / name, version, "named by DRJIT_LIBLLVM_PATH")


def test_our_own_choice_is_not_taken_for_the_user_s(environment: dict, system: Path) -> None:
    """A child process inherits what its parent chose, and chooses anew."""
    add(system, "libLLVM-17.so.1")
    llvm.choose_llvm()
    assert environment["DRJIT_LIBLLVM_PATH"] == str(system / "libLLVM-17.so.1")
    assert llvm.llvm_library().reason.startswith("newest LLVM of the system")
    add(system, "libLLVM-18.so.1")
    llvm.choose_llvm()
    assert environment["DRJIT_LIBLLVM_PATH"] == str(system / "libLLVM-18.so.1")


def test_selecting_respects_the_user_s_choice(environment: dict, system: Path) -> None:
    add(system, "libLLVM-17.so.1")
    environment["DRJIT_LIBLLVM_PATH"] = "/opt/libLLVM-16.so"
    for _ in range(2):
        llvm.choose_llvm()
        assert environment["DRJIT_LIBLLVM_PATH"] == "/opt/libLLVM-16.so"
        assert llvm.llvm_library().reason == "named by DRJIT_LIBLLVM_PATH"


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
    monkeypatch.setattr(llvm, "_SYSTEM_LIBRARY_FOLDERS", (str(system),))
    monkeypatch.syspath_prepend(site)
    add(system, *system_names)
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: karellen-llvm-core\nVersion: 23.1.4\n")
    (package / "RECORD").write_text(
        "libLLVM-gone.so.22.1,,\nlibLLVM.so.99.1,,\n" + (f"{installed},,\n" * bool(installed))
    )
    if installed:
        add(site, installed)
    found = llvm.llvm_library()
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
    library = llvm.LlvmLibrary(Path(usable), 19, "") if usable else None
    monkeypatch.setattr(loaded_llvm, "loaded_version", lambda: loaded)
    monkeypatch.setattr(loaded_llvm, "llvm_library", lambda: library)
    for call in (loaded_llvm.check_llvm, lambda: tnst_mi.activate("llvm_ad_rgb")):
        with pytest.raises(tnst_mi.InputError) as error:
            call()
        assert all(part in str(error.value) for part in parts), error.value
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(("loaded", "name"), [(15, "libLLVM-15.so.1"), (0, "missing.so")])
def test_an_unusable_choice_of_the_user_is_not_recommended(
    environment: dict, system: Path, monkeypatch: pytest.MonkeyPatch, loaded: int, name: str
) -> None:
    environment["DRJIT_LIBLLVM_PATH"] = str(system / name)
    monkeypatch.setattr(loaded_llvm, "loaded_version", lambda: loaded)
    with pytest.raises(tnst_mi.InputError, match="DRJIT_LIBLLVM_PATH") as error:
        loaded_llvm.check_llvm()
    assert f"set DRJIT_LIBLLVM_PATH={system / name}" not in str(error.value)
    assert str(system / name) in str(error.value)


def test_llvm_16_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loaded_llvm, "loaded_version", lambda: 16)
    loaded_llvm.check_llvm()
