"""Whatever is in the folder of a studio harms no more than the try whose files they are, and shows nothing else."""

from __future__ import annotations

import errno
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from studios import Studio, running

from tnst_mi.errors import InputError
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.studio.choices.motifs import MotifBrowser
from tnst_mi.studio.jobs.live import LiveRun
from tnst_mi.studio.jobs.processes import RunProcess, WorkRecord
from tnst_mi.studio.jobs.removal import claimed_number, remove
from tnst_mi.studio.jobs.work import TRIES, StudioWork
from tnst_mi.studio.jobs.workshop import Workshop
from tnst_mi.studio.places import Places
from tnst_mi.studio.plain import is_plain, opened_plain
from tnst_mi.studio.telling import json_text

SHAPE = (10, 16, 12)
SECRET = "of somebody else"


def made(out: Path, name: str, **others: Any) -> Path:
    """A try that was begun by an earlier studio, whose process is gone."""
    folder = out / name
    (folder / "images").mkdir(parents=True)
    folder.with_name(f"{folder.name}.toml").write_text(Recipe(style=("net",)).to_toml())
    folder.with_name(f"{folder.name}.log").write_text("said\n")
    record = WorkRecord("/smoke.npz", SHAPE, **others)
    folder.with_name(f"{folder.name}.json").write_text(json.dumps(asdict(record)))
    return folder


def strictly(text: str) -> Any:
    """JSON as browsers read it."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    folder = tmp_path_factory.mktemp("damage")
    (folder / "root").mkdir()
    (folder / "secret").write_text(SECRET)
    Image.fromarray(np.zeros((8, 8), np.uint8)).save(folder / "secret.png")
    for number in range(1, 5):
        made(folder / "out", f"tries/{number:04d}")
    with running(folder / "root", folder / "out") as started:
        yield started


# ---------------------------------------------------------------- damaged values

#: As a file may have them, numbers included that JSON has not.
NUMBERS = st.sampled_from(["NaN", "Infinity", "-Infinity", "1e999", "-1e999", "1" + "0" * 400, "-1", "0", "1.5", "2"])
TEXTS = st.sampled_from(['""', '"\\ud800"', '"a\\u0000b"', '"' + "a" * 5000 + '"'])
VALUES = st.one_of(NUMBERS, TEXTS, st.sampled_from(["null", "true", "[]", "{}", "[1e999]", '{"a": NaN}']))
ENTRY = {"octave": "0", "iteration": "1", "frame": '"a"', "loss": "0.5"}
RECORD = {"source": '"/a"', "shape": "[10, 16, 12]", "pid": "0", "began": "0.0", "code": "3", "log_begin": "0"}
RECORD |= {"alone": "true", "frames": "null", "start_from": "null"}
STATE = {"octave": "1", "iterations": "2"}
FRAME = {"mass_before": "1", "mass_after": "2", "loss_before": "1", "loss_after": "2", "state": "STATE"}
RUN = {"status": '"done"', "frames": "[FRAME]", "inputs": '{"a": "b"}', "from": "STATE", "seconds": "1"}


@st.composite
def damaged(draw: st.DrawFn, sound: dict[str, str]) -> str:
    """An object in which some values are others, or missing."""
    values = sound | draw(st.dictionaries(st.sampled_from(sorted(sound)), VALUES, max_size=2))
    names = draw(st.permutations(sorted(values)))[draw(st.integers(0, 1)) :]
    return "{" + ", ".join(f'"{name}": {values[name]}' for name in names) + "}"


@st.composite
def damaged_run(draw: st.DrawFn) -> str:
    run = draw(damaged(RUN)).replace("FRAME", draw(damaged(FRAME)))
    return run.replace("STATE", draw(damaged(STATE)))


@settings(max_examples=50, deadline=None)
@given(st.lists(damaged(ENTRY), max_size=4), damaged(RECORD), st.booleans(), damaged_run())
def test_damaged_values_harm_nothing_else(
    tmp_path_factory: pytest.TempPathFactory, log: list[str], record: str, replaced: bool, run: str
) -> None:
    out = tmp_path_factory.mktemp("values")
    folder = made(out, "tries/0001")
    made(out, "tries/0002")
    (folder / "metrics.jsonl").write_text("".join(f"{line}\n" for line in log))
    (folder / "run.json").write_text(run)
    if replaced:
        (out / "tries" / "0001.json").write_text(record)
    workshop = Workshop(out, lambda: None)
    told = {work["id"]: work for work in strictly(json.dumps(workshop.described(), allow_nan=False))}
    assert told["tries/0002"]["status"] == "interrupted"
    assert set(told) == {"tries/0002"} or set(told["tries/0001"]) == set(told["tries/0002"])
    workshop.end()


def test_losses_that_are_no_numbers_are_passed_over(studio: Studio, tmp_path: Path) -> None:
    lines = [ENTRY | {"loss": loss} for loss in ("NaN", "1e999", "1e308", "1" + "0" * 400, '"x"', "null", "0.25")]
    lines += [ENTRY | {"octave": "1e999"}, ENTRY | {"iteration": "-1"}, ENTRY | {"octave": "1" + "0" * 400}]
    (tmp_path / "metrics.jsonl").write_text(
        "".join("{" + ", ".join(f'"{name}": {value}' for name, value in line.items()) + "}\n" for line in lines)
    )
    live = LiveRun(tmp_path, tmp_path / "recipe.toml", SHAPE)
    live.update()
    assert live.losses == [0.25] and live.octaves == [0]


def test_what_is_told_is_json(monkeypatch: pytest.MonkeyPatch, studio: Studio) -> None:
    assert strictly(json_text({"a": [float("nan"), (1.5, float("inf"))], "b": {"c": -float("inf")}})) == {
        "a": [None, [1.5, None]],
        "b": {"c": None},
    }
    monkeypatch.setattr(studio.session, "state", lambda: {"version": float("nan")})
    assert strictly(next(studio.session.news())) == {"version": None}


# ---------------------------------------------------------------- errors while a run is watched


def waited_for(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_the_watcher_survives_what_it_cannot_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sleep").write_text("#!/bin/sh\nsleep 0.5\nexit 2\n")
    (tmp_path / "sleep").chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "sleep"))
    workshop = Workshop(tmp_path / "out", lambda: None)
    names = [workshop.begin(TRIES, Path("a.npz"), Recipe(style=("net",)), SHAPE) for _ in range(2)]
    record = tmp_path / "out" / f"{names[0]}.json"
    record.unlink()
    record.mkdir()
    (record / "x").write_text("")
    waited_for(lambda: all(work["status"] == "failed" for work in workshop.described()))
    assert workshop._watching.is_alive()
    assert "0001.json cannot be written" in str(workshop.work(names[0]).process.trouble)
    # It is written once that can be done.
    (record / "x").unlink()
    record.rmdir()
    assert workshop.work(names[0]).process.status() == "failed" and record.is_file()
    workshop.end()


def test_a_full_disk_is_said_on_the_card(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(record: WorkRecord, path: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    folder = made(tmp_path, "tries/0001", pid=os.getpid(), began=0.0)
    process = RunProcess(folder, WorkRecord("/a.npz", SHAPE, paused=True))
    monkeypatch.setattr(WorkRecord, "write", full)
    process._note(code=None)
    work = StudioWork("tries/0001", process)
    assert work.described()["status"] == "paused"
    assert work.described()["error"].endswith("0001.json cannot be written (No space left on device)")
    with pytest.raises(InputError, match="No space left on device"):
        process.start()  # what could not be found again is not begun


def test_whatever_one_try_raises_is_said_on_its_card(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(live: LiveRun) -> bool:
        if live._folder.name == "0001":
            raise ZeroDivisionError("nothing to divide by")
        return False

    for name in ("tries/0001", "tries/0002"):
        made(tmp_path, name)
    monkeypatch.setattr(LiveRun, "update", fails)
    workshop = Workshop(tmp_path, lambda: None)
    told = {work["id"]: work for work in workshop.described()}
    assert told["tries/0001"]["error"] == "its files are damaged (ZeroDivisionError: nothing to divide by)"
    assert told["tries/0001"]["actions"] == ["delete"]
    assert "damaged" not in told["tries/0002"]["error"]
    assert set(told["tries/0001"]) == set(told["tries/0002"])
    workshop.end()


# ---------------------------------------------------------------- links


def test_nothing_is_read_through_links(studio: Studio, tmp_path: Path) -> None:
    out = studio.session.workshop.work("tries/0001").process.folder.parents[1]
    secret, tries = out.parent / "secret", out / "tries"
    for suffix in (".log", ".toml"):
        (tries / f"0001{suffix}").unlink()
        (tries / f"0001{suffix}").symlink_to(secret)
    assert studio.get("/work/log", id="tries/0001").body == b""
    assert studio.get("/work/recipe", id="tries/0001").body == b""
    # Pictures, by themselves and in folders that are links.
    (tries / "0001" / "images" / "a_comparison.png").symlink_to(out.parent / "secret.png")
    (tmp_path / "a_comparison.png").write_bytes((out.parent / "secret.png").read_bytes())
    (tries / "0002" / "images").rmdir()
    (tries / "0002" / "images").symlink_to(tmp_path)
    for number in (1, 2):
        assert studio.get("/work/picture", id=f"tries/000{number}").status == 400
    # A log that is a link is not written to.
    with pytest.raises(OSError, match="link"):
        studio.session.workshop.work("tries/0001").process.start()
    assert secret.read_text() == SECRET
    # Nor is a recipe that is one the beginning of a try, now or in a later studio.
    later = Workshop(out, lambda: None)
    assert not later.holds("tries/0001") and later.holds("tries/0003")
    later.end()


def test_styles_that_are_links_are_not_offered(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((8, 8), np.uint8)).save(tmp_path / "secret.png")
    (tmp_path / "out" / "pictures").mkdir(parents=True)
    (tmp_path / "out" / "pictures" / "mine.png").symlink_to(tmp_path / "secret.png")
    (tmp_path / "out" / "pictures" / "folder.png").mkdir()
    browser = MotifBrowser(Places(tmp_path), tmp_path / "out")
    assert {motif["title"] for motif in browser.found("", None) if motif["key"] == "style"}.isdisjoint(
        {"mine", "secret", "folder"}
    )
    with pytest.raises(InputError, match="no such style"):
        browser.thumbnail(str(tmp_path / "secret.png"))


def test_plain_files_are_told_from_others(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "file").write_text("")
    (tmp_path / "link").symlink_to("folder/file")
    (tmp_path / "nowhere").symlink_to("none")
    (tmp_path / "linked").symlink_to("folder")
    plain = tmp_path / "folder" / "file"
    assert is_plain(plain, tmp_path) and is_plain(tmp_path / "none")
    assert not is_plain(tmp_path / "linked" / "file", tmp_path)
    for name in ("pipe", "folder", "link", "nowhere"):
        assert not is_plain(tmp_path / name)
        for mode in ("rb", "ab"):
            with pytest.raises(OSError, match="no plain file"):
                opened_plain(tmp_path / name, mode)


# ---------------------------------------------------------------- numbers


def test_numbers_that_others_have_are_passed_over(tmp_path: Path) -> None:
    made(tmp_path, "9")
    (tmp_path / "0010").mkdir()
    (tmp_path / "0010" / "notes.txt").write_text(SECRET)
    (tmp_path / "0011.log").write_text(SECRET)
    (tmp_path / "0012").symlink_to("nowhere")
    assert [claimed_number(tmp_path) for _ in range(2)] == [13, 14]


def test_a_folder_of_somebody_else_is_not_deleted(tmp_path: Path) -> None:
    for names in (["notes.txt"], []):
        folder = made(tmp_path, f"tries/{len(names) + 1:04d}")
        (folder / "images").rmdir()
        for name in names:
            (folder / name).write_text(SECRET)
        remove(folder)
        assert folder.is_dir() == bool(names)
        assert not folder.with_name(f"{folder.name}.toml").exists()


def test_beyond_the_last_number_nothing_begins(tmp_path: Path) -> None:
    (tmp_path / "tries").mkdir()
    (tmp_path / "tries" / "highest_number").write_text("999998\n")
    workshop = Workshop(tmp_path, lambda: None)
    assert claimed_number(tmp_path / "tries") == 999_999
    with pytest.raises(InputError, match="999999 was the last number; give another --out"):
        workshop.begin(TRIES, Path("a.npz"), Recipe(style=("net",)), SHAPE)
    workshop.end()
