"""scripts/plan_cluster.py against closed forms: times, bytes read and written, and what the store holds."""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from pathlib import Path

import numpy as np
import plan_cluster
import pytest
from cluster_plan.graph import BARRIER, graph_of
from cluster_plan.items import Cache, Item
from cluster_plan.measured import Cost, Measured, read_measured
from cluster_plan.recorded import measured_by
from cluster_plan.simulation import Cluster, Prediction, simulate
from PIL import Image

from tnst_mi import InputError, Recipe

#: Seconds are sums of powers of two, so that their sums are exact in whatever order.
WINDOWED = Measured(
    window=5,
    iterations=(3, 2),
    costs={
        ("inputs", 0): Cost(0.25, 700, 400),
        ("inputs", 1): Cost(0.5, 700, 2400),
        ("fields", 0): Cost(0.25, None, 100),
        ("fields", 1): Cost(0.5, 100, 600),
        ("gain", 0): Cost(0.125, 5 * 400, 10),
        ("gain", 1): Cost(0.25, 5 * 2400, 60),
        ("scales", 0): Cost(0.5, 500),
        ("scales", 1): Cost(1.0, 3000),
        ("step", 0): Cost(1.0, 500, 30),
        ("step", 1): Cost(4.0, 3000, 180),
        ("average", 0): Cost(0.5, 100 + 10 + 5 * (400 + 30), 100),
        ("average", 1): Cost(2.0, 600 + 60 + 5 * (2400 + 180), 600),
        ("finish", 1): Cost(8.0, 1300, 4000),
    },
    prepare_seconds=16.0,
    conclude_seconds=32.0,
)
ALONE = Measured(
    1,
    (5, 5),
    {("inputs", 0): Cost(0.0), ("inputs", 1): Cost(0.0), ("fields", 0): Cost(0.0), ("fields", 1): Cost(0.0)}
    | {("iterate", 0): Cost(2.0), ("iterate", 1): Cost(6.0), ("finish", 1): Cost(1.0)},
)

#: Tasks of each frame: their kinds, and how many of each.
COUNTS = {("step", 0): 3, ("average", 0): 3, ("step", 1): 2, ("average", 1): 2}


def predicted(measured: Measured, frames: int, **cluster: float) -> Prediction:
    return simulate(measured, graph_of(measured, frames), Cluster(**{"workers": 1} | cluster))


def work(measured: Measured, frames: int) -> float:
    return frames * sum(cost.seconds * COUNTS.get(of, 1) for of, cost in measured.costs.items())


def serial(measured: Measured) -> float:
    return measured.prepare_seconds + measured.conclude_seconds


@pytest.mark.parametrize(("measured", "counts"), [(WINDOWED, COUNTS), (ALONE, {})])
def test_one_worker_takes_the_sum_of_all_times(measured: Measured, counts: dict) -> None:
    found = predicted(measured, 7)
    each = sum(cost.seconds * counts.get(of, 1) for of, cost in measured.costs.items())
    assert found.seconds == serial(measured) + 7 * each
    assert found.idle == 0 and found.stolen == 0


def test_as_many_workers_as_can_be_used_take_the_longest_way_through_the_graph() -> None:
    # Gains are computed beside the fields, and are the shorter.
    octaves = 0.25 + 0.25 + 0.5 + 3 * (1.0 + 0.5), 0.5 + 0.5 + 1.0 + 2 * (4.0 + 2.0)
    assert predicted(WINDOWED, 9, workers=18).seconds == serial(WINDOWED) + sum(octaves) + 8.0


def test_a_task_that_waits_begins_by_the_latency_later() -> None:
    costs = {of: cost for of, cost in WINDOWED.costs.items() if of[0] != "gain"}
    measured = dataclasses.replace(WINDOWED, costs=costs, latency_seconds=1 / 64)
    # From the first task to the last: inputs, fields, scales, two for each iteration; and finish.
    links = 3 + 2 * 3 + 3 + 2 * 2
    without = 0.5 + 0.5 + 3 * 1.5 + 1.0 + 1.0 + 2 * 6.0 + 8.0
    assert predicted(measured, 9, workers=9).seconds == pytest.approx(
        serial(measured) + without + links / 64, rel=1e-12
    )


def test_one_worker_with_much_to_do_does_not_wait_for_latency() -> None:
    measured = dataclasses.replace(WINDOWED, latency_seconds=1 / 64)
    # Only where all frames are waited for: before the second octave, and before and after the scales of both.
    found, without = predicted(measured, 20), predicted(WINDOWED, 20)
    assert without.seconds + 5 / 64 <= found.seconds <= without.seconds + 10 / 64


def test_the_scheduler_does_one_thing_at_a_time() -> None:
    costs = dict.fromkeys(WINDOWED.costs, Cost(0.0))
    measured = Measured(5, (3, 2), costs, scheduler_seconds=1 / 128)
    tasks = 8 * sum(COUNTS.get(of, 1) for of in costs)
    assert predicted(measured, 8, workers=64).seconds == tasks / 128
    assert sum(task.kind != BARRIER for task in graph_of(measured, 8).tasks) == tasks


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_the_scheduler_takes_time_of_the_cores_of_the_first_machine(workers: int) -> None:
    measured = dataclasses.replace(WINDOWED, scheduler_seconds=1 / 64)
    tasks = 12 * sum(COUNTS.get(of, 1) for of in measured.costs)
    found = predicted(measured, 12, workers=workers, per_machine=workers, cores=1)
    assert found.seconds == pytest.approx(serial(measured) + work(measured, 12) + tasks / 64, rel=1e-12)


def test_the_first_task_of_each_worker_takes_longer() -> None:
    costs = ALONE.costs | {("iterate", 1): Cost(6.0, first_seconds=7.5)}
    measured = dataclasses.replace(ALONE, costs=costs)
    for workers in (1, 2, 3, 4):
        assert predicted(measured, 12, workers=workers).seconds == predicted(ALONE, 12, workers=workers).seconds + 1.5


def test_more_frames_are_more_work_for_the_coordinator() -> None:
    found = predicted(dataclasses.replace(WINDOWED, coordinator_seconds=2.0), 9, workers=18)
    assert found.seconds == predicted(WINDOWED, 9, workers=18).seconds + 9 * 2.0


@pytest.mark.parametrize("workers", [1, 2, 3, 4, 6, 12])
def test_frames_without_a_window_are_shared_out(workers: int) -> None:
    found = predicted(ALONE, 12, workers=workers)
    assert found.seconds == 12 / workers * 9.0 and found.idle == 0 and found.stolen == 0


def test_a_frame_too_many_is_a_frame_that_others_wait_for() -> None:
    found = predicted(ALONE, 13, workers=4)
    # They may finish theirs meanwhile, or before.
    assert math.ceil(13 / 4) * 8.0 + 1.0 <= found.seconds <= math.ceil(13 / 4) * 9.0
    assert found.idle == pytest.approx(1 - 13 * 9.0 / (4 * found.seconds))


@pytest.mark.parametrize("measured", [WINDOWED, ALONE])
def test_more_workers_are_never_slower(measured: Measured) -> None:
    measured = dataclasses.replace(measured, scheduler_seconds=0.001, latency_seconds=0.003)
    seconds = [predicted(measured, 24, workers=workers).seconds for workers in (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 64)]
    assert seconds == sorted(seconds, reverse=True)
    assert seconds[0] / seconds[1] > 1.7


def test_no_schedule_beats_the_work_there_is() -> None:
    for workers in (2, 3, 5, 8):
        found = predicted(WINDOWED, 11, workers=workers)
        least = work(WINDOWED, 11) / workers
        assert found.seconds - serial(WINDOWED) >= least
        assert found.idle == pytest.approx(1 - least / (found.seconds - serial(WINDOWED)))


@pytest.mark.parametrize(("workers", "cores", "as_fast_as"), [(2, 1, 1), (4, 1, 1), (4, 2, 2), (3, 3, 3), (2, 8, 2)])
def test_workers_that_share_cores_are_as_fast_as_these(workers: int, cores: int, as_fast_as: int) -> None:
    shared = predicted(ALONE, 12, workers=workers, per_machine=workers, cores=cores)
    assert shared.seconds == pytest.approx(predicted(ALONE, 12, workers=as_fast_as).seconds, rel=1e-12)


def test_machines_do_not_slow_each_other_down() -> None:
    found = predicted(ALONE, 12, workers=4, per_machine=2, cores=1)
    assert found.seconds == pytest.approx(predicted(ALONE, 12, workers=2).seconds, rel=1e-12)


def test_without_a_cache_every_byte_is_read_over_the_network() -> None:
    frames, found = 7, predicted(WINDOWED, 7)
    at_ends = 2 + 1 + 0 + 0 + 0 + 1 + 2  # frames that windows lack
    read = sum(frames * (cost.bytes_read or 0) * COUNTS.get(of, 1) for of, cost in WINDOWED.costs.items())
    read -= at_ends * (400 + 2400)  # gains
    read -= at_ends * (3 * (400 + 30) + 2 * (2400 + 180))  # averages
    assert found.bytes_read == pytest.approx(read)
    assert found.bytes_written == frames * sum(c.bytes_written * COUNTS.get(of, 1) for of, c in WINDOWED.costs.items())
    assert found.result_bytes == frames * 4000


def test_one_worker_that_forgets_nothing_reads_the_frames_once_and_nothing_else() -> None:
    assert predicted(WINDOWED, 7, cache_bytes=math.inf).bytes_read == 7 * 700
    costs = WINDOWED.costs | {("inputs", 0): Cost(1.0, 0.0, 400), ("inputs", 1): Cost(1.0, 0.0, 2400)}
    assert predicted(dataclasses.replace(WINDOWED, costs=costs), 7, cache_bytes=math.inf).bytes_read == 0


def test_what_is_not_said_to_be_read_is_all_that_is_needed() -> None:
    costs = {of: dataclasses.replace(cost, bytes_read=None) for of, cost in WINDOWED.costs.items()}
    costs["inputs", 0] = WINDOWED.costs["inputs", 0]
    found = predicted(dataclasses.replace(WINDOWED, costs=costs), 7)
    assert found.bytes_read == pytest.approx(predicted(WINDOWED, 7).bytes_read)


def test_two_workers_that_forget_nothing_read_what_the_other_writes() -> None:
    """Without stealing: frames 0–3 are one worker's, 4–7 the other's, and two of each are in windows of the other."""
    costs = {of: dataclasses.replace(cost, seconds=1.0) for of, cost in WINDOWED.costs.items()}
    found = predicted(dataclasses.replace(WINDOWED, costs=costs), 8, workers=2, cache_bytes=math.inf)
    assert found.stolen == 0
    inputs, steps = 4 * (400 + 2400), 4 * (3 * 30 + 2 * 180)
    assert found.bytes_read == pytest.approx(8 * 700 + inputs + steps)


def test_a_larger_cache_reads_less() -> None:
    sizes = (0, 5_000, 20_000, 80_000, 1_000_000)
    read = [predicted(WINDOWED, 12, workers=3, cache_bytes=size).bytes_read for size in sizes]
    assert read == sorted(read, reverse=True) and read[-1] < read[0] / 3


def test_the_store_holds_two_octaves_while_frames_enter_the_second() -> None:
    # One worker finds all steps before the first average.
    of_one = Measured(5, (3,), {(kind, 0): cost for (kind, octave), cost in WINDOWED.costs.items() if octave == 0})
    assert predicted(of_one, 10).store_bytes == 10 * (400 + 100 + 10 + 30)
    assert predicted(WINDOWED, 10).store_bytes == 10 * (400 + 100 + 10) + 10 * (2400 + 600 + 60)


def test_a_cache_keeps_what_was_used_last() -> None:
    cache = Cache(100)
    first, second, third = (Item("step", 0, frame) for frame in range(3))
    cache.use(first, 0, 40)
    cache.use(second, 0, 40)
    cache.use(first, 0, 40)
    cache.use(third, 0, 40)
    assert [cache.has(item, 0) for item in (first, second, third)] == [True, False, True]
    cache.use(first, 1, 60)
    assert cache.has(first, 1) and not cache.has(first, 0) and cache.has(third, 0)
    cache.use(second, 0, 101)
    assert not cache.has(second, 0) and cache.has(third, 0)


TOML = """
window = 3
iterations = [2]
latency_seconds = 0.5
tasks.inputs = [{seconds = 1, bytes_written = 10}]
tasks.fields = [{seconds = 1}]
tasks.step = [{seconds = 2, bytes_read = 10, bytes_written = 5}]
tasks.average = [{seconds = 1}]
"""


def test_measurements_are_read_as_documented(tmp_path: Path) -> None:
    path = tmp_path / "measured.toml"
    path.write_text(TOML)
    found = read_measured(path)
    assert found.window == 3 and found.iterations == (2,) and found.latency_seconds == 0.5
    assert found.costs["step", 0] == Cost(2.0, 10.0, 5.0) and not found.has("finish", 0)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (("window = 3", "window = 4"), "window = 4: expected an odd number"),
        (("window = 3", "windows = 3"), "unknown key 'windows'"),
        (("iterations = [2]", "iterations = []"), "iterations"),
        (("iterations = [2]", "iterations = [2, 2]"), "tasks.inputs: expected a list of 2"),
        (("seconds = 2", "seconds = -2"), "tasks.step: seconds = -2: expected a number of 0 or more"),
        (("seconds = 2", "seconds = nan"), "tasks.step: seconds = nan"),
        (("seconds = 2, ", ""), "tasks.step: seconds is missing"),
        (("tasks.step", "tasks.iterate"), "tasks: unknown key 'iterate'"),
        (("tasks.average", "tasks.finish"), "tasks: average is missing"),
        (("bytes_written = 10", "bytes_written = 0"), "tasks.step: bytes_read = 10 in octave 0, but it needs nothing"),
        (("window = 3", "window = "), "not valid TOML"),
    ],
)
def test_what_cannot_be_used_is_said_in_one_line(
    wrong: tuple[str, str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "measured.toml"
    path.write_text(TOML.replace(*wrong))
    monkeypatch.setattr(sys, "argv", ["plan_cluster.py", str(path), "--frames", "4"])
    assert plan_cluster.main() == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and str(path) in err and said in err


@pytest.mark.parametrize("flag", ["--frames", "--workers", "--per-machine", "--cores"])
def test_numbers_that_are_too_small_are_refused(
    flag: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["plan_cluster.py", "measured.toml", flag, "0"])
    assert plan_cluster.main() == 2
    assert capsys.readouterr().err.startswith(f"plan_cluster: {flag} 0")


def test_the_table_and_the_plot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path, plot = tmp_path / "measured.toml", tmp_path / "plan.png"
    path.write_text(TOML)
    command = ["plan_cluster.py", str(path), "--frames", "6", "60", "--workers", "2", "6", "--plot", str(plot)]
    monkeypatch.setattr(sys, "argv", command)
    assert plan_cluster.main() == 0
    head, _, *rows = capsys.readouterr().out.splitlines()
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    assert head.startswith("| frames | workers | time | speed-up |")
    assert [row[:2] for row in cells] == [[frames, workers] for frames in ("6", "60") for workers in ("1", "2", "6")]
    # 60 frames of 8 s each, and half a second where all wait for the last one that enters.
    assert cells[3][2:4] == ["8:00", "1.00"] and cells[4][3] in ("1.99", "2.00")
    with Image.open(plot) as picture:
        assert np.asarray(picture.convert("L")).std() > 10


def recorded(folder: Path, *parts: dict) -> Path:
    """The folder of a run on a cluster, in as many parts as it was resumed."""
    told = {"address": "local:2", "seconds": 41.0, "before": 1.0, "after": 0.25, "coordinator_cpu": 0.75}
    cluster = [told | {"tasks": part} for part in parts]
    (folder / "run.json").write_text(json.dumps({"frames": [{}] * 12, "seconds": 88.0, "cluster": cluster}))
    (folder / "recipe.toml").write_text(Recipe(style=["spirals"], window=3, octaves=1, iterations=2).to_toml())
    (folder / "density").mkdir()
    (folder / "density" / "frame_0001.npz").write_bytes(bytes(1200))
    return folder


def took(tasks: int, seconds: float, written: int = 0, firsts: int = 0, first: float | None = None) -> dict:
    beside = {"firsts": firsts, "first_seconds": first, "bytes_read": 1, "bytes_written": written}
    return {"tasks": tasks, "seconds": seconds} | beside


def test_a_run_on_a_cluster_is_measured(tmp_path: Path) -> None:
    kinds = ("inputs", "fields", "average", "finish")
    first = {f"{kind} 1": took(12, 1.0, 10) for kind in kinds} | {"step 1": took(18, 2.0, 50, 2, 6.0)}
    found = measured_by(recorded(tmp_path, first, {"step 1": took(6, 4.0, 50, 1, 9.0)}))
    assert (found.window, found.iterations) == (3, (2,))
    # Without the first ones, the others took 60 − 21 s.
    assert found.cost("step", 0) == Cost((18 * 2.0 + 6 * 4.0 - 2 * 6.0 - 9.0) / 21, None, 50.0, (2 * 6.0 + 9.0) / 3)
    assert found.cost("finish", 0) == Cost(1.0, None, 100.0)
    assert not found.has("gain", 0)
    assert (found.prepare_seconds, found.conclude_seconds, found.coordinator_seconds) == (2.0, 0.5, 0.5)
    assert found.scheduler_seconds == 1.5 / (4 * 12 + 18 + 6)


@pytest.mark.parametrize(
    ("part", "said"),
    [
        ({}, "no tasks of inputs 1"),
        ({"inputs 1": 5}, "tasks of inputs 1: damaged"),
        ({"inputs 1": {"tasks": 5}}, "tasks of inputs 1: damaged"),
    ],
)
def test_a_record_that_lacks_something_is_refused(part: dict, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rf"run.json: .*{said}"):
        measured_by(recorded(tmp_path, part))


def test_a_run_without_a_cluster_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the run was none on a cluster"):
        measured_by(recorded(tmp_path))
