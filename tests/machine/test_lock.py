"""Two runs into one folder: the second is refused; the lock of a dead run is not believed."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from tnst_mi.errors import InputError, StoppedError
from tnst_mi.machine import lock
from tnst_mi.machine.lock import LOCK, locked, require_unlocked
from tnst_mi.machine.terminal import LONGEST

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


def test_each_run_of_a_process_has_a_lock_of_its_own(tmp_path: Path) -> None:
    """Workers of a run compare its contents before they write."""
    contents = []
    for _ in range(2):
        with locked(tmp_path):
            contents.append((tmp_path / LOCK).read_bytes())
    assert contents[0] != contents[1]


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


@pytest.mark.parametrize(
    "content",
    [
        *("", "{", "[]", "7", "[" * 4096, "\xff", '{"pid": 1}', '{"host": "elsewhere"}', '{"host": 7, "pid": 1}'),
        *(
            '{"host": "elsewhere", "pid": "1"}',
            '{"host": "elsewhere", "pid": 0}',
            f'{{"host": "", "pid": 1{"0" * 400}}}',
        ),
        *('{"host": "elsewhere", "pid": 1, "started": "x"}', '{"host": "elsewhere", "pid": 1, "started": 1}'),
    ],
)
def test_a_lock_that_lost_its_contents_or_names_no_process_is_not_believed(tmp_path: Path, content: str) -> None:
    (tmp_path / LOCK).write_bytes(content.encode("latin-1"))
    require_unlocked(tmp_path)
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


@pytest.mark.parametrize("ticks", [True, False])
@pytest.mark.parametrize(("later", "lives"), [(0.0, True), (30.0, False)])
def test_where_the_system_has_no_locks_a_process_is_told_by_number_and_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, later: float, lives: bool, ticks: bool
) -> None:
    """A number that another process has now is not the one that wrote the lock."""
    monkeypatch.setattr(lock, "_fcntl", None)
    if not ticks:
        monkeypatch.setattr(lock, "_BOOT", tmp_path / "nowhere")
    with locked(tmp_path):
        holder = json.loads((tmp_path / LOCK).read_text())
        holder["started"] += later
        (tmp_path / LOCK).write_text(json.dumps(holder))
        if lives:
            with pytest.raises(InputError, match=HERE):
                require_unlocked(tmp_path)
        else:
            require_unlocked(tmp_path)


@pytest.mark.skipif(sys.platform != "linux", reason="others have no start of processes but by the clock")
def test_where_the_system_has_no_locks_a_clock_that_is_changed_makes_no_process_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lock, "_fcntl", None)
    with locked(tmp_path):
        started = psutil.Process.create_time
        monkeypatch.setattr(psutil.Process, "create_time", lambda process: started(process) + 3600.0)
        with pytest.raises(InputError, match=HERE):
            require_unlocked(tmp_path)
        holder = json.loads((tmp_path / LOCK).read_text())
        (tmp_path / LOCK).write_text(json.dumps(holder | {"boot": "an earlier one"}))
        require_unlocked(tmp_path)


@pytest.mark.skipif(os.name != "posix", reason="the system has none of these")
@pytest.mark.parametrize("what", ["link", "link to nothing", "second name", "folder", "pipe", "socket"])
def test_what_is_no_lock_file_is_refused_and_left_as_it_is(tmp_path: Path, what: str) -> None:
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    out.mkdir()
    elsewhere.write_text("precious")
    path = out / LOCK
    with socket.socket(socket.AF_UNIX) as listener:
        if what == "link":
            path.symlink_to(elsewhere)
        elif what == "link to nothing":
            path.symlink_to(tmp_path / "nowhere")
        elif what == "second name":
            path.hardlink_to(elsewhere)
        elif what == "folder":
            path.mkdir()
        elif what == "pipe":
            os.mkfifo(path)
        else:
            # Names of sockets may not be long.
            with contextlib.chdir(out):
                listener.bind(LOCK)
        for _ in range(2):
            with pytest.raises(InputError, match=r"\.lock: is a link, or no plain file.*; remove it"):
                require_unlocked(out)
            with pytest.raises(InputError, match=r"\.lock: is a link, or no plain file.*; remove it"), locked(out):
                pass
    assert elsewhere.read_text() == "precious" and not (tmp_path / "nowhere").exists()


def test_a_link_that_takes_the_place_of_the_lock_is_not_the_lock(tmp_path: Path) -> None:
    path = tmp_path / LOCK
    with locked(tmp_path) as held:
        path.rename(tmp_path / "moved")
        path.symlink_to(tmp_path / "moved")
        with pytest.raises(StoppedError, match="moved, removed or replaced"):
            held.require_held()
    assert path.is_symlink()


def test_what_a_lock_file_says_cannot_flood_or_control_the_terminal(tmp_path: Path) -> None:
    holder = {"host": "\x1b[2J" + "x\n" * 900, "pid": 7}
    (tmp_path / LOCK).write_text(json.dumps(holder))
    with pytest.raises(InputError, match="process 7 on x x") as told:
        require_unlocked(tmp_path)
    assert len(str(told.value)) <= LONGEST and str(told.value).isprintable()


@pytest.mark.skipif(lock._fcntl is None, reason="the system has no locks")
def test_those_who_only_look_are_in_nobodys_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / LOCK).touch()
    with (tmp_path / LOCK).open("rb") as looking:
        lock._fcntl.flock(looking, lock._fcntl.LOCK_SH)
        require_unlocked(tmp_path)
        # One who wants to write waits until they have looked.
        monkeypatch.setattr(lock.time, "sleep", lambda seconds: lock._fcntl.flock(looking, lock._fcntl.LOCK_UN))
        with locked(tmp_path) as held:
            held.require_held()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_a_child_that_ends_leaves_its_parent_s_lock(tmp_path: Path) -> None:
    program = (
        "import os, sys; from pathlib import Path; from tnst_mi.machine.lock import *\n"
        "from tnst_mi.errors import StoppedError\n"
        "parent, out = os.getpid(), Path(sys.argv[1])\n"
        "with locked(out) as held:\n"
        "    if os.fork() == 0:\n"
        "        try:\n"
        "            held.require_held()\n"
        "        except StoppedError as error:\n"
        "            print(error)\n"
        "    else:\n"
        "        os.wait()\n"
        "        held.require_held()\n"
        "        print((out / LOCK).exists())\n"
        "print(os.getpid() == parent, (out / LOCK).exists(), flush=True)\n"
        "os._exit(0)\n"  # what libraries do at the end of a forked child is not the matter here
    )
    command = [sys.executable, "-c", program, tmp_path]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert ended.returncode == 0, ended.stderr
    told, *rest = ended.stdout.splitlines()
    assert re.search(r"process (\d+) writes there, from which process (?!\1)\d+ was forked", told)
    assert rest == ["False True", "True", "True False"]


def test_the_lock_of_a_killed_process_ends_though_its_child_lives(tmp_path: Path) -> None:
    program = (
        "import os, signal, sys; from pathlib import Path; from tnst_mi.machine.lock import locked\n"
        "with locked(Path(sys.argv[1])):\n"
        "    if os.fork() == 0:\n"
        "        sys.stdin.read()\n"  # until the test ends it
        "        os._exit(0)\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program, tmp_path], stdin=subprocess.PIPE) as parent:
        assert parent.wait(60) == -signal.SIGKILL
        assert (tmp_path / LOCK).exists()
        require_unlocked(tmp_path)
        with locked(tmp_path) as held:
            held.require_held()


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

    def late(descriptor: int, exclusive: bool) -> bool | None:
        if not calls:
            (tmp_path / LOCK).unlink()
        calls.append(descriptor)
        return take(descriptor, exclusive)

    monkeypatch.setattr(lock, "_system_lock", late)
    with locked(tmp_path) as held:
        held.require_held()
    assert len(calls) == 2
