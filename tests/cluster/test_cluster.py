"""Runs on a cluster: the same bits as in one process, whatever happens to its processes; and who may take part."""

from __future__ import annotations

import _thread
import json
import pickle
import random
import shutil
import socket
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from moving_smoke import moving_smoke

pytest.importorskip("distributed", reason="needs tnst_mi[cluster]")

import psutil
from dask_cluster import Processes, processes
from distributed import Client

import tnst_mi
from tnst_mi.cluster import member, roster
from tnst_mi.cluster.run import ClusterRun
from tnst_mi.errors import InputError, StoppedError
from tnst_mi.io.sequence import save_frame
from tnst_mi.optimisation.result import Progress
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run import cluster_address
from tnst_mi.run.cluster_address import cluster_of
from tnst_mi.run.job import Run
from tnst_mi.run.prepare import prepare

COUNT = 5
GOAL = {"semantic": ["inception_3a/3x3:2"], "octaves": 2, "iterations": 3, "views": 1, "lam": 0.5, "threads": 1}


@pytest.fixture(scope="module")
def smoke(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("smoke")
    for frame in moving_smoke(COUNT):
        save_frame(folder / f"{frame.name}.npz", frame)
    return folder


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    with processes(tmp_path_factory.mktemp("cluster"), 2) as cluster:
        yield cluster


@pytest.fixture(scope="module")
def alone(smoke: Path, weights: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., dict[str, bytes]]:
    """The results of a run in this process, by its keys."""
    known: dict[str, dict[str, bytes]] = {}

    def results(**keys: Any) -> dict[str, bytes]:
        name = json.dumps(keys)
        if name not in known:
            out = tmp_path_factory.mktemp("alone")
            for _ in Run(prepare(smoke, recipe(weights, **keys), out), progress=False):
                pass
            known[name] = contents(out)
        return known[name]

    return results


def recipe(weights: Path, **keys: Any) -> Recipe:
    return Recipe.from_dict(GOAL | {"weights": str(weights)} | keys)


def contents(out: Path) -> dict[str, bytes]:
    """The results of a run, but for what times are in."""
    kinds = ("density", "velocity", "state", "images")
    files = [path for kind in kinds for path in sorted((out / kind).iterdir()) if path.suffix != ".mp4"]
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in files}


def stylized(
    smoke: Path,
    recipe: Recipe,
    out: Path,
    address: str,
    report: Callable[[Progress], None] | None = None,
    shared: bool = True,
) -> ClusterRun:
    run = ClusterRun(prepare(smoke, recipe, out, resume=True), cluster_of(address, shared), progress=False)
    if report is not None:
        run._bar.advance = report
    for _ in run:
        pass
    return run


def losses(out: Path) -> list[tuple[Any, ...]]:
    entries = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    return sorted((entry["frame"], entry["octave"], entry["iteration"], entry["loss"]) for entry in entries)


@pytest.mark.parametrize(
    "keys",
    [
        {"window": 3},
        {"window": 1},
        {"window": 5, "coherence": 1.0, "step_order": "align_first", "window_average": "plain"},
    ],
    ids=["window", "alone", "gradients"],
)
def test_the_bits_are_those_of_one_process(
    keys: dict[str, Any], smoke: Path, weights: Path, cluster: Processes, alone: Callable[..., Any], tmp_path: Path
) -> None:
    run = stylized(smoke, recipe(weights, **keys), tmp_path / "out", cluster.address)
    assert contents(tmp_path / "out") == alone(**keys)
    assert run.record["status"] == "done" and [frame["name"] for frame in run.record["frames"]] == run.prepared.names
    assert len(losses(tmp_path / "out")) == COUNT * 6 and not (tmp_path / "out" / ".work").exists()
    (session,) = run.record["cluster"]
    done = {kind: numbers["tasks"] for kind, numbers in session["tasks"].items()}
    assert done["finish 2"] == COUNT and sum(done.values()) == sum(worker["tasks"] for worker in session["workers"])
    if keys["window"] > 1:
        assert done["step 1"] == done["average 2"] == COUNT * 3
        assert all(0 <= worker["idle"] < 1 for worker in session["workers"]) and len(session["workers"]) == 2


@pytest.mark.parametrize(
    "keys",
    [
        {"window": 3},
        {"window": 1},
        {"window": 3, "semantic": [], "target": [{"mask": {"shape": "sphere", "centre": [5, 6, 4], "radius": 4}}]},
    ],
)
def test_without_a_shared_folder_items_travel(
    keys: dict[str, Any],
    smoke: Path,
    weights: Path,
    cluster: Processes,
    alone: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The workers are told of places that are not there."""
    if "target" in keys:
        keys = keys | {"target": [table | {"semantic": GOAL["semantic"]} for table in keys["target"]]}
    own = ClusterRun._order

    def elsewhere(self: ClusterRun, folder: Any) -> bytes:
        order = pickle.loads(own(self, folder))
        return pickle.dumps(replace(order, work=replace(order.work, out=Path("/nowhere"), frames=[])))

    monkeypatch.setattr(ClusterRun, "_order", elsewhere)
    run = stylized(smoke, recipe(weights, **keys), tmp_path / "out", cluster.address, shared=False)
    assert contents(tmp_path / "out") == alone(**keys)
    assert len(losses(tmp_path / "out")) == COUNT * 6
    assert not list(Path(cluster.folder).glob("**/*.safetensors")), "workers keep nothing"
    (session,) = run.record["cluster"]
    assert not {"finish 2", "inputs 1"} & set(session["tasks"])


def test_a_worker_that_is_killed_costs_what_it_was_at(
    smoke: Path, weights: Path, cluster: Processes, alone: Callable[..., Any], tmp_path: Path
) -> None:
    """And one that comes in the middle takes part."""
    moments = random.Random(2).sample(range(2, 28), 3)
    seen = 0

    def report(progress: Progress) -> None:
        nonlocal seen
        seen += 1
        if seen in moments:
            cluster.kill(cluster.workers[0])
            cluster.add()

    run = stylized(smoke, recipe(weights, window=3), tmp_path / "out", cluster.address, report)
    assert contents(tmp_path / "out") == alone(window=3)
    (session,) = run.record["cluster"]
    done = {kind: numbers["tasks"] for kind, numbers in session["tasks"].items()}
    # Each may have been at one task, which was done again.
    twice = sum(done[f"{kind} {octave}"] - COUNT * 3 for kind in ("step", "average") for octave in (1, 2))
    assert 0 <= twice <= 3 and len(losses(tmp_path / "out")) == COUNT * 6
    assert len(session["workers"]) > 2


def test_a_run_whose_scheduler_is_killed_is_resumed_with_or_without_a_cluster(
    smoke: Path, weights: Path, cluster: Processes, alone: Callable[..., Any], tmp_path: Path
) -> None:
    def killing(at: int, own: Processes) -> Callable[[Progress], None]:
        def report(progress: Progress) -> None:
            if progress.done == at:
                own.kill(own.scheduler)

        return report

    for at, folder in ((7, "first"), (22, "second")):
        out = tmp_path / folder
        with processes(tmp_path, 1) as own, pytest.raises(StoppedError, match=r"scheduler is gone.*--resume"):
            stylized(smoke, recipe(weights, window=3), out, own.address, killing(at, own))
        before = json.loads((out / "run.json").read_text())
        assert before["status"] == "running" and (out / ".work").is_dir()
        if folder == "first":
            run = stylized(smoke, recipe(weights, window=3), out, cluster.address)
            assert len(run.record["cluster"]) == 1, "the first was not recorded: nothing was known of its end"
        else:
            for _ in Run(prepare(smoke, recipe(weights, window=3), out, resume=True), progress=False):
                pass
        assert contents(out) == alone(window=3)
        assert len(losses(out)) == COUNT * 6


def test_workers_that_die_in_turn_blame_no_frame(
    smoke: Path, weights: Path, alone: Callable[..., Any], tmp_path: Path
) -> None:
    """Dask counts their deaths against all tasks that they had been given; each has one task at a time."""
    seen = 0
    with processes(tmp_path, 1) as own:

        def report(progress: Progress) -> None:
            nonlocal seen
            seen += 1
            if seen % 4 == 0 and seen < 22:
                own.kill(own.workers[0])
                own.add()

        stylized(smoke, recipe(weights, window=3), tmp_path / "out", own.address, report)
    assert seen >= 30 and contents(tmp_path / "out") == alone(window=3)


def test_after_one_was_refused_tasks_of_one_that_has_left_go_to_others(
    smoke: Path, weights: Path, alone: Callable[..., Any], tmp_path: Path
) -> None:
    """Then tasks are for those that may do them, by their addresses."""
    seen = 0
    with processes(tmp_path, 0) as own:
        own.add(threads=2)
        own.add()

        def report(progress: Progress) -> None:
            nonlocal seen
            seen += 1
            if seen == 3:
                own.add()
            if seen == 12:
                own.kill(own.workers[1])

        stylized(smoke, recipe(weights, window=3), tmp_path / "out", own.address, report)
    assert seen >= 30 and contents(tmp_path / "out") == alone(window=3)


def test_a_frame_that_kills_its_workers_is_named(smoke: Path, weights: Path, tmp_path: Path) -> None:
    with processes(tmp_path, 0) as own:
        for _ in range(4):
            own.add("--preload", "deadly_frame", PYTHONPATH=str(Path(__file__).parents[1] / "helpers"))
        with pytest.raises(
            InputError, match=r"s_007, step in iteration 1 of octave 1: 4 processes or more have died at it"
        ):
            stylized(smoke, recipe(weights, window=3), tmp_path / "out", own.address)


def test_damaged_items_are_made_anew(
    smoke: Path, weights: Path, cluster: Processes, alone: Callable[..., Any], tmp_path: Path
) -> None:
    damaged = []

    def report(progress: Progress) -> None:
        """Cut off the ends of some items in the middle of the run."""
        if progress.done == 20:
            for path in [
                *(tmp_path / "out" / ".work").glob("inputs.1/*"),
                *(tmp_path / "out" / ".work").glob("fields.1/*3.*"),
            ]:
                path.write_bytes(path.read_bytes()[:-8])
                damaged.append(path)

    stylized(smoke, recipe(weights, window=3), tmp_path / "out", cluster.address, report)
    assert damaged and contents(tmp_path / "out") == alone(window=3)


def test_a_frame_that_cannot_be_computed_ends_the_run_by_its_name(
    smoke: Path, weights: Path, cluster: Processes, tmp_path: Path
) -> None:
    """Its file changes in the middle; the others are not asked again and again."""
    own = tmp_path / "smoke"
    shutil.copytree(smoke, own)

    def report(progress: Progress) -> None:
        save_frame(own / "s_007.npz", moving_smoke(1, first=7)[0])

    with pytest.raises(InputError, match="s_007: has changed since the run began"):
        stylized(own, recipe(weights, window=3), tmp_path / "out", cluster.address, report)


def test_a_full_disk_is_a_clear_stop_that_resumes(
    smoke: Path, weights: Path, cluster: Processes, alone: Callable[..., Any], tmp_path: Path
) -> None:
    """Stands in for it: a limit of one worker's file sizes."""
    limited = psutil.Process(cluster.workers[0].pid)
    before = limited.rlimit(psutil.RLIMIT_FSIZE)

    def report(progress: Progress) -> None:
        limited.rlimit(psutil.RLIMIT_FSIZE, (1000, before[1]))

    try:
        with pytest.raises(StoppedError, match=r"larger than the limit on file sizes.*--resume"):
            stylized(smoke, recipe(weights, window=3), tmp_path / "out", cluster.address, report)
    finally:
        limited.rlimit(psutil.RLIMIT_FSIZE, before)
    stylized(smoke, recipe(weights, window=3), tmp_path / "out", cluster.address)
    assert contents(tmp_path / "out") == alone(window=3)


def test_ctrl_c_leaves_a_run_that_goes_on(
    smoke: Path, weights: Path, cluster: Processes, alone: Callable[..., Any], tmp_path: Path
) -> None:
    def report(progress: Progress) -> None:
        if progress.done == 10:
            _thread.interrupt_main()

    run = stylized(smoke, recipe(weights, window=3), tmp_path / "out", cluster.address, report)
    assert run.record["status"] == "interrupted"
    run = stylized(smoke, recipe(weights, window=3), tmp_path / "out", cluster.address)
    assert contents(tmp_path / "out") == alone(window=3) and len(run.record["cluster"]) == 2


def test_workers_that_would_come_to_other_bits_are_refused_in_one_line(
    smoke: Path, weights: Path, cluster: Processes, alone: Callable[..., Any], tmp_path: Path
) -> None:
    """One with two threads, and one of another version, which has been told so here."""
    said: list[str] = []
    with processes(tmp_path, 0) as own:
        own.add(threads=2)
        own.add("--preload", "other_version", PYTHONPATH=str(Path(__file__).parents[1] / "helpers"))
        run = ClusterRun(prepare(smoke, recipe(weights, window=3), tmp_path / "out"), cluster_of(own.address), False)
        run._bar.say = said.append
        helped = threading.Event()

        def say(line: str) -> None:
            said.append(line)
            if sum("refused" in line for line in said) == 2 and not helped.is_set():
                helped.set()
                own.add()

        run._bar.say = say
        for _ in run:
            pass
    assert contents(tmp_path / "out") == alone(window=3)
    refused = sorted(line.partition("refused: ")[2] for line in said if "refused" in line)
    assert refused == [
        "it has 2 threads, expected 1; start it with --nthreads 1",
        "it has torch 0.0, and the run 2.13.0; install the same".replace("2.13.0", member.decisive_versions()["torch"]),
    ]


def test_without_any_fit_worker_the_run_says_why(
    smoke: Path, weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    versions = member.decisive_versions()
    monkeypatch.setattr(member, "decisive_versions", lambda: versions | {"mitsuba": "9.9"})
    monkeypatch.setattr(roster, "_PATIENCE", 0.0)
    with pytest.raises(InputError, match=r"no worker can take part: it has mitsuba .*, and the run 9\.9"):
        stylized(smoke, recipe(weights, window=3), tmp_path / "out", "local:1")


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("local:0", "expected local:N with N from 1 to 256"),
        ("local", "expected local:N"),
        ("local:two", "expected local:N"),
        ("http://host:1", "expected local:N, tcp://HOST:PORT, or slurm"),
        ("tcp://host", "expected local:N, tcp://HOST:PORT"),
        ("tcp://host:99999", "expected local:N, tcp://HOST:PORT"),
        ("tcp://[::1:8786", "expected local:N, tcp://HOST:PORT"),
        ("local:٣", "expected local:N"),
        ("slurm:/dev/zero", "/dev/zero: cannot be read"),
        ("slurm:none.toml", "none.toml: cannot be read"),
    ],
)
def test_addresses_that_mean_nothing_are_refused(address: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        cluster_of(address)


def test_where_jobs_cannot_be_submitted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match="sbatch is not here; run where jobs can be submitted"):
        cluster_of("slurm")


def test_a_file_of_a_batch_system_says_how_many_jobs(tmp_path: Path) -> None:
    file = tmp_path / "jobs.toml"
    for text, message in (
        ("jobs = 0", "jobs = 0, expected"),
        ("queue = 'gpu'", "jobs = None"),
        ("jobs =", "not valid TOML"),
        ("jobs = 2\ncores = 4", "cores = 4: a job is one process with one thread of Dask's; take job_cpu"),
        (
            "jobs = 2\njob_script_prologue = 'module load cuda'",
            "expected a list of texts, such as .'module load cuda'.",
        ),
        ("jobs = 2\njob_extra_directives = [5]", "job_extra_directives = .5., expected a list of texts"),
    ):
        file.write_text(text)
        with pytest.raises(InputError, match=message):
            cluster_of(f"slurm:{file}")


def test_where_no_scheduler_answers_is_told_before_anything_is_written(
    smoke: Path, weights: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=r"tcp://127.0.0.1:9: no scheduler answers there \(Connection refused\)"):
        tnst_mi.stylize(smoke, recipe(weights), tmp_path / "out", cluster="tcp://127.0.0.1:9")
    assert not (tmp_path / "out").exists()


def test_a_port_of_another_kind_is_told_before_anything_is_written(
    smoke: Path, weights: Path, cluster: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker's address, and that of a program that never answers."""
    monkeypatch.setattr(cluster_address, "_ANSWERS", 1.0)
    with Client(cluster.address, set_as_default=False) as client:
        worker = next(iter(client.scheduler_info()["workers"]))
    with socket.create_server(("127.0.0.1", 0)) as silent:
        for address, reason in (
            (worker, "that is the address of a worker"),
            (f"tcp://127.0.0.1:{silent.getsockname()[1]}", "no scheduler answers there"),
        ):
            with pytest.raises(InputError, match=reason):
                tnst_mi.stylize(smoke, recipe(weights), tmp_path / "out", cluster=address)
    assert not (tmp_path / "out").exists()
