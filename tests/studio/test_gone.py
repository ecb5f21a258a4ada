"""What goes while a studio is open: files of its recipe, inputs, tries that are deleted, and its own folder."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from PIL import Image
from studios import Studio, running

from tnst_mi.commands.studio import _open, alone_in
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.studio.jobs.processes import RunProcess, WorkRecord
from tnst_mi.studio.jobs.work import TRIES
from tnst_mi.studio.jobs.workshop import Workshop
from tnst_mi.studio.places import Places
from tnst_mi.studio.session import Session

SHAPE = (10, 16, 12)


def sequence(folder: Path, *numbers: int) -> None:
    frames = [np.random.default_rng(number % 100).random(SHAPE, np.float32) for number in numbers]
    save_frames(folder, [Frame(frame, name=f"s_{n:04d}", number=n) for n, frame in zip(numbers, frames, strict=True)])


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two sequences of smoke."""
    folder = tmp_path_factory.mktemp("gone")
    sequence(folder / "smoke", 7, 8, 9)
    sequence(folder / "other", 1, 2)
    return folder


@pytest.fixture
def studio(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Studio]:
    """A studio whose tries fail at once."""
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with running(root, tmp_path / "out") as started:
        assert started.post("/open", path="smoke").status == 200
        yield started


def waited_for(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def picture(mode: str, size: tuple[int, int]) -> bytes:
    body = io.BytesIO()
    Image.new(mode, size, (255, 255) if mode == "LA" else 200).save(body, "PNG")
    return body.getvalue()


def made(out: Path, name: str, source: Path, **others: Any) -> Path:
    """A try of frame 8 that has done an iteration, and whose process is gone."""
    folder = out / name
    folder.mkdir(parents=True)
    entry = {"octave": 0, "iteration": 0, "frame": "s_0008", "loss": 0.5}
    (folder / "metrics.jsonl").write_text(json.dumps(entry) + "\n")
    folder.with_name(f"{folder.name}.toml").write_text(Recipe(style=("net",), frames="8").to_toml())
    WorkRecord(str(source), SHAPE, alone=True, **others).write(folder.with_name(f"{folder.name}.json"))
    return folder


# ---------------------------------------------------------------- files of the recipe


@pytest.mark.parametrize("kind", ["style", "mask"])
def test_without_a_file_of_its_recipe_all_else_goes_on(studio: Studio, tmp_path: Path, kind: str) -> None:
    """Only what needs the file is refused, until what names it is removed."""
    studio.post("/goal", key="style", goal="net")
    if kind == "style":
        studio.request("POST", "/upload?name=mine.png", picture("L", (32, 32)))
        file = tmp_path / "out" / "pictures" / "mine.png"
    else:
        painted = studio.request("POST", "/painting?target=0&azimuth=0&elevation=0&frame=0", picture("LA", (12, 16)))
        assert painted.status == 200
        file = tmp_path / "out" / "masks" / "0001.png"
    assert studio.post("/work", action="try").status == 200
    file.unlink()
    waited_for(lambda: studio.session.state()["work"][0]["status"] == "failed")
    assert studio.post("/set", key="strength", value=0.3).status == 200
    assert studio.post("/open", path="smoke").status == 200
    assert studio.get("/motifs", find="net").status == 200
    assert studio.post("/goal", key="style", goal="cells").status == 200
    refused = studio.post("/work", action="try")
    assert refused.status == 400 and file.name in refused.error and "bring it back, or remove" in refused.error
    if kind == "style":
        assert studio.post("/goal", key="style", goal=str(file)).status == 200
        assert [goal["goal"] for goal in studio.session.state()["goals"]] == ["net", "cells"]
    else:
        assert studio.post("/mask", action="remove", part=0).status == 200
    assert studio.post("/work", action="try").status == 200
    assert studio.session.workshop._watching.is_alive()


def test_what_cannot_be_told_keeps_neither_watcher_nor_tabs(
    studio: Studio, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails() -> None:
        raise ZeroDivisionError

    workshop = Workshop(tmp_path / "another", lambda: None)
    name = workshop.begin(TRIES, Path("a.npz"), Recipe(style=("net",)), SHAPE)
    monkeypatch.setattr(workshop, "_changed", fails)
    workshop.work(name).process.wait(10)
    waited_for(lambda: workshop.work(name).status == "failed")
    time.sleep(0.1)
    assert workshop._watching.is_alive()
    workshop.end()
    news = studio.session.news()
    with monkeypatch.context() as patch:
        patch.setattr(studio.session.settings, "described", fails)
        assert next(news) == ""
    studio.post("/set", key="strength", value=0.3)
    assert json.loads(next(news))["opened"]["title"] == "smoke"


# ---------------------------------------------------------------- inputs, and tries of one of their frames


def test_a_try_of_one_frame_restricts_nothing_else(
    root: Path, tmp_path: Path, weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(root, tmp_path / "root")
    out = tmp_path / "root" / "out"
    with running(tmp_path / "root", out) as studio:
        session = studio.session
        studio.post("/open", path="smoke")
        session.settings.base = Recipe(weights=str(weights), octaves=1, iterations=2, views=1, gamma=0.2)
        studio.post("/goal", key="style", goal="net")
        studio.post("/work", action="try", alone=0)
        waited_for(lambda: session.state()["work"][0]["status"] == "done")
        # However it is opened, it is shown among the others, and what is set is for all.
        shutil.copytree(out / "tries" / "0001", tmp_path / "root" / "copied")
        for path in ("out/tries/0001", "smoke/../out/tries/0001"):
            assert studio.post("/open", path=path).status == 200
            state = session.state()
            assert state["frames"] is None and len(state["opened"]["names"]) == 3
            assert state["opened"]["stylized"] == [0]
        # What stays restricted is told, until all frames are taken, or another input.
        studio.post("/open", path="copied")
        assert session.state()["frames"] == "7"
        assert studio.post("/work", action="all-frames").status == 200
        assert session.state()["frames"] is None
        studio.post("/open", path="copied")
        studio.post("/open", path="other")
        assert session.state()["frames"] is None and session.recipe().style
        # A frame of the input that is damaged is none of the try's, which is opened.
        (tmp_path / "root" / "smoke" / "s_0008.npz").write_bytes(b"")
        assert studio.post("/work", action="open", id="tries/0001").status == 200
        # It is deleted, as is said, although nothing is left that could be shown in its place.
        shutil.rmtree(tmp_path / "root" / "smoke")
        assert studio.post("/work", action="delete", ids=["tries/0001"]).status == 200
        state = session.state()
        assert state["work"] == [] and state["opened"] is None and "smoke" in state["notice"]
        assert "nothing is opened" in studio.get("/place", frame=0).error
        studio.post("/open", path="other")
        assert session.state()["notice"] is None


def test_going_on_from_one_frame_leaves_the_others_to_what_begins_anew(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made(tmp_path / "out", "tries/0001", root / "smoke", frames="7:8")
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with running(root, tmp_path / "out") as studio:
        assert studio.post("/work", action="branch", id="tries/0001", octave=None).status == 200
        assert studio.session.recipe().frames == "7:8"
        studio.post("/work", action="try")
        assert Recipe.from_toml(tmp_path / "out" / "tries" / "0002.toml").frames == "8"
        studio.post("/work", action="anew")
        studio.post("/work", action="render")
        assert Recipe.from_toml(tmp_path / "out" / "renders" / "0001.toml").frames == "7:8"


def test_frames_of_long_numbers_are_tried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As times are, which browsers would round."""
    numbers = (20261127213726123, 20261127213726124)
    sequence(tmp_path / "root" / "smoke", *numbers)
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with running(tmp_path / "root", tmp_path / "out") as studio:
        studio.post("/open", path="smoke")
        assert studio.session.state()["opened"]["numbers"] == [str(number) for number in numbers]
        studio.post("/goal", key="style", goal="net")
        assert studio.post("/work", action="try", alone=1).status == 200
    recipe = Recipe.from_toml(tmp_path / "out" / "tries" / "0001.toml")
    assert recipe.frame_range == (numbers[1], numbers[1])


# ---------------------------------------------------------------- deletions under way


def test_nothing_begins_from_what_is_being_deleted(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made(tmp_path / "out", "tries/0001", root / "smoke")
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with running(root, tmp_path / "out") as studio:
        studio.post("/work", action="branch", id="tries/0001", octave=None)
        waits, ends = threading.Event(), threading.Event()

        def wait(process: RunProcess, seconds: float) -> None:
            waits.set()
            assert ends.wait(30)

        monkeypatch.setattr(RunProcess, "wait", wait)
        replies: list[int] = []
        ask = {"action": "delete", "ids": ["tries/0001"]}
        deleting = threading.Thread(target=lambda: replies.append(studio.post("/work", **ask).status))
        deleting.start()
        assert waits.wait(30)
        for values in ({"action": "try"}, *({"action": name, "id": "tries/0001"} for name in ("resume", "finish"))):
            assert studio.post("/work", **values).error == "studio: tries/0001 is being deleted; choose another one"
        for action in ("open", "branch"):
            assert "is being deleted" in studio.post("/work", action=action, id="tries/0001").error
        ends.set()
        deleting.join()
        assert replies == [200] and studio.session.state()["work"] == [] and studio.session.start is None
        # What cannot be deleted stays, and can be gone on from.
        made(tmp_path / "out", "tries/0003", root / "smoke")
        made(tmp_path / "out", "tries/0004", root / "smoke", start_from=str(tmp_path / "out" / "tries" / "0003"))
        later = Workshop(tmp_path / "out", lambda: None)
        with pytest.raises(InputError, match="goes on from tries/0003"):
            later.delete(["tries/0003"])
        later.resume("tries/0003")
        later.end()


# ---------------------------------------------------------------- the folder of the studio


def test_a_studio_leaves_a_folder_alone_that_another_one_has_by_now(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    out, recipe = tmp_path / "out", Recipe(style=("net",))
    with alone_in(out) as lock:
        session = Session(Places(root), out, lock=lock)
        session.open(root / "smoke")
        session.toggle("style", "net")
        session.begin(TRIES, None)
        waited_for(lambda: session.workshop.work("tries/0001").status == "failed")
        shutil.rmtree(out)
        with alone_in(out):
            second = Workshop(out, lambda: None)
            second.begin(TRIES, root / "smoke", recipe, SHAPE)
            waited_for(lambda: second.work("tries/0001").status == "failed")
            second.end()
            before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
            for act in (
                lambda: session.begin(TRIES, None),
                lambda: session.workshop.resume("tries/0001"),
                lambda: session.delete(["tries/0001"]),
            ):
                with pytest.raises(InputError, match="removed or replaced, so nothing is written there any more; end"):
                    act()
            session.set("strength", 0.3)
            session.workshop.work("tries/0001").process._note(code=5)
            session.end()
            assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
    assert "the latest recipe is not kept" in capsys.readouterr().err


# ---------------------------------------------------------------- what an earlier studio has left


@pytest.mark.parametrize("source", ["a" * 5000, "\ud800", "a\0b", ""])
def test_a_record_that_names_no_file_harms_no_other(root: Path, tmp_path: Path, source: str) -> None:
    file = made(tmp_path, "tries/0001", root / "smoke").with_suffix(".json")
    made(tmp_path, "tries/0002", root / "smoke")
    file.write_text(json.dumps(json.loads(file.read_text()) | {"source": source}))
    workshop = Workshop(tmp_path, lambda: None)
    told = {work["id"]: work for work in workshop.described()}
    assert set(told) == {"tries/0001", "tries/0002"} and told["tries/0002"]["of"] == "smoke, frame 8"
    workshop.delete(["tries/0001"])
    workshop.end()


def test_a_process_of_an_earlier_studio_that_was_looked_on_at_has_ended(tmp_path: Path) -> None:
    with subprocess.Popen(["sleep", "60"]) as sleeping:
        began = psutil.Process(sleeping.pid).create_time()
        process = RunProcess(tmp_path / "0001", WorkRecord("/a.npz", SHAPE, pid=sleeping.pid, began=began))
        assert process.status() == "running"
        sleeping.kill()
    assert process.status() == "interrupted"
    assert process.ending() == "ended; its exit code is not known: without a word"


def test_what_was_set_last_can_be_set_back(root: Path, tmp_path: Path) -> None:
    with running(root, tmp_path / "out") as studio:
        studio.post("/goal", key="style", goal="net")
        for key, value in (("strength", 0.3), ("lam", 0.5)):
            studio.post("/set", key=key, value=value)
    with running(root, tmp_path / "out") as studio:
        assert set(studio.session.settings.values) == {"style", "strength", "lam"}
        assert studio.session.recipe().transport == "step"
        knobs = {knob["key"]: knob for knob in studio.session.state()["knobs"]}
        assert knobs["strength"]["value"] == 0.3 and knobs["strength"]["set"]
        for key in ("strength", "lam"):
            studio.post("/set", key=key, value=None)
        assert studio.session.recipe().to_toml() == Recipe(style=("net",)).to_toml()


def test_why_the_latest_recipe_is_not_used_is_said_on_the_page(root: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "mine.toml").write_text("strength = 0.3")
    for text in (None, "strength = 7", 'style = ["/gone.png"]'):
        (tmp_path / "out" / "latest.toml").unlink(missing_ok=True)
        if text is None:
            (tmp_path / "out" / "latest.toml").symlink_to(tmp_path / "mine.toml")
        else:
            (tmp_path / "out" / "latest.toml").write_text(text)
        session = Session(Places(root), tmp_path / "out")
        _open(session, root / "smoke")
        notice = session.state()["notice"]
        assert "begins with the defaults, since the latest recipe cannot be used: " in notice and "\n" not in notice
        assert session.recipe() == Recipe()
        session.open(root / "smoke")
        assert session.state()["notice"] is None
        session.end()
