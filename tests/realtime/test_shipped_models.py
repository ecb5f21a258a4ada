"""The models that ship: small, named, with a card, and good for smoke that they have not learned from."""

import json
from pathlib import Path

import numpy as np
import pytest

from tnst_mi.cli import main
from tnst_mi.realtime.model import read_model, shipped_models
from tnst_mi.recipe.recipe import Recipe

OBSTACLE = Path(__file__).parents[2] / "scenes" / "obstacle" / "frame_0056.npz"


def test_their_names():
    assert list(shipped_models()) == ["flames", "flower"]


@pytest.mark.parametrize("name", ["flames", "flower"])
def test_they_are_small_and_say_how_they_were_trained(name):
    model = read_model(Path(name))
    assert model.path.stat().st_size <= 3e6
    card = json.loads(model.path.with_suffix(".json").read_text())
    assert card["curve"][-1]["loss"] < 0.75 * card["loss_before"]
    assert card["curve"][-1]["seconds"] <= 90 * 60
    assert "frame_0056.npz" in [one["name"] for one in card["held_out"]]
    kept = {key: value for key, value in card["recipe"].items() if key != "views"}
    assert Recipe.from_dict(model.recipe) == Recipe.from_dict(kept)
    assert "/" not in json.dumps(dict(model.trained))


def test_a_model_by_name_lowers_the_loss_of_smoke_that_it_has_not_seen(tmp_path):
    """The network that ships is the judge, which is another one than it was trained by."""
    out = tmp_path / "out"
    assert main(["stylize", str(OBSTACLE), "--model", "flames", "--weights", "patterns", "--out", str(out)]) == 0
    (frame,) = json.loads((out / "run.json").read_text())["frames"]
    before, after = frame["loss_before"], frame["loss_after"]
    assert after < 0.85 * before
    assert abs(frame["mass_after"] / frame["mass_before"] - 1) < 0.06
    density = np.load(out / "density" / "frame_0056.npz")["density"]
    assert density.min() >= 0 and density.max() <= 1.01 * np.load(OBSTACLE)["density"].max()


def test_unknown_names_are_told_those_that_there_are(tmp_path, capsys):
    assert main(["stylize", str(OBSTACLE), "--model", "flame", "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "flame: no such file" in said and "ships with the package: flames, flower" in said and said.count("\n") == 1
