"""Progress: bars on terminals, and in logs a few plain lines."""

from __future__ import annotations

import io
import time

import pytest

from tnst_mi.errors import InputError
from tnst_mi.machine.progress_bar import PlainProgress, SteadyProgress, progress_bar
from tnst_mi.optimisation.result import Progress
from tnst_mi.run.progress import ProgressBar
from tnst_mi.run.time_left import OctaveSize


class Terminal(io.StringIO):
    """A stream that is one."""

    def isatty(self) -> bool:
        return True


def lines(monkeypatch: pytest.MonkeyPatch, steps: int, seconds: float) -> list[str]:
    """What a log has after so many steps, each of which takes so many seconds."""
    log, now = io.StringIO(), [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    with PlainProgress(total=steps, desc="reading", file=log) as bar:
        for _ in range(steps):
            now[0] += seconds
            bar.update()
            bar.write("a line of its own", file=io.StringIO())
    assert "\r" not in log.getvalue() and "\x1b" not in log.getvalue()
    return log.getvalue().splitlines()


def test_a_log_has_a_line_for_each_tenth(monkeypatch: pytest.MonkeyPatch) -> None:
    written = lines(monkeypatch, 200, 0.5)
    assert [line.split("%")[0] for line in written] == [f"reading: {share:3d}" for share in range(10, 101, 10)]
    assert all("<" in line for line in written)  # the time left


def test_slow_work_has_a_line_each_half_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(lines(monkeypatch, 100, 10.0)) == 34


def test_programs_that_follow_a_log_choose_how_often_it_has_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    log, now = io.StringIO(), [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr("sys.stderr", log)
    monkeypatch.setenv("TNST_MI_PROGRESS_SECONDS", "2")
    with progress_bar(total=100) as bar:
        for _ in range(100):
            now[0] += 1.0
            bar.update()
    assert len(log.getvalue().splitlines()) == 50
    for text in ("often", "0", "-1", "nan", ""):
        monkeypatch.setenv("TNST_MI_PROGRESS_SECONDS", text)
        with pytest.raises(InputError, match=r"^\$TNST_MI_PROGRESS_SECONDS = '.*': expected seconds above 0"):
            progress_bar(total=100)


def test_short_work_has_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    (line,) = lines(monkeypatch, 100, 0.005)
    assert "100%" in line


def test_terminals_get_bars(monkeypatch: pytest.MonkeyPatch) -> None:
    for stream, kind in ((Terminal(), SteadyProgress), (io.StringIO(), PlainProgress)):
        monkeypatch.setattr("sys.stderr", stream)
        with progress_bar(total=2) as bar:
            bar.update(2)
        assert type(bar) is kind and ("\r" in stream.getvalue()) == (kind is SteadyProgress)


def test_times_are_not_those_of_the_wall_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which may be set back in the middle."""
    monkeypatch.setattr("tqdm.std.time", iter(range(10**6, 0, -3600)).__next__)
    for stream in (Terminal(), io.StringIO()):
        monkeypatch.setattr("sys.stderr", stream)
        with progress_bar(total=2, mininterval=0) as bar:
            bar.update()
            bar.update()
        assert "2/2 [00:00<00:00" in stream.getvalue() and "-" not in stream.getvalue()


def test_lines_of_logs_keep_the_format_of_the_bar() -> None:
    log = io.StringIO()
    layout = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} [1:02<3:04{postfix}]"
    with PlainProgress(total=2, desc="frame", bar_format=layout, postfix="loss 3", file=log) as bar:
        bar.update(2)
    assert log.getvalue() == "frame: 100% 2/2 [1:02<3:04, loss 3]\n"


@pytest.mark.parametrize("says", ["set_description", "set_description_str"])
def test_lines_have_one_colon_and_none_without_a_description(says: str) -> None:
    for words, begins in (("reading", "reading: 100% 2/2 ["), ("", "100% 2/2 [")):
        log = io.StringIO()
        with PlainProgress(total=2, file=log) as bar:
            getattr(bar, says)(words, refresh=False)
            bar.update(2)
        assert log.getvalue().startswith(begins)


def test_the_lines_of_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """In logs and on terminals."""
    monkeypatch.setattr(time, "perf_counter", lambda: 0.0)
    begins, ends = "frame_0005 octave 1/1: 100%", "1/1 [00:00<00:00, iteration 1/1, loss 0.5]"
    for stream in (log := io.StringIO(), terminal := Terminal()):
        monkeypatch.setattr("sys.stderr", stream)
        bar = ProgressBar(True, [OctaveSize(8, 4, 1)], 8, 1)
        bar.advance(Progress("frame_0005", 0, 1, 0, 1, 0.5, {}, 1, 1))
        bar.close()
    assert log.getvalue() == f"{begins} {ends}\n"
    assert f"\r{begins}|" in terminal.getvalue()
