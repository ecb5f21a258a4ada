"""What becomes of tries: they are gone on from, deleted, and survive whatever ends a process or is put beside them."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studios import Studio, running

from tnst_mi.cli import main
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.studio.jobs import removal
from tnst_mi.studio.jobs.clusters import checked_address
from tnst_mi.studio.jobs.processes import RunProcess, WorkRecord
from tnst_mi.studio.jobs.removal import finish_removals, highest_number, remove
from tnst_mi.studio.jobs.workshop import Workshop
from tnst_mi.studio.places import Places

SHAPE = (10, 16, 12)

#: What is left of a try beside its folder.
FILES = (".json", ".log", ".toml")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a frame of smoke."""
    folder = tmp_path_factory.mktemp("root")
    save_frames(folder, [Frame(np.random.default_rng(0).random(SHAPE, np.float32), name="smoke")])
    return folder


@pytest.fixture
def studio(root: Path, weights: Path, tmp_path: Path) -> Iterator[Studio]:
    with running(root, tmp_path / "out") as started:
        started.post("/open", path="smoke.npz")
        started.session.settings.base = settings(weights, 4)
        started.post("/goal", key="style", goal="net")
        yield started


def settings(weights: Path, iterations: int) -> Recipe:
    return Recipe(weights=str(weights), octaves=3, iterations=iterations, views=1, gamma=0.2)


def works(studio: Studio) -> dict[str, Any]:
    return {work["id"]: work for work in studio.session.state()["work"]}


def ended(studio: Studio, name: str) -> dict[str, Any]:
    waited_for(lambda: works(studio)[name]["status"] != "running")
    return works(studio)[name]


def waited_for(condition: Callable[[], bool], seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def results(folder: Path) -> dict[str, bytes]:
    """What a run leaves of smoke, and of what moves it."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.glob("*/*.npz"))}


# ---------------------------------------------------------------- going on from a state


def test_a_try_goes_on_from_a_kept_state_to_the_bits_of_the_command(studio: Studio, tmp_path: Path) -> None:
    """A draft of three octaves has two: it keeps the end of the first, and its own."""
    studio.post("/work", action="try")
    states = ended(studio, "tries/0001")["states"]
    assert [(state["octave"], state["picture"]) for state in states] == [(0, True), (None, True)]
    assert states[1]["title"] == "the end: octave 2, iteration 4"
    picture = studio.get("/work/picture", id="tries/0001", octave=0).body
    assert picture.startswith(b"\x89PNG") and picture != studio.get("/work/picture", id="tries/0001").body
    # From the first octave with longer steps: a draft, of which the second octave is left to do.
    assert studio.post("/work", action="branch", id="tries/0001", octave=0).status == 200
    assert studio.session.state()["start"] == {"id": "tries/0001", "octave": 0}
    studio.post("/set", key="eta", value=0.01)
    assert studio.post("/work", action="try").status == 200
    branched = ended(studio, "tries/0002")
    assert branched["status"] == "done", branched
    assert branched["line"].startswith("net, from try 1, loss ")
    assert set(branched["octaves"]) == {1} and branched["done"] == branched["total"] == 8
    tries = tmp_path / "out" / "tries"
    command = ["stylize", "--from", str(tries / "0001" / "octaves" / "1"), "--recipe", str(tries / "0002.toml")]
    assert main([*command, "--out", str(tmp_path / "again")]) == 0
    assert results(tmp_path / "again") == results(tries / "0002") != results(tries / "0001")
    assert branched["line"].endswith(", network bvlc")
    # From its end, where a draft has nothing left to do, a try is a preview. What may differ stays as it was set.
    studio.post("/work", action="anew")
    studio.post("/work", action="open", id="tries/0002")
    for key, value in (("strength", 0.5), ("motif_size", 0.5), ("views", 1)):
        studio.post("/set", key=key, value=value)
    studio.post("/work", action="branch", id="tries/0002", octave=None)
    assert studio.session.recipe().eta == 0.01
    assert (studio.session.recipe().strength, studio.session.recipe().motif_size) == (0.5, "auto")
    said = "Goals, regions and settings are those of try 2; strength stays as it was set before."
    assert studio.session.state()["remark"] == {"text": said, "clears": False}
    studio.post("/work", action="try")
    assert set(ended(studio, "tries/0003")["octaves"]) == {2}
    record = json.loads((tries / "0003" / "run.json").read_text())["from"]
    assert (record["octave"], record["iterations"], record["run"]) == (1, 4, str(tries / "0002"))
    assert 'quality = "preview"' in (tries / "0003.toml").read_text()


def test_what_must_not_differ_is_fixed(studio: Studio) -> None:
    studio.post("/work", action="try")
    ended(studio, "tries/0001")
    studio.post("/work", action="branch", id="tries/0001", octave=0)
    free = {knob["key"] for knob in studio.session.state()["knobs"] if knob["free"]}
    assert free == {"strength", "eta", "iterations", "views", "colour_weight"}
    fixed = "goes on from try 1, whose goals, regions and fixed settings stay; the × beside it begins anew"
    sphere = {"shape": "sphere", "centre": [5, 7, 4], "radius": 3}
    before = studio.session.recipe()
    for path, values in (
        ("/set", {"key": "motif_size", "value": 0.5}),
        ("/goal", {"key": "style", "goal": "cells"}),
        ("/mask", {"action": "add", "values": sphere}),
        ("/clear", {}),
    ):
        refused = studio.post(path, **values)
        assert refused.status == 400 and fixed in refused.error and "--from" not in refused.error
    assert studio.request("POST", "/upload?name=x.png", b"").status == 400
    assert studio.session.recipe() == before and not (studio.session.places.root / "pictures").exists()
    # What only the run can see is said by it, and what cannot be done as it is, is not offered to be resumed.
    studio.session.settings.base = dataclasses.replace(before, motif_size=0.5)
    studio.post("/work", action="try")
    failed = ended(studio, "tries/0002")
    assert failed["status"] == "failed" and failed["actions"] == ["delete"]
    assert "its run had motif_size = 'auto', this one has 0.5" in failed["error"]
    assert "nothing is to be resumed" in studio.post("/work", action="resume", id="tries/0002").error
    studio.post("/work", action="anew")
    assert studio.session.state()["start"] is None
    for octave in (1, 2, -1, 99, "x", True, 0.5):
        refused = studio.post("/work", action="branch", id="tries/0001", octave=octave)
        assert refused.status == 400 and "octave" in refused.error


def test_a_try_that_runs_and_one_that_was_killed_are_gone_on_from(studio: Studio, weights: Path) -> None:
    studio.session.settings.base = settings(weights, 60)
    studio.post("/work", action="try")
    waited_for(lambda: works(studio)["tries/0001"]["states"] != [])
    assert [state["octave"] for state in works(studio)["tries/0001"]["states"]] == [0]
    assert studio.post("/work", action="branch", id="tries/0001", octave=0).status == 200
    os.kill(studio.session.workshop.work("tries/0001").process.record.pid, signal.SIGKILL)
    assert ended(studio, "tries/0001")["status"] == "interrupted"
    studio.post("/work", action="try")
    assert ended(studio, "tries/0002")["status"] == "done"


# ---------------------------------------------------------------- deleting


def test_a_running_try_is_stopped_and_deleted_with_all_that_it_has(
    studio: Studio, weights: Path, tmp_path: Path
) -> None:
    studio.post("/work", action="try")
    ended(studio, "tries/0001")
    studio.post("/work", action="open", id="tries/0001")
    studio.post("/work", action="branch", id="tries/0001", octave=None)
    studio.session.settings.base = settings(weights, 2000)
    studio.post("/work", action="anew")
    studio.post("/goal", key="style", goal="net")
    studio.post("/work", action="try")
    waited_for(lambda: works(studio)["tries/0002"]["done"] > 0)
    process = studio.session.workshop.work("tries/0002").process
    # Two tabs at once.
    replies: list[int] = []
    delete = {"action": "delete", "ids": ["tries/0001", "tries/0002"]}
    tabs = [threading.Thread(target=lambda: replies.append(studio.post("/work", **delete).status)) for _ in range(2)]
    for tab in tabs:
        tab.start()
    for tab in tabs:
        tab.join()
    assert replies == [200, 200] and works(studio) == {}
    assert process.status() != "running"
    assert sorted(path.name for path in (tmp_path / "out" / "tries").iterdir()) == ["highest_number"]
    # What was shown is gone: its input is shown again, and nothing goes on from it.
    state = studio.session.state()
    assert state["opened"]["title"] == "smoke" and not state["opened"]["after"] and state["start"] is None
    # Numbers are not given again, by another studio neither.
    assert studio.post("/work", **delete).status == 200
    studio.post("/work", action="try")
    assert list(works(studio)) == ["tries/0003"]


def test_what_others_go_on_from_stays_until_they_are_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    made(out, "tries/0001")
    made(out, "tries/0010")
    made(out, "renders/0001", start_from=str(out / "tries" / "0001" / "octaves" / "1"))
    workshop = Workshop(out, lambda: None)
    with pytest.raises(InputError, match="renders/0001 goes on from tries/0001 and is interrupted; wait"):
        workshop.delete(["tries/0010", "tries/0001"])
    assert workshop.holds("tries/0010")
    workshop.delete(["tries/0001", "renders/0001"])
    assert [work["id"] for work in workshop.described()] == ["tries/0010"]
    workshop.end()


def made(out: Path, name: str, **others: Any) -> Path:
    """A try or a render that was begun by an earlier studio, whose process is gone."""
    folder = out / name
    folder.mkdir(parents=True)
    (folder / "metrics.jsonl").write_text("")
    folder.with_name(f"{folder.name}.toml").write_text(Recipe(style=("net",)).to_toml())
    folder.with_name(f"{folder.name}.log").write_text("said\n")
    WorkRecord("/smoke.npz", SHAPE, **others).write(folder.with_name(f"{folder.name}.json"))
    return folder


@pytest.mark.parametrize("steps", range(1, 7))
def test_a_deletion_that_was_killed_is_finished_by_the_next_studio(
    steps: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After each of the steps: a rename, or the removal of what has been renamed."""
    folder, other = made(tmp_path, "tries/0007"), made(tmp_path, "tries/0003")
    count = iter(range(1, 100))

    def killed(call: Callable[..., Any]) -> Callable[..., Any]:
        def step(*arguments: Any) -> Any:
            if next(count) == steps:
                raise KeyboardInterrupt
            return call(*arguments)

        return step

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", killed(Path.replace))
        patch.setattr(removal.shutil, "rmtree", killed(removal.shutil.rmtree))
        try:
            remove(folder)
        except KeyboardInterrupt:
            assert steps < 6
    workshop = Workshop(tmp_path, lambda: None)
    assert [work["id"] for work in workshop.described()] == ["tries/0003"]
    names = {path.name for path in (tmp_path / "tries").iterdir()}
    assert names == {"highest_number", "0003", *(f"0003{suffix}" for suffix in FILES)}
    assert other.is_dir() and highest_number(tmp_path / "tries") == 7
    workshop.end()


def test_nothing_outside_is_deleted_whatever_is_a_link(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    made(precious, "tries/0001")
    before = sorted(precious.rglob("*"))
    out = tmp_path / "out"
    # A try that is a link goes, and what it leads to stays.
    folder = made(out, "tries/0001")
    (folder / "metrics.jsonl").unlink()
    folder.rmdir()
    folder.symlink_to(precious)
    (out / "renders").symlink_to(precious / "tries")
    workshop = Workshop(out, lambda: None)
    workshop.delete(["tries/0001"])
    assert not folder.is_symlink() and sorted(precious.rglob("*")) == before
    with pytest.raises(InputError, match="renders is a link; nothing is removed"):
        workshop.delete(["renders/0001"])
    for name in ("../precious", "tries/../../precious", "tries", "", "tries/0001/", "pictures/0001", "/etc"):
        with pytest.raises(InputError, match="no such try or render"):
            workshop.delete([name])
    (out / "tries" / ".tnst_mi-removed-0009").symlink_to(precious)
    (out / "tries" / ".tnst_mi-removed-mine").mkdir()
    finish_removals(out / "tries")
    assert sorted(precious.rglob("*")) == before and (out / "tries" / ".tnst_mi-removed-mine").is_dir()
    workshop.end()


def test_malformed_lists_of_names_are_refused(studio: Studio) -> None:
    for ids in (None, "tries/0001", [1], [["tries/0001"]], {"0": "tries/0001"}, ["tries/0001"] * 3000):
        refused = studio.post("/work", action="delete", ids=ids)
        assert refused.status == 400 and "list of at most 2000" in refused.error


def test_a_picture_that_goes_while_it_is_asked_for_is_told(studio: Studio, monkeypatch: pytest.MonkeyPatch) -> None:
    studio.post("/work", action="try")
    ended(studio, "tries/0001")
    work = studio.session.workshop.work("tries/0001")
    picture = work.picture
    assert picture is not None
    remove(work.process.folder)
    monkeypatch.setattr(type(work), "picture", picture)
    refused = studio.get("/work/picture", id="tries/0001")
    assert refused.status == 400 and refused.error == "studio: there is no picture, or none any more"


# ---------------------------------------------------------------- whatever else may be there


def test_foreign_files_are_left_alone(tmp_path: Path) -> None:
    made(tmp_path, "tries/0001")
    for kind in ("tries", "renders"):
        folder = tmp_path / kind
        folder.mkdir(exist_ok=True)
        for name in ("0002", "0003.toml", "0004.json", "x", "00005.toml", "9" * 40):
            (folder / name).mkdir()
        (folder / "0006.toml").write_text("")
        (folder / "0006.json").write_text("{" * 100_000)
        os.mkfifo(folder / "0007.toml")
        (folder / "0008.toml").write_text("")
        os.mkfifo(folder / "0008.json")
        (folder / f"{'8' * 30}.toml").write_text("")
        (folder / "highest_number").write_bytes(b"\xff\xfe" if kind == "tries" else b"9" * 5000)
    os.mkfifo(tmp_path / "tries" / "0001.pipe")
    (tmp_path / "tries" / "0001.log").unlink()
    os.mkfifo(tmp_path / "tries" / "0001.log")
    before = sorted(tmp_path.rglob("*"))
    workshop = Workshop(tmp_path, lambda: None)
    assert [(work["id"], work["status"]) for work in workshop.described()] == [("tries/0001", "interrupted")]
    assert sorted(tmp_path.rglob("*")) == before
    workshop.delete(["tries/0001"])
    assert set(before) - set(tmp_path.rglob("*")) == {
        tmp_path / "tries" / f"0001{suffix}" for suffix in ("", *FILES)
    } | {tmp_path / "tries" / "0001" / "metrics.jsonl"}
    workshop.end()


def test_a_run_that_ended_while_no_studio_looked_on_is_interrupted(tmp_path: Path) -> None:
    """As after a restart of the machine: its process has no number any more, or another one has it."""
    folder = made(tmp_path, "renders/0001", pid=os.getpid(), began=1.0, log_begin=5)
    folder.with_name("0001.log").write_text("said\nstylizing\nat iteration 7\n")
    workshop = Workshop(tmp_path, lambda: None)
    told = workshop.work("renders/0001").described()
    assert told["status"] == "interrupted" and told["actions"] == ["resume", "delete"]
    assert told["error"] == "ended while no studio looked on, as when the machine was restarted: at iteration 7"
    workshop.end()


def test_of_many_tries_a_message_is_small_and_quick(studio: Studio, tmp_path: Path) -> None:
    out = tmp_path / "many"
    for number in range(1, 31):
        folder = made(out, f"tries/{number:04d}")
        lines = [
            {"frame": "smoke", "octave": k // 150, "iteration": k % 150, "loss": 1 / 3 + 1 / (k + 1)}
            for k in range(300)
        ]
        (folder / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    studio.session.workshop.end()
    studio.session.workshop = Workshop(out, lambda: None)
    since = time.process_time()
    message = json.dumps(studio.session.state())
    assert len(message) < 100_000
    assert time.process_time() - since < 0.1
    assert all(len(work["losses"]) <= 140 for work in json.loads(message)["work"])


# ---------------------------------------------------------------- clusters


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("local:0", "expected local:N with N from 1"),
        ("nothing", "expected local:N, tcp://HOST:PORT, or slurm"),
        ("tcp://127.0.0.1:1", "no scheduler answers there"),
        ("slurm:/etc/passwd", "is not below"),
        ("slurm:../jobs.toml", "is not below"),
        ("local:2" + " x" * 300, "expected at most 500"),
        (3, "address is missing, or no text"),
    ],
)
def test_an_address_that_means_no_cluster_is_told_when_it_is_typed(
    studio: Studio, address: object, message: str
) -> None:
    refused = studio.post("/cluster", address=address)
    assert refused.status == 400 and message in refused.error and "\n" not in refused.error
    assert studio.session.cluster is None and studio.session.state()["cluster"] == ""


def test_the_address_goes_to_renders_and_not_to_tries(studio: Studio, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(sys, "executable", "/bin/false")
    assert studio.post("/cluster", address=" local:2 ").status == 200
    assert studio.session.state()["cluster"] == "local:2"
    for action in ("try", "render"):
        studio.post("/work", action=action)
    workshop = studio.session.workshop
    assert workshop.work("tries/0001").process.record.cluster is None
    assert workshop.work("renders/0001").process.record.cluster == "local:2"
    # A render goes on where it was done until now, or on the cluster that is named.
    ended(studio, "renders/0001")
    studio.post("/cluster", address="")
    studio.post("/work", action="resume", id="renders/0001")
    assert ended(studio, "renders/0001")["cluster"] == "local:2"
    studio.post("/cluster", address="local:1")
    studio.post("/work", action="resume", id="renders/0001")
    assert ended(studio, "renders/0001")["cluster"] == "local:1"


def test_files_of_batch_systems_are_named_from_the_started_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tnst_mi.run.cluster_address.shutil.which", lambda command: "/bin/true")
    monkeypatch.setattr("tnst_mi.run.cluster_address.importlib.util.find_spec", lambda name: True)
    (tmp_path / "jobs.toml").write_text("jobs = 2\n")
    assert checked_address("slurm:jobs.toml", Places(tmp_path)) == f"slurm:{tmp_path / 'jobs.toml'}"
    monkeypatch.chdir(tmp_path)
    assert checked_address("slurm:jobs.toml", None) == f"slurm:{tmp_path / 'jobs.toml'}"
    assert checked_address("", None) is None


def test_the_dashboard_is_what_the_run_has_said(tmp_path: Path) -> None:
    said = "cluster: 2 processes, dashboard http://10.0.0.1:8787/status\n"
    (tmp_path / "0001.log").write_text(said * 2 + "dashboard javascript:alert(1)\n")
    process = RunProcess(tmp_path / "0001", WorkRecord("/a.npz", SHAPE, cluster="local:2", log_begin=len(said)))
    assert process.dashboard() == "http://10.0.0.1:8787/status"
    later = RunProcess(tmp_path / "0001", WorkRecord("/a.npz", SHAPE, cluster="local:2", log_begin=2 * len(said)))
    assert later.dashboard() is None
    assert RunProcess(tmp_path / "0001", WorkRecord("/a.npz", SHAPE)).dashboard() is None


def test_a_render_on_a_cluster_outlives_the_studio_and_is_resumed(root: Path, weights: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    out = tmp_path / "out"
    with running(root, out) as studio:
        studio.post("/open", path="smoke.npz")
        studio.session.settings.base = settings(weights, 30)
        studio.post("/goal", key="style", goal="net")
        studio.post("/cluster", address="local:2")
        studio.post("/work", action="render")
        waited_for(lambda: works(studio)["renders/0001"]["done"] > 0)
    workshop = Workshop(out, lambda: None)
    work = workshop.work("renders/0001")
    assert work.status == "running"
    os.kill(work.process.record.pid, signal.SIGKILL)
    waited_for(lambda: work.process.status() == "interrupted")
    workshop.resume("renders/0001")
    waited_for(lambda: work.process.status() != "running")
    assert work.process.status() == "done", work.process.ending()
    record = json.loads((work.process.folder / "run.json").read_text())
    assert [entry["address"] for entry in record["cluster"]][-1] == "local:2"
    workshop.end()
    # The bits are those of a process alone.
    recipe = str(work.process.recipe_file)
    assert main(["stylize", str(root / "smoke.npz"), "--recipe", recipe, "--out", str(tmp_path / "alone")]) == 0
    assert results(tmp_path / "alone") == results(work.process.folder)
