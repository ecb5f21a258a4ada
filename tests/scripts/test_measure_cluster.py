"""What is measured of runs on a cluster: bits on a tiny sequence, and what the numbers of larger ones come from."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("distributed", reason="needs tnst_mi[cluster]")

import measure_cluster
from cluster_measures import bits, memory, speed
from cluster_measures.costs import beside_tasks
from cluster_measures.hosts import NoHostsError, hosts
from cluster_measures.observed import Observed
from cluster_measures.part import Part
from cluster_measures.setting import Setting
from cluster_measures.smoke import TURN, digest, write_smoke
from cluster_measures.watching import Use

from tnst_mi.io import load_frames


def test_two_workers_come_to_the_bits_of_one_process_and_a_changed_bit_is_found(tmp_path: Path) -> None:
    keys = {"window": 3, "octaves": 1, "iterations": 2, "views": 1}
    part = bits.same(Setting(tmp_path, 2, (8, 12, 8), keys), (2,))
    assert part.holds == {"all results are the same": True} and list(part.values) == ["one process", "local:2"]
    before = digest(tmp_path / "run_2")
    assert before == part.values["local:2"]
    (changed, _) = sorted((tmp_path / "run_2" / "density").glob("*.npz"))
    content = bytearray(changed.read_bytes())
    content[-1] ^= 1
    changed.write_bytes(content)
    assert digest(tmp_path / "run_2") != before


def test_the_smoke_turns_as_its_velocity_says(tmp_path: Path) -> None:
    shape = (16, 24, 20)
    frames = list(load_frames(write_smoke(tmp_path / "frames", 3, shape)))
    z, y, x = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in shape), indexing="ij")
    angles = [np.arctan2(np.sum(frame.density * y), np.sum(frame.density * x)) for frame in frames]
    assert np.diff(angles) == pytest.approx([TURN, TURN], rel=0.05)
    assert frames[0].velocity is not None
    np.testing.assert_allclose(frames[0].velocity, np.stack([-TURN * y, TURN * x, 0 * z], -1), atol=1e-6)


def seen_of_a_worker(frames: int, iterations: int, seconds: float, beside: float) -> Observed:
    """What would be seen of a worker that takes so long for each task, and between two of them."""
    kinds = ["step"] * frames + ["average"] * frames
    kinds = ["inputs"] * frames + kinds * iterations + ["finish"] * frames
    tasks = [
        {"kind": kind, "level": 0, "seconds": seconds, "when": number * (seconds + beside)}
        for number, kind in enumerate(kinds)
    ]
    return Observed([task["when"] for task in tasks if task["kind"] == "step"], tasks)


def test_what_a_task_takes_beside_its_seconds_and_how_many_iterations_there_are_in_one() -> None:
    seen = seen_of_a_worker(12, 6, seconds=0.05, beside=0.002)
    assert beside_tasks(seen) == pytest.approx(2)
    # From the last step of the first iteration to the last of the fifth: 48 steps, and as many averages.
    assert speed._rate(seen) == pytest.approx(48 / (96 * 0.052))
    assert beside_tasks(seen_of_a_worker(12, 6, seconds=0.05, beside=0.0)) == pytest.approx(0, abs=1e-9)


def test_growth_of_memory_is_counted_within_phases() -> None:
    """A worker takes 100 MB more when it begins to iterate, which is no growth, and then 3 MB per 100 frames."""
    seen = seen_of_a_worker(200, 2, seconds=0.05, beside=0.0)
    for task in seen.tasks[120:200]:
        task["kind"] = "scales"
    phases = memory._phases(seen)
    assert list(phases.items()) == [
        *(("entering", (0, 120)), ("measuring", (120, 200))),
        *(("iterating", (200, 1000)), ("finishing", (1000, 1200))),
    ]
    when = np.linspace(0, 60, 1201)
    used = np.where(when < 10, 300.0, 400 + 6 * (when - 10) / 40)
    use = Use(when, {"worker 1": used}, {"worker 1": when / 2})
    begin, end, slope = memory._growth([task["when"] for task in seen.tasks[200:1000]], use, "worker 1", 200)
    assert (begin, end, slope) == pytest.approx((401.5, 406, 3), rel=0.01)
    assert use.cpu_between(10, 20) == pytest.approx(5)


def test_a_report_says_what_does_not_hold_and_so_does_the_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    part = Part("Speed", ["a table"], {"rate": 1.5}, {"fast": False, "there": True})
    monkeypatch.setattr(measure_cluster, "measure", lambda name: lambda folder: part)
    monkeypatch.setattr(sys, "argv", ["measure_cluster", "--only", "speed", "--json", str(tmp_path / "found.json")])
    assert measure_cluster.main() == 1
    told = capsys.readouterr().out
    assert "- **no**: fast\n- yes: there" in told and "a table" in told
    found = json.loads((tmp_path / "found.json").read_text())
    assert found == {"speed": {"holds": {"fast": False, "there": True}, "skipped": "", "rate": 1.5}}
    part.holds["fast"] = True
    assert measure_cluster.main() == 0


@pytest.mark.parametrize("name", measure_cluster.PARTS)
def test_every_part_is_there(name: str) -> None:
    assert callable(measure_cluster.measure(name))


def test_without_the_rights_there_are_no_hosts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    with pytest.raises(NoHostsError, match="need root"), hosts(2):
        pass
