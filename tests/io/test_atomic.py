"""Files appear whole, in an order that a loss of power cannot turn around, and failures name the file."""

from __future__ import annotations

import errno
import os
import threading
from pathlib import Path

import pytest

from tnst_mi.io import atomic
from tnst_mi.io.atomic import append, make_folder, remove_folder, remove_unfinished, sync, write_failure, written_whole


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What reaches the disk, in its order; folders by their names."""
    found: list[str] = []
    fsync, replace = os.fsync, os.replace

    def synced(descriptor: int) -> None:
        found.append(f"sync {Path(os.readlink(f'/proc/self/fd/{descriptor}')).name}")
        fsync(descriptor)

    def replaced(source: Path, target: Path) -> None:
        found.append(f"rename to {Path(target).name}")
        replace(source, target)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", replaced)
    return found


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="needs /proc to name what is synced")
def test_contents_are_on_the_disk_before_their_name_and_folders_before_their_files(
    steps: list[str], tmp_path: Path
) -> None:
    with written_whole(tmp_path / "a" / "b" / "c.txt") as temporary:
        temporary.write_text("whole")
    hidden = f".tnst_mi-c.{atomic._MACHINE}.{os.getpid():x}.{threading.get_native_id():x}.txt"
    assert steps == [f"sync {tmp_path.name}", "sync a", f"sync {hidden}", "rename to c.txt", "sync b"]
    steps.clear()
    with written_whole(tmp_path / "a" / "d.txt", durable=False) as temporary:
        temporary.write_text("whole")
    append(tmp_path / "a" / "d.txt", "r")
    assert steps == ["rename to d.txt"]
    sync(tmp_path / "a" / "d.txt")
    assert steps[1:] == ["sync d.txt"]


@pytest.mark.parametrize("where", ["written", "published"])
def test_what_fails_is_named_and_leaves_the_earlier_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    path = tmp_path / "a.txt"
    path.write_text("earlier")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    if where == "published":
        monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="No space left") as told, written_whole(path) as temporary:
        temporary.write_text("later")
        if where == "written":
            full()
    assert told.value.filename == str(path)
    assert path.read_text() == "earlier" and list(tmp_path.iterdir()) == [path]


def test_failures_of_others_keep_their_names(tmp_path: Path) -> None:
    """Of a file that is read while another is written."""
    with pytest.raises(FileNotFoundError) as told, written_whole(tmp_path / "a.txt"):
        (tmp_path / "source").read_text()
    assert told.value.filename == str(tmp_path / "source")


def test_folders_go_in_one_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_folder(tmp_path / "a" / "b")
    (tmp_path / "a" / "b" / "c").touch()
    remove_folder(tmp_path / "nowhere")
    with monkeypatch.context() as patch, pytest.raises(OSError, match="killed"):
        patch.setattr(atomic.shutil, "rmtree", lambda folder: (_ for _ in ()).throw(OSError("killed")))
        remove_folder(tmp_path / "a")
    assert not (tmp_path / "a").exists()
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".tnst_mi-a.")
    remove_unfinished(tmp_path)
    assert not any(tmp_path.iterdir())


def test_links_and_files_of_others_are_left_alone(tmp_path: Path) -> None:
    elsewhere, out = tmp_path / "elsewhere", tmp_path / "out"
    for path in (elsewhere / ".tnst_mi-a.1.npz", elsewhere / "kept" / "b", out / ".notes.2.txt"):
        make_folder(path.parent)
        path.touch()
    (out / "images").symlink_to(elsewhere)
    (out / ".tnst_mi-a.1.removed").symlink_to(elsewhere / "kept")
    remove_unfinished(out)
    remove_unfinished(out / "images")
    assert sorted(path.name for path in out.iterdir()) == [".notes.2.txt", "images"]
    assert (elsewhere / ".tnst_mi-a.1.npz").exists() and (elsewhere / "kept" / "b").exists()


def test_a_folder_cannot_be_made_below_a_file(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OSError):
        make_folder(tmp_path / "file" / "below")


def test_folders_that_cannot_be_synced_are_left_to_their_file_system(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failure = [errno.EINVAL]

    def fails(descriptor: int) -> None:
        raise OSError(failure[0], os.strerror(failure[0]))

    (tmp_path / "a").touch()
    monkeypatch.setattr(os, "fsync", fails)
    sync(tmp_path)
    with pytest.raises(OSError):
        sync(tmp_path / "a")
    failure[0] = errno.EIO
    with pytest.raises(OSError):
        sync(tmp_path)


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO])
def test_the_system_is_asked_why_a_library_could_not_write(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(descriptor: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fails)
    error = write_failure(tmp_path / "a.exr", "the library's words")
    told = f"the library's words ({os.strerror(number)})"
    assert (error.errno, error.strerror, error.filename) == (number, told, str(tmp_path / "a.exr"))
    monkeypatch.undo()
    assert write_failure(tmp_path / "a.exr", "it works now").errno == errno.EIO
    assert not any(tmp_path.iterdir())
