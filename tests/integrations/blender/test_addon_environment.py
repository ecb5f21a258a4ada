"""The environment of tnst-mi as the Blender add-on finds, refuses and makes it."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import time
import zipfile
from pathlib import Path
from types import SimpleNamespace

import blender_addon  # noqa: F401  (makes tnst_mi_blender importable)
import psutil
import pytest
from tnst_mi_blender.processes import environment, installer, pythons
from tnst_mi_blender.processes.environment import EnvironmentMissing, Installation, find_environment
from tnst_mi_blender.processes.private import MARKER, installed_program, program_in
from tnst_mi_blender.version import VERSION

pytestmark = pytest.mark.skipif(os.name == "nt", reason="programs here are scripts of a shell")


def program(path: Path, says: str = f"tnst-mi {VERSION}", code: int = 0) -> Path:
    """A program that answers to --version."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'#!/bin/sh\n[ "$1" = --version ] && echo "{says}"\nexit {code}\n')
    path.chmod(0o755)
    return path


def private_one(private: Path) -> Path:
    """A private environment that is complete."""
    made = program(program_in(private / "env-1"))
    (private / MARKER).write_text(json.dumps({"folder": "env-1"}))
    return made


@pytest.fixture(autouse=True)
def bare(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A machine without tnst-mi, on whose PATH is one folder, which is empty."""
    monkeypatch.delenv("TNST_MI_PROGRAM", raising=False)
    (tmp_path / "path").mkdir()
    monkeypatch.setenv("PATH", str(tmp_path / "path"))
    return tmp_path / "path"


def refused(chosen: str = "", private: Path = Path("/nowhere")) -> str:
    with pytest.raises(EnvironmentMissing) as error:
        find_environment(chosen, private)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_where_there_is_none_the_remedy_is_told() -> None:
    assert refused() == (
        "tnst-mi is not installed: press Install in the preferences of the add-on, or name the tnst-mi of an "
        "environment there"
    )


def test_what_is_named_comes_first(bare: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    private = private_one(tmp_path / "private")
    found = find_environment("", tmp_path / "private")
    assert (found.program, found.origin, found.version) == (private, "private", VERSION)
    on_path = program(bare / "tnst-mi")
    assert find_environment("", tmp_path / "private").program == on_path
    variable = program(tmp_path / "variable" / "tnst-mi")
    monkeypatch.setenv("TNST_MI_PROGRAM", str(variable))
    assert find_environment("", tmp_path / "private").origin == "$TNST_MI_PROGRAM"
    chosen = program(program_in(tmp_path / "chosen"))
    for text in (str(chosen), str(tmp_path / "chosen")):  # the program, or its environment
        found = find_environment(text, tmp_path / "private")
        assert (found.program, found.origin) == (chosen, "preferences")


def test_what_is_named_is_not_replaced_by_another(bare: Path, tmp_path: Path) -> None:
    program(bare / "tnst-mi")
    said = refused(str(tmp_path / "none"))
    assert said.startswith(f"{tmp_path / 'none'} (preferences): no such program")


def test_another_version_is_named_with_both(tmp_path: Path) -> None:
    old = program(tmp_path / "old" / "tnst-mi", "tnst-mi 0.0.9")
    said = refused(str(old))
    assert str(old) in said and "is tnst-mi 0.0.9" in said and f"add-on is of {VERSION}" in said and "install" in said


def test_another_version_on_the_path_gives_way_to_a_private_one(bare: Path, tmp_path: Path) -> None:
    program(bare / "tnst-mi", "tnst-mi 0.0.9")
    assert "0.0.9" in refused("", tmp_path / "private")
    private = private_one(tmp_path / "private")
    assert find_environment("", tmp_path / "private").program == private


@pytest.mark.parametrize(("says", "code"), [("hello", 0), (f"tnst-mi {VERSION}", 1)])
def test_what_is_no_tnst_mi_is_refused(tmp_path: Path, says: str, code: int) -> None:
    assert "does not start as tnst-mi" in refused(str(program(tmp_path / "x", says, code)))


def test_a_program_whose_interpreter_is_gone_is_refused(tmp_path: Path) -> None:
    """As of an environment whose Python was removed with an older Blender."""
    gone = program(tmp_path / "tnst-mi")
    gone.write_text("#!/nowhere/python\n")
    assert "does not start as tnst-mi" in refused(str(gone))


def test_a_program_that_was_mended_is_asked_again(tmp_path: Path) -> None:
    mended = program(tmp_path / "tnst-mi", "tnst-mi 0.0.9")
    refused(str(mended))
    program(mended)
    os.utime(mended, (1, 1))
    assert find_environment(str(mended), tmp_path).version == VERSION


def test_a_program_whose_package_was_mended_is_asked_again(tmp_path: Path) -> None:
    """As by `pip install`, which leaves the file of the program as it is."""
    mended = program(tmp_path / "tnst-mi")
    package = program(tmp_path / "package", code=1)
    mended.write_text(f"#!/bin/sh\nexec {package} --version\n")
    before = mended.stat().st_mtime_ns
    assert "does not start as tnst-mi" in refused(str(mended))
    program(package, "tnst-mi 0.0.9")
    assert "is tnst-mi 0.0.9" in refused(str(mended))
    program(package)
    assert find_environment(str(mended), tmp_path).version == VERSION and mended.stat().st_mtime_ns == before


def test_a_program_that_can_be_used_is_asked_once_until_that_is_forgotten(tmp_path: Path) -> None:
    package = program(tmp_path / "package")
    used = program(tmp_path / "tnst-mi")
    used.write_text(f"#!/bin/sh\nexec {package} --version\n")
    assert find_environment(str(used), tmp_path).program == used
    package.unlink()
    assert find_environment(str(used), tmp_path).program == used
    environment.forget_checks()
    assert "does not start as tnst-mi" in refused(str(used))


@pytest.mark.parametrize("marker", [None, "", "{", "[]", '{"folder": 1}', '{"folder": "env-2"}'])
def test_without_its_marker_a_private_environment_is_none(tmp_path: Path, marker: str | None) -> None:
    private_one(tmp_path)
    (tmp_path / MARKER).unlink()
    if marker is not None:
        (tmp_path / MARKER).write_text(marker)
    assert "not installed" in refused("", tmp_path)


def test_an_installation_says_what_it_lacks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment, "CARRIED", tmp_path / "nothing")
    with pytest.raises(EnvironmentMissing, match="without the wheel"):
        Installation(tmp_path / "private", tmp_path / "log")
    with pytest.raises(EnvironmentMissing, match="is no checkout"):
        Installation(tmp_path / "private", tmp_path / "log", checkout=tmp_path)
    monkeypatch.setattr(pythons, "_makes_environments", lambda _: False)
    pythons.environment_python.cache_clear()
    (tmp_path / "pyproject.toml").touch()
    (tmp_path / "constraints.txt").touch()
    with pytest.raises(EnvironmentMissing, match=r"no Python 3\.11 or newer"):
        Installation(tmp_path / "private", tmp_path / "log", checkout=tmp_path)
    pythons.environment_python.cache_clear()
    assert not (tmp_path / "private").exists()


def test_a_python_that_is_too_old_is_passed_over(bare: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pythons, "own_python", lambda: program(bare / "python3.10", code=1))
    newer = program(bare / "python3.12")
    pythons.environment_python.cache_clear()
    assert pythons.environment_python() == newer
    pythons.environment_python.cache_clear()


def installed(monkeypatch: pytest.MonkeyPatch, private: Path, ends: BaseException | None = None) -> int:
    """Run the installer with what it does to a folder replaced."""

    def install(folder: Path, version: str, source: Path, constraints: Path) -> None:
        program(program_in(folder))
        assert installed_program(private) != program_in(folder)
        if ends is not None:
            raise ends

    monkeypatch.setattr(installer, "_install", install)
    monkeypatch.setattr(installer.shutil, "disk_usage", lambda _: SimpleNamespace(free=10**12))
    return installer.main(private, MARKER, VERSION, Path("wheel"), Path("constraints"))


def in_folder(private: Path) -> set[str]:
    """What is in the folder of the private environment, but for the lock, which stays."""
    return {path.name for path in private.iterdir()} - {".lock", "path"}


def test_an_installation_replaces_the_earlier_one_in_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert installed(monkeypatch, tmp_path) == 0
    first = find_environment("", tmp_path).program
    assert installed(monkeypatch, tmp_path) == 0
    second = find_environment("", tmp_path).program
    assert first != second and not first.exists()
    assert in_folder(tmp_path) == {MARKER, second.parents[1].name}


@pytest.mark.parametrize("after", ["replace", "unlink"])
def test_an_interruption_after_the_last_step_comes_too_late(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: str
) -> None:
    """The marker names the new environment: it has to stay."""
    assert installed(monkeypatch, tmp_path) == 0
    first = find_environment("", tmp_path).program
    of_system = {"replace": os.replace, "unlink": Path.unlink}[after]

    def interrupted(*arguments: object, **keys: object) -> None:
        of_system(*arguments, **keys)
        if (tmp_path / MARKER).read_text() and installed_program(tmp_path) != first:
            raise KeyboardInterrupt

    monkeypatch.setattr(installer.os if after == "replace" else Path, after, interrupted)
    assert installed(monkeypatch, tmp_path) == 0
    monkeypatch.undo()
    second = installed_program(tmp_path)
    assert second is not None and second != first and in_folder(tmp_path) == {MARKER, second.parents[1].name}


def test_an_interrupted_removal_is_completed_by_the_next_installation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert installed(monkeypatch, tmp_path) == 0
    first = find_environment("", tmp_path).program

    def interrupted(_folder: Path, **_keys: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as context:
        context.setattr(installer.shutil, "rmtree", interrupted)
        assert installed(context, tmp_path) == 0
    assert first.exists() and find_environment("", tmp_path).program != first
    assert installed(monkeypatch, tmp_path) == 0
    assert not first.exists() and len(in_folder(tmp_path)) == 2


def test_there_is_one_installation_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of two Blenders, or of two machines that share a home; one that was killed does not count."""
    holder = [sys.executable, "-c", HOLDER, str(Path(installer.__file__).parent), str(tmp_path)]
    with subprocess.Popen(holder, stdout=subprocess.PIPE) as other:
        try:
            assert other.stdout is not None and other.stdout.readline() == b"locked\n"
            going_on = tmp_path / "env-other"
            going_on.mkdir()
            assert installed(monkeypatch, tmp_path) == 1
            assert capsys.readouterr().out == (
                f"ERROR: {tmp_path}: another installation is going on there, of another Blender perhaps; wait for its "
                "end\n"
            )
            assert in_folder(tmp_path) == {"env-other"}
        finally:
            other.kill()
    assert installed(monkeypatch, tmp_path) == 0 and not going_on.exists()


#: Takes the lock of an installation, and keeps it.
HOLDER = """
import pathlib, sys, time
sys.path.insert(0, sys.argv[1])
import installer
folder = pathlib.Path(sys.argv[2])
lock = (folder / installer._LOCK).open("ab")
installer._take(lock, folder)
print("locked", flush=True)
time.sleep(600)
"""


def commands(monkeypatch: pytest.MonkeyPatch, says: str = f"tnst-mi {VERSION}") -> list[list[str]]:
    """The commands that installations run from here on, of which nothing is done."""
    ran = list[list[str]]()

    def run(command: list[object], **_keys: object) -> subprocess.CompletedProcess[bytes]:
        ran.append([str(each) for each in command])
        return subprocess.CompletedProcess(command, 0, f"{says}\n".encode())

    monkeypatch.setattr(installer.subprocess, "run", run)
    return ran


@pytest.mark.parametrize(("checkout", "source"), [(False, ["{}"]), (True, ["-e", "{}"])])
def test_the_commands_are_those_of_the_readme_apart_from_all_other_packages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, checkout: bool, source: list[str]
) -> None:
    """With the versions that were tested, and -I: what is on a PYTHONPATH is not in the environment."""
    given, ran = tmp_path / "source", commands(monkeypatch)
    given.mkdir() if checkout else given.touch()
    installer._install(tmp_path / "env-1", VERSION, given, tmp_path / "constraints.txt")
    python = str(tmp_path / "env-1" / "bin" / "python")
    quiet = ["--disable-pip-version-check", "--no-input", "--progress-bar", "off"]
    pip = [python, "-I", "-m", "pip", "install", *quiet, "-c", str(tmp_path / "constraints.txt")]
    assert ran == [
        [sys.executable, "-I", "-m", "venv", str(tmp_path / "env-1")],
        [*pip, *(each.format(given) for each in source)],
        [python, "-I", "-m", "tnst_mi", "--version"],
    ]


def test_a_checkout_of_another_version_leaves_the_earlier_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with monkeypatch.context() as context:
        assert installed(context, tmp_path) == 0
    earlier, before = find_environment("", tmp_path).program, in_folder(tmp_path)
    monkeypatch.setattr(installer.shutil, "disk_usage", lambda _: SimpleNamespace(free=10**12))
    commands(monkeypatch, "tnst-mi 9.9.9")
    assert installer.main(tmp_path, MARKER, VERSION, tmp_path, tmp_path / "constraints.txt") == 1
    assert capsys.readouterr().out.splitlines()[-1] == (
        f"ERROR: {tmp_path}: is tnst-mi 9.9.9, and this add-on is of {VERSION}; name a checkout of that version, or "
        "install the add-on that is built from this checkout"
    )
    assert installed_program(tmp_path) == earlier and in_folder(tmp_path) == before


@pytest.mark.parametrize(
    ("ends", "code"), [(KeyboardInterrupt(), 3), (subprocess.CalledProcessError(1, ["/env/bin/python"]), 1)]
)
def test_an_installation_that_ends_early_leaves_the_earlier_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ends: BaseException, code: int
) -> None:
    assert installed(monkeypatch, tmp_path) == 0
    earlier, before = find_environment("", tmp_path).program, sorted(tmp_path.rglob("*"))
    assert installed(monkeypatch, tmp_path, ends) == code
    assert find_environment("", tmp_path).program == earlier and sorted(tmp_path.rglob("*")) == before


def test_an_installation_that_cannot_be_written_is_told_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert installed(monkeypatch, tmp_path / "file" / "private") == 1
    assert capsys.readouterr().out == f"ERROR: {tmp_path / 'file' / 'private'}: Not a directory\n"
    private = tmp_path / "private"
    assert installed(monkeypatch, private, OSError(errno.ENOSPC, "No space left", "a.py")) == 1
    assert capsys.readouterr().out == "ERROR: a.py: No space left\n"
    assert installed(monkeypatch, private, OSError(errno.ENOSPC, "No space left")) == 1  # of a write: it has no name
    assert capsys.readouterr().out == f"ERROR: {private}: No space left\n"
    assert in_folder(private) == set()


def test_what_does_not_fit_is_refused_before_it_is_downloaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran = commands(monkeypatch)
    free = SimpleNamespace(free=1_900_000_000)
    monkeypatch.setattr(installer.shutil, "disk_usage", lambda _: free)
    assert installer.main(tmp_path, MARKER, VERSION, tmp_path, tmp_path) == 1
    assert capsys.readouterr().out == (
        f"ERROR: {tmp_path}: 1.9 GB are free on its disk, and the environment takes about 2 GB, with the torch of CUDA "
        "several times as much; free some space\n"
    )
    assert ran == [] and in_folder(tmp_path) == set()


def test_of_a_program_that_failed_on_a_full_disk_the_disk_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """venv says nothing but that ensurepip has failed."""

    def full(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(installer.os, "fsync", full)
    assert installed(monkeypatch, tmp_path, subprocess.CalledProcessError(1, ["venv"])) == 1
    said = capsys.readouterr().out
    assert said.startswith(f"ERROR: {tmp_path}: cannot be written to (No space left on device); ") and "2 GB" in said
    assert said.count("\n") == 1 and in_folder(tmp_path) == set()


def test_one_that_was_killed_is_no_environment_and_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left = program(program_in(tmp_path / "env-left"))  # complete or not: no marker names it
    assert "not installed" in refused("", tmp_path)
    assert installed(monkeypatch, tmp_path) == 0
    assert not left.exists()


def wheel(folder: Path, version: str = VERSION) -> Path:
    """A wheel named tnst_mi without dependencies, whose program answers to --version."""
    made = folder / f"tnst_mi-{version}-py3-none-any.whl"
    info = f"tnst_mi-{version}.dist-info"
    with zipfile.ZipFile(made, "w") as archive:
        archive.writestr("tnst_mi/__init__.py", f"def main():\n    print('tnst-mi {version}')\n")
        archive.writestr("tnst_mi/__main__.py", "from tnst_mi import main\nmain()\n")
        archive.writestr(f"{info}/METADATA", f"Metadata-Version: 2.1\nName: tnst_mi\nVersion: {version}\n")
        archive.writestr(
            f"{info}/WHEEL", "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        )
        archive.writestr(f"{info}/entry_points.txt", "[console_scripts]\ntnst-mi = tnst_mi:main\n")
        archive.writestr(f"{info}/RECORD", "")
    return made


@pytest.fixture
def carried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What the zip carries, here a wheel that needs nothing else; installed by this Python."""
    (tmp_path / "carried").mkdir()
    (tmp_path / "carried" / "constraints.txt").write_text("numpy==2.4.6\n")
    monkeypatch.setattr(environment, "CARRIED", tmp_path / "carried")
    pythons.environment_python.cache_clear()
    return tmp_path / "carried"


def test_a_real_installation(carried: Path, tmp_path: Path) -> None:
    wheel(carried)
    job = Installation(tmp_path / "private folder", tmp_path / "job.log")
    job.start()
    texts = set()
    while not job.finished:
        texts.add(job.poll().text)
        time.sleep(0.02)
    texts.add(job.poll().text)
    assert (job.exit_code, job.error) == (0, None)
    assert {"making the environment", "installing 1 packages, this takes a while"} & texts
    assert job.poll().text == "trying it"
    found = find_environment("", tmp_path / "private folder")
    assert found.origin == "private" and found.program.is_relative_to(tmp_path / "private folder")


def test_a_real_installation_that_fails(carried: Path, tmp_path: Path) -> None:
    (carried / f"tnst_mi-{VERSION}-py3-none-any.whl").write_bytes(b"no zip")
    job = Installation(tmp_path / "private", tmp_path / "job.log")
    job.start()
    while not job.finished:
        time.sleep(0.02)
    assert job.exit_code == 1 and job.error is not None and "ERROR: " in job.error
    assert in_folder(tmp_path / "private") == set() and "not installed" in refused("", tmp_path / "private")


def test_an_installation_that_is_cancelled_leaves_nothing(carried: Path, tmp_path: Path) -> None:
    wheel(carried)
    job = Installation(tmp_path / "private", tmp_path / "job.log")
    job.start()
    while job.poll().text != "making the environment":
        time.sleep(0.02)
    job.cancel()
    while not job.finished:
        time.sleep(0.02)
    assert job.exit_code == 3 and job.error is None
    assert in_folder(tmp_path / "private") == set()
    assert not any(
        str(tmp_path) in " ".join(process.info["cmdline"] or ()) for process in psutil.process_iter(["cmdline"])
    )
