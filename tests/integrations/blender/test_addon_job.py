"""Jobs of the Blender add-on: watched without waiting, and ended with all that they have started."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import blender_addon
import psutil
import pytest
from tnst_mi_blender.processes import job as job_module
from tnst_mi_blender.processes import supervisor
from tnst_mi_blender.processes.job import Job

posix = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")

#: Writes its number and that of a child, then waits; what it does on Ctrl-C comes first.
SLEEPER = """
import os, signal, subprocess, sys, time
{handling}
child = subprocess.Popen([sys.executable, "-c", {child!r}])
open({pids!r} + ".part", "w").write(f"{{os.getpid()}} {{child.pid}}")
os.rename({pids!r} + ".part", {pids!r})
time.sleep(600)
"""

DEAF = "signal.signal(signal.SIGINT, signal.SIG_IGN); signal.signal(signal.SIGTERM, signal.SIG_IGN)"
SLEEP = "import time; time.sleep(600)"


def sleeper(pids: Path, handling: str = "", child: str = SLEEP) -> list[str]:
    return [sys.executable, "-c", SLEEPER.format(handling=handling, child=child, pids=str(pids))]


def until(condition, seconds: float = 20.0) -> bool:
    """Whether something comes true in time."""
    end = time.monotonic() + seconds
    while not (true := condition()) and time.monotonic() < end:
        time.sleep(0.01)
    return bool(true)


def numbers(pids: Path) -> list[int]:
    assert until(pids.exists)
    return [int(text) for text in pids.read_text().split()]


def alive(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def ended(job: Job) -> int | None:
    assert until(lambda: job.finished)
    return job.exit_code


def test_what_is_done_has_no_error(tmp_path: Path) -> None:
    job = Job([sys.executable, "-c", "print('λ')"], tmp_path / "new" / "job.log")
    assert not job.finished and job.exit_code is None
    job.start()
    assert ended(job) == 0 and job.error is None
    assert job.log.read_text("utf-8").strip() == "λ"


def test_bad_input_is_told_as_the_program_tells_it(tmp_path: Path) -> None:
    job = Job([sys.executable, "-m", "tnst_mi", "info", str(tmp_path / "none.vdb")], tmp_path / "job.log")
    job.start()
    assert ended(job) == 2
    assert job.error is not None and job.error.startswith("tnst-mi: ") and "none.vdb" in job.error
    assert "\n" not in job.error


def test_of_other_failures_the_end_of_the_log_is_told(tmp_path: Path) -> None:
    job = Job([sys.executable, "-c", "raise SystemExit('\\n'.join(map(str, range(100))))"], tmp_path / "job.log")
    job.start()
    assert ended(job) == 1 and job.error == "95\n96\n97\n98\n99"


def test_failures_without_a_word_are_told(tmp_path: Path) -> None:
    job = Job([sys.executable, "-c", "raise SystemExit(7)"], tmp_path / "job.log")
    job.start()
    assert ended(job) == 7 and job.error is not None and "exit code 7" in job.error


def test_a_program_that_cannot_be_started_is_named(tmp_path: Path) -> None:
    job = Job([str(tmp_path / "tnst-mi")], tmp_path / "job.log")
    job.start()
    assert ended(job) == 127
    assert job.error == f"tnst-mi: cannot start {tmp_path / 'tnst-mi'}: No such file or directory"


@posix
def test_a_program_that_was_killed_is_told(tmp_path: Path) -> None:
    """As by a system without memory: the end of its log says nothing about it."""
    job = Job([sys.executable, "-c", "import os; print(1, flush=True); os.kill(os.getpid(), 9)"], tmp_path / "job.log")
    job.start()
    assert ended(job) == 137
    assert job.error is not None and "was killed, as systems do when memory runs out" in job.error


@posix
def test_cancel_is_ctrl_c_and_leaves_nothing_of_the_group(tmp_path: Path) -> None:
    """The program ends with 3, as tnst-mi does; a child of it that ignores everything is killed."""
    handling = "signal.signal(signal.SIGINT, lambda *_: sys.exit(3))"
    deaf_child = f"import signal, time; {DEAF}; time.sleep(600)"
    job = Job(sleeper(tmp_path / "pids", handling, deaf_child), tmp_path / "job.log")
    job.start()
    program, child = numbers(tmp_path / "pids")
    assert os.getpgid(program) == program == os.getpgid(child) != os.getpgid(0)
    assert psutil.Process(program).nice() == min(19, os.nice(0) + 10)  # Blender stays usable
    assert not job.finished and job.exit_code is None and job.error is None
    begun = time.monotonic()
    job.cancel()
    assert time.monotonic() - begun < 1  # it does not wait
    assert job.finished or job.poll().text == "stopping after the current step"
    assert ended(job) == 3 and job.cancelled and job.error is None
    assert until(lambda: not alive(program) and not alive(child))
    job.cancel()  # once more does no harm


@posix
def test_what_does_not_end_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (blender_addon.ADDON / "processes" / "supervisor.py").read_text("utf-8")
    assert "PATIENCE = 20.0, 5.0" in text
    (tmp_path / "hasty.py").write_text(text.replace("PATIENCE = 20.0, 5.0", "PATIENCE = 0.2, 0.2"), "utf-8")
    monkeypatch.setattr(job_module, "_SUPERVISOR", tmp_path / "hasty.py")
    job = Job(sleeper(tmp_path / "pids", DEAF), tmp_path / "job.log")
    job.start()
    program, child = numbers(tmp_path / "pids")
    job.cancel()
    assert ended(job) == 128 + signal.SIGKILL
    assert until(lambda: not alive(program) and not alive(child))


@posix
def test_a_supervisor_that_is_killed_leaves_no_process(tmp_path: Path) -> None:
    """Neither the program nor what that has started, however deaf they are; and what the job says is true."""
    job = Job(sleeper(tmp_path / "pids", DEAF, f"import signal, time; {DEAF}; time.sleep(600)"), tmp_path / "job.log")
    job.start()
    program, child = numbers(tmp_path / "pids")
    parent = psutil.Process(psutil.Process(program).ppid())
    own = [parent, *parent.children(recursive=True)]
    assert len(own) == 4  # and the one that has to see to it
    parent.kill()
    assert ended(job) == 137
    assert job.error is not None and "was killed, as systems do when memory runs out" in job.error
    assert until(lambda: not any(alive(process.pid) for process in own))
    assert not alive(program) and not alive(child)


@posix
def test_what_a_program_leaves_behind_ends_with_it(tmp_path: Path) -> None:
    script = """
import pathlib, subprocess, sys
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
pathlib.Path(sys.argv[1]).write_text(str(child.pid))
"""
    job = Job([sys.executable, "-c", script, str(tmp_path / "pid")], tmp_path / "job.log")
    job.start()
    assert ended(job) == 0
    left = int((tmp_path / "pid").read_text())
    assert until(lambda: not alive(left))


@posix
def test_a_request_that_fails_is_followed_by_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    """On Windows, asking by Ctrl-Break may raise SystemError (CPython 112190)."""

    def broken(_child: object) -> None:
        raise SystemError("<built-in function kill> returned a result with an exception set")

    monkeypatch.setattr(supervisor, "PATIENCE", (0.05, 0.05))
    monkeypatch.setattr(supervisor, "_interrupt", broken)
    monkeypatch.setattr(supervisor, "_terminate", broken)
    asked = threading.Event()
    asked.set()
    with subprocess.Popen([sys.executable, "-c", SLEEP], start_new_session=True) as child:
        try:
            supervisor._end(child, asked, threading.Event())
            assert child.wait(10) == -signal.SIGKILL
        finally:
            child.kill()


@posix
def test_what_is_cancelled_before_it_starts_ends_at_once(tmp_path: Path) -> None:
    job = Job(["sleep", "60"], tmp_path / "job.log")
    job.cancel()
    assert not job.finished
    job.start()
    assert ended(job) == 128 + signal.SIGINT and job.error is None


PARENT = """
import signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)  # as of a program that a script has started in the background
sys.path[:0] = {paths!r}
import blender_addon
from pathlib import Path
from tnst_mi_blender.processes.job import Job
job = Job({command!r}, Path({log!r}))
job.start()
signal.pause()
"""


@posix
def test_a_parent_that_is_killed_leaves_no_process(tmp_path: Path) -> None:
    """As Blender that crashes: it can clean up nothing."""
    helpers = [str(Path(blender_addon.__file__).parent)]
    command = sleeper(tmp_path / "pids")
    script = PARENT.format(paths=helpers, command=command, log=str(tmp_path / "job.log"))
    with subprocess.Popen([sys.executable, "-c", script]) as parent:
        program, child = numbers(tmp_path / "pids")
        supervisor = psutil.Process(program).ppid()
        assert psutil.Process(supervisor).ppid() == parent.pid and alive(child)
        parent.kill()
    assert until(lambda: not any(map(alive, (program, child, supervisor))))


def test_watching_does_not_wait(tmp_path: Path) -> None:
    job = Job([sys.executable, "-c", SLEEP], tmp_path / "job.log")
    assert job.poll().fraction is None
    job.start()
    begun = time.monotonic()
    for _ in range(20):
        job.poll()
        assert not job.finished
    assert time.monotonic() - begun < 2
    job.cancel()
    ended(job)
