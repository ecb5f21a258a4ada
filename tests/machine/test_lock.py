"""Two runs into one folder: the second is refused; the lock of a dead run is not believed."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from tnst_mi.errors import InputError, StoppedError
from tnst_mi.machine import lock
from tnst_mi.machine.lock import LOCK, locked, require_unlocked

HERE = f"process {os.getpid()} on {platform.node()}"


def test_a_second_run_is_refused_until_the_first_has_ended(tmp_path: Path) -> None:
    with locked(tmp_path) as held:
        held.require_held()
        for _ in range(2):
            with pytest.raises(InputError, match=rf"another run is writing there \({HERE}\); wait for its end"):
                require_unlocked(tmp_path)
            with pytest.raises(InputError, match=HERE), locked(tmp_path):
                pass
        held.require_held()
    assert list(tmp_path.iterdir()) == []
    require_unlocked(tmp_path)
    require_unlocked(tmp_path / "nowhere")
    with locked(tmp_path):
        pass


def test_the_lock_of_a_killed_process_is_not_believed(tmp_path: Path) -> None:
    program = (
        "import os, signal, sys; from pathlib import Path; from tnst_mi.machine.lock import locked\n"
        "with locked(Path(sys.argv[1])): os.kill(os.getpid(), signal.SIGKILL)"
    )
    assert subprocess.run([sys.executable, "-c", program, tmp_path], check=False).returncode != 0
    assert json.loads((tmp_path / LOCK).read_text())["pid"] != os.getpid()
    require_unlocked(tmp_path)
    with locked(tmp_path):
        assert json.loads((tmp_path / LOCK).read_text())["pid"] == os.getpid()


@pytest.mark.parametrize("content", ["", "{", "[]", "7"])
def test_a_lock_that_lost_its_contents_with_the_power_is_not_believed(tmp_path: Path, content: str) -> None:
    (tmp_path / LOCK).write_text(content)
    with locked(tmp_path) as held:
        held.require_held()


def test_a_process_on_another_machine_is_believed_until_its_lock_is_removed(tmp_path: Path) -> None:
    (tmp_path / LOCK).write_text(json.dumps({"host": "elsewhere", "pid": 1, "started": 0.0}))
    for _ in range(2):
        with (
            pytest.raises(
                InputError, match=r"\(process 1 on elsewhere\), which cannot be asked from here; .*remove .*\.lock"
            ),
            locked(tmp_path),
        ):
            pass
    (tmp_path / LOCK).unlink()
    require_unlocked(tmp_path)


@pytest.mark.parametrize(("later", "lives"), [(0.0, True), (30.0, False)])
def test_where_the_system_has_no_locks_a_process_is_told_by_number_and_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, later: float, lives: bool
) -> None:
    """A number that another process has now is not the one that wrote the lock."""
    monkeypatch.setattr(lock, "_fcntl", None)
    holder = {"host": platform.node(), "pid": os.getpid(), "started": psutil.Process().create_time() + later}
    (tmp_path / LOCK).write_text(json.dumps(holder))
    if lives:
        with pytest.raises(InputError, match=HERE):
            require_unlocked(tmp_path)
    else:
        require_unlocked(tmp_path)


@pytest.mark.parametrize("what", ["moved", "replaced", "unlocked"])
def test_a_folder_that_is_no_longer_the_locked_one_is_noticed(tmp_path: Path, what: str) -> None:
    out = tmp_path / "out"
    out.mkdir()
    with locked(out) as held:
        if what == "unlocked":
            (out / LOCK).unlink()
        else:
            out.rename(tmp_path / "elsewhere")
        if what == "replaced":
            out.mkdir()
            (out / LOCK).write_text("another's")
        with pytest.raises(StoppedError, match="has been moved, removed or replaced during its run"):
            held.require_held()
    assert (out / LOCK).exists() == (what == "replaced")


def test_one_that_took_the_lock_while_another_removed_it_tries_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between opening the file and locking it, the one that held the lock ends, and takes the file with it."""
    (tmp_path / LOCK).touch()
    take, calls = lock._system_lock, []

    def late(descriptor: int) -> bool | None:
        if not calls:
            (tmp_path / LOCK).unlink()
        calls.append(descriptor)
        return take(descriptor)

    monkeypatch.setattr(lock, "_system_lock", late)
    with locked(tmp_path) as held:
        held.require_held()
    assert len(calls) == 2
