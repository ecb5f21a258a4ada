"""Tries and renders: processes that the page watches, pauses, resumes and survives."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from studios import Studio, running

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.studio.jobs.live import LiveRun
from tnst_mi.studio.jobs.processes import RunProcess, WorkRecord
from tnst_mi.studio.jobs.work import TRIES
from tnst_mi.studio.jobs.workshop import Workshop

SHAPE = (10, 16, 12)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory, weights: Path) -> Path:
    """A folder with a frame of smoke, and a recipe for a small network."""
    folder = tmp_path_factory.mktemp("work")
    density = np.random.default_rng(0).random(SHAPE, np.float32)
    save_frames(folder / "root", [Frame(density, name="smoke")])
    return folder


def settings(weights: Path, iterations: int) -> Recipe:
    return Recipe(weights=str(weights), octaves=2, iterations=iterations, views=1, gamma=0.2)


@pytest.fixture
def studio(place: Path, weights: Path, tmp_path: Path) -> Iterator[Studio]:
    with running(place / "root", tmp_path / "out") as started:
        started.post("/open", path="smoke.npz")
        started.session.settings.base = settings(weights, 4)
        started.post("/goal", key="style", goal="net")
        yield started


def told(studio: Studio) -> dict[str, Any]:
    return studio.session.state()["work"][0]


def waited_for(condition: Callable[[], bool], seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_try_is_a_draft_whose_losses_are_seen_as_they_come(studio: Studio) -> None:
    news = studio.session.news()
    next(news)
    assert studio.post("/work", action="try").status == 200
    counts = []
    waited_for(lambda: counts.append(json.loads(next(news))["work"][0]) or counts[-1]["status"] != "running")
    assert counts[-1]["status"] == "done", counts[-1]
    done = [state["done"] for state in counts]
    assert done == sorted(done) and done[-1] == counts[-1]["total"] == 4  # of two octaves, a draft has the coarse one
    assert len(counts[-1]["losses"]) == 4 and set(counts[-1]["octaves"]) == {0}
    assert counts[-1]["goals"] == "net" and "mass" in counts[-1]["line"]
    assert counts[-1]["actions"] == ["open", "finish", "delete"]
    # Its recipe makes the same try anywhere.
    text = studio.get("/work/recipe", id="tries/0001").body.decode()
    assert 'quality = "draft"' in text and 'style = ["net"]' in text
    assert b"results" in studio.get("/work/log", id="tries/0001").body
    assert studio.get("/work/picture", id="tries/0001").body.startswith(b"\x89PNG")
    # It is opened, with its settings, and goes on to the end.
    assert studio.post("/work", action="open", id="tries/0001").status == 200
    state = studio.session.state()
    assert state["opened"]["after"] and state["opened"]["title"] == "0001"
    assert studio.post("/work", action="finish", id="tries/0001").status == 200
    waited_for(lambda: told(studio)["status"] != "running")
    rendered = told(studio)
    assert rendered["id"] == "renders/0001" and rendered["status"] == "done", rendered
    assert rendered["done"] == rendered["total"] == 8 and set(rendered["octaves"]) == {1}
    record = json.loads((studio.session.workshop.work("renders/0001").process.folder / "run.json").read_text())
    assert record["from"]["octave"] == 0 and record["from"]["iterations"] == 4


def test_a_run_is_paused_after_an_iteration_and_resumed(studio: Studio, weights: Path) -> None:
    studio.session.settings.base = settings(weights, 500)
    studio.post("/work", action="try")
    waited_for(lambda: told(studio)["done"] > 1)
    studio.post("/work", action="pause", id="tries/0001")
    waited_for(lambda: told(studio)["status"] == "paused")
    paused = told(studio)["done"]
    assert 1 < paused < 500 and told(studio)["actions"] == ["resume", "delete"]
    assert "loss in this octave" in told(studio)["line"] and told(studio)["of"] == "smoke"
    # Tabs hear of nothing while nothing happens.
    version = studio.session.state()["version"]
    time.sleep(1.0)
    assert studio.session.state()["version"] == version
    assert studio.post("/work", action="resume", id="tries/0001").status == 200
    assert "nothing is to be resumed" in studio.post("/work", action="resume", id="tries/0001").error
    waited_for(lambda: told(studio)["done"] > paused + 1)
    assert studio.get("/work/log", id="tries/0001").body.count(b"interrupted; --resume continues") == 1
    assert studio.session.workshop.end() == ["tries/0001"]


def test_a_killed_run_is_found_again_by_another_studio(studio: Studio, weights: Path) -> None:
    studio.session.settings.base = settings(weights, 60)
    studio.post("/work", action="render")
    waited_for(lambda: told(studio)["done"] > 3)
    process = studio.session.workshop.work("renders/0001").process
    os.kill(process.record.pid, signal.SIGKILL)
    waited_for(lambda: told(studio)["status"] == "interrupted")
    assert told(studio)["error"].startswith("killed by SIGKILL: ")
    assert studio.get("/files", at="").status == 200
    again = Workshop(process.folder.parents[1], lambda: None)
    assert again.work("renders/0001").status == "interrupted"
    again.resume("renders/0001")
    waited_for(lambda: again.work("renders/0001").status == "done")
    assert again.work("renders/0001").live.done == 120
    assert again.end() == []


def test_the_end_of_the_studio_pauses_tries_and_leaves_renders(studio: Studio, weights: Path) -> None:
    studio.session.settings.base = settings(weights, 2000)
    for action in ("try", "render"):
        studio.post("/work", action=action)
    waited_for(lambda: all(work["done"] > 0 for work in studio.session.state()["work"]))
    workshop = studio.session.workshop
    assert workshop.end() == ["tries/0001"]
    assert workshop.work("tries/0001").process.status() == "paused"
    rendering = workshop.work("renders/0001").process
    assert rendering.status() == "running"
    # It has a session of its own: the terminal's Ctrl-C does not reach it.
    assert os.getsid(rendering.record.pid) == rendering.record.pid != os.getsid(0)
    later = Workshop(rendering.folder.parents[1], lambda: None)
    assert [(work["id"], work["status"]) for work in later.described()] == [
        ("renders/0001", "running"),
        ("tries/0001", "paused"),
    ]
    later.pause("renders/0001")
    waited_for(lambda: later.work("renders/0001").status == "paused")
    later.end()


def test_what_cannot_be_done_is_told_in_one_line(studio: Studio, place: Path, weights: Path) -> None:
    studio.session.settings.base = Recipe(weights=str(weights), tag=("no such thing",))
    studio.post("/work", action="try")
    waited_for(lambda: told(studio)["status"] == "failed")
    assert told(studio)["error"].startswith("exit code 2: tnst-mi: ") and "no such thing" in told(studio)["error"]
    assert told(studio)["losses"] == [] and told(studio)["states"] == []
    assert told(studio)["actions"] == ["delete"]
    assert "has kept no state of its end" in studio.post("/work", action="finish", id="tries/0001").error
    assert "cannot" not in studio.get("/work/log", id="tries/0001").body.decode()


def test_requests_that_make_no_sense_begin_nothing(studio: Studio) -> None:
    for values in ({"action": "remove", "id": "tries/0001"}, {"action": "pause"}, {"action": 3}, {}):
        assert studio.post("/work", **values).status == 400
    for name in ("tries/0001", "../x", "tries/../../x", ""):
        for action in ("pause", "resume", "open", "finish"):
            assert "no such try" in studio.post("/work", action=action, id=name).error
        for path in ("picture", "recipe", "log"):
            assert studio.get(f"/work/{path}", id=name).status == 400
    studio.post("/goal", key="style", goal="net")
    assert "choose a motif" in studio.post("/work", action="try").error
    assert studio.session.state()["work"] == []


# ---------------------------------------------------------------- without runs


def test_another_process_with_the_number_of_a_dead_one_is_left_alone(tmp_path: Path) -> None:
    own = psutil.Process()
    record = WorkRecord("smoke.npz", SHAPE, pid=own.pid, began=own.create_time() - 100)
    process = RunProcess(tmp_path / "0001", record)
    assert process.status() == "interrupted"
    process.pause()  # would end the tests
    process.kill()
    assert not process.record.paused


@pytest.mark.parametrize("text", ["", "[]", "{", '{"source": 1, "shape": [1, 2, 3]}', '{"source": "a", "shape": [1]}'])
def test_damaged_records_are_no_work(tmp_path: Path, text: str) -> None:
    (tmp_path / "out" / "tries").mkdir(parents=True)
    for name in ("0001", "x", "0002"):
        (tmp_path / "out" / "tries" / f"{name}.toml").write_text("")
    (tmp_path / "out" / "tries" / "0001.json").write_text(text)
    workshop = Workshop(tmp_path / "out", lambda: None)
    assert workshop.described() == []
    workshop.end()


def test_a_log_is_read_as_it_grows(tmp_path: Path) -> None:
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(Recipe(style=("net",), octaves=2, iterations=3).to_toml())
    (tmp_path / "run" / ".work").mkdir(parents=True)
    log = tmp_path / "run" / ".work" / "metrics.jsonl"
    (tmp_path / "run" / "run.json").write_text(json.dumps({"inputs": {"a": "0", "b": "1"}}))
    live = LiveRun(tmp_path / "run", recipe, SHAPE)
    assert not live.update() and live.done == 0 and live.total is None

    def entry(frame: str, octave: int, iteration: int, loss: float) -> str:
        return "\n0badc0de " + json.dumps({"frame": frame, "octave": octave, "iteration": iteration, "loss": loss})

    lines = entry("a", 0, 0, 4.0) + entry("b", 0, 0, 6.0) + entry("a", 0, 1, 3.0)
    for end in range(1, len(lines) + 1, 17):
        log.write_text(lines[:end])
        live.update()
    log.write_text(lines)
    live.update()
    assert live.losses == [5.0, 3.0] and live.octaves == [0, 0]
    assert (live.done, live.total) == (3, 12)
    # A resumed run does the last iteration again, and what is torn is nobody's.
    log.write_text(lines + entry("a", 0, 1, 3.5) + '\n0bad {"frame": "a", "octa' + entry("a", 1, 0, 9.0))
    assert live.update()
    assert live.losses == [5.0, 3.5, 9.0] and live.octaves == [0, 0, 1] and live.done == 4


def test_of_a_sequence_the_shown_frame_is_tried_alone(
    tmp_path: Path, weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    values = np.ones(SHAPE, np.float32)
    save_frames(tmp_path / "root" / "smoke", [Frame(values, name=f"f_{n}", number=n) for n in (7, 8, 9, 10)])
    with running(tmp_path / "root", tmp_path / "out") as studio:
        studio.post("/open", path="smoke")
        studio.session.settings.base = Recipe(weights=str(weights), frames="7:9")
        studio.post("/goal", key="style", goal="net")
        for values, frames in (({"alone": 1}, "8"), ({"alone": None}, "7:9"), ({}, "7:9")):
            assert studio.post("/work", action="try", **values).status == 200
            process = studio.session.workshop.work(told(studio)["id"]).process
            assert Recipe.from_toml(process.recipe_file).frames == frames
            assert (process.record.alone, process.record.frames) == (frames == "8", "7:9")
            waited_for(lambda process=process: process.status() == "failed")
        for alone in (-1, 4, "1", True, 1.5):
            assert studio.post("/work", action="try", alone=alone).status == 400


def test_tries_are_numbered_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    workshop = Workshop(tmp_path / "out", lambda: None)
    recipe = Recipe(style=("net",))
    assert [workshop.begin(TRIES, Path("a.npz"), recipe, SHAPE) for _ in range(2)] == ["tries/0001", "tries/0002"]
    assert Workshop(tmp_path / "out", lambda: None).begin(TRIES, Path("a.npz"), recipe, SHAPE) == "tries/0003"
    waited_for(lambda: workshop.work("tries/0001").process.status() == "failed")
    assert workshop.work("tries/0001").process.ending() == "exit code 1: without a word"
    with pytest.raises(InputError, match="no such try"):
        workshop.pause("tries/0003")
    workshop.end()
