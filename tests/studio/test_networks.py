"""The network with which a studio tries: chosen, told, and never another one than that of what is gone on with."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jobs import FakeOptimiser, optimiser
from studios import running

import tnst_mi.run.job
from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import save_frames
from tnst_mi.network.shipped import PATTERNS
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.prepare import prepare
from tnst_mi.studio.choices.networks import NetworksTold, UsedNetwork, network_of_run, require_network
from tnst_mi.studio.jobs.processes import RunProcess
from tnst_mi.studio.jobs.work import RENDERS, TRIES
from tnst_mi.studio.places import Places
from tnst_mi.studio.session import Session

__all__ = ["optimiser"]


@pytest.fixture
def smoke(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of smoke; what is begun fails at once."""
    monkeypatch.setattr(sys, "executable", "/bin/false")
    save_frames(tmp_path / "root", [Frame(np.random.default_rng(0).random((4, 6, 5), np.float32), name="smoke")])
    return tmp_path / "root" / "smoke.npz"


def test_the_chosen_network_is_that_of_all_recipes_but_of_no_later_studio(
    smoke: Path, tmp_path: Path, weights: Path, optimiser: FakeOptimiser
) -> None:
    run = smoke.parent / "run"
    list(tnst_mi.run.job.Run(prepare(smoke, Recipe(style=("net",), weights=PATTERNS), run), progress=False))
    session = Session(Places(smoke.parent), tmp_path / "out", weights=str(weights))
    flavour = UsedNetwork.of(str(weights)).flavour
    assert session.state()["network"] == {"flavour": flavour, "file": str(weights)}
    session.open(run)
    assert session.recipe().weights == str(weights)
    # What was made by another network is not tried again by this one, unless one means to.
    with pytest.raises(
        InputError, match=f"run is of the network bvlc 00000000, .*would be done by {flavour} .*--weights"
    ):
        session.begin(TRIES, None)
    assert session.state()["work"] == []
    session.open(smoke)
    session.begin(TRIES, None)
    (work,) = session.state()["work"]
    assert work["network"] == UsedNetwork.of(str(weights)).name and work["network"].startswith(flavour)
    assert json.loads((tmp_path / "out" / "tries" / "0001.json").read_text())["network"] == work["network"]
    assert Recipe.from_toml(tmp_path / "out" / "tries" / "0001.toml").weights == str(weights)
    session.end()
    later = Session(Places(smoke.parent), tmp_path / "out")
    assert later.recipe().weights is None and later.recipe().style == session.recipe().style
    later.end()


def test_what_was_begun_by_another_network_is_not_gone_on_with(
    smoke: Path, tmp_path: Path, weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TNST_MI_WEIGHTS", PATTERNS)
    # Nothing is done after its first moments, and it can be resumed.
    monkeypatch.setattr(RunProcess, "_recorded_status", lambda process: None)
    with running(smoke.parent, tmp_path / "out") as studio:
        studio.post("/open", path=smoke.name)
        studio.post("/goal", key="style", goal="net")
        studio.post("/work", action="try")
        work = studio.session.workshop.work("tries/0001")
        work.process.wait(60)
        work.process.record = replace(work.process.record, code=-9)
        work.update()
        monkeypatch.setattr(work, "kept", lambda octave: (work.process.folder, (0, 1)))
        monkeypatch.setenv("TNST_MI_WEIGHTS", str(weights))
        acts: list[Callable[[], object]] = [
            lambda: studio.session.workshop.resume("tries/0001"),
            lambda: studio.session.workshop.go_on(RENDERS, "tries/0001", None),
            lambda: studio.session.workshop.go_on(TRIES, "tries/0001", 0, studio.session.recipe()),
        ]
        for act in acts:
            with pytest.raises(
                InputError, match=r"try 1 is of the network patterns .*--weights, or begin anew"
            ) as raised:
                act()
            assert "\n" not in str(raised.value)
        assert [work.name for work in studio.session.workshop._works.values()] == ["tries/0001"]
        # Where its recipe names the network itself, it goes on with that one.
        studio.session.workshop.go_on(TRIES, "tries/0001", 0, replace(studio.session.recipe(), weights=PATTERNS))
        assert studio.session.workshop.work("tries/0002").process.record.network == work.process.record.network


def test_channels_are_those_of_the_network_that_is_told(
    smoke: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the network that ships with the package, which runs take for channels only if their recipe names it."""
    monkeypatch.setenv("TNST_MI_WEIGHTS", PATTERNS)
    session = Session(Places(smoke.parent), tmp_path / "out")
    session.open(smoke)
    session.toggle("tag", "spiral")
    assert session.recipe().weights is None
    session.toggle("semantic", "inception_4b/pool_proj:6")
    assert session.recipe().weights == PATTERNS and session.state()["network"]["flavour"] == PATTERNS
    prepare(smoke, session.recipe(), tmp_path / "run")
    session.end()


def test_weights_that_cannot_be_used_are_told_until_they_can(tmp_path: Path, weights: Path) -> None:
    told, file = NetworksTold(), tmp_path / "later.safetensors"
    missing = told.of(str(file))
    assert missing["flavour"] is None and "no such file" in missing["file"]
    file.write_bytes(weights.read_bytes())
    assert told.of(str(file))["flavour"] == UsedNetwork.of(str(weights)).flavour
    # The same contents elsewhere are the same network; others under a name are others.
    assert UsedNetwork.of(str(file)).name == UsedNetwork.of(str(weights)).name
    assert require_network("it", None, PATTERNS, "") == UsedNetwork.of(PATTERNS).name
    for damaged in (None, {}, {"weights": 3}, {"weights": {"sha256": None}}):
        assert network_of_run(damaged) is None
