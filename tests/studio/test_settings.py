"""What can be set: sliders and goals, checked as recipes are; and the motifs among which is chosen."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from studios import running

from tnst_mi.errors import InputError
from tnst_mi.network.class_names import class_names
from tnst_mi.network.readers import read_weights
from tnst_mi.network.shipped import PATTERNS, shipped_weights
from tnst_mi.recipe.recipe import KINDS, Recipe
from tnst_mi.studio.choices.motifs import Motif, MotifBrowser, _first
from tnst_mi.studio.choices.settings import KNOBS, StudioSettings
from tnst_mi.studio.latest import LatestRecipe
from tnst_mi.studio.places import Places


@pytest.mark.parametrize("knob", KNOBS, ids=lambda knob: knob.key)
def test_every_end_of_a_slider_is_a_value_of_its_key(knob) -> None:
    settings = StudioSettings()
    whole = isinstance(getattr(Recipe(), knob.key), int)
    for value in (knob.low, knob.high, *([knob.word] if knob.word else [])):
        settings.set(knob.key, value)
        assert getattr(settings.recipe, knob.key) == value
        assert type(getattr(settings.recipe, knob.key)) is (int if whole else type(value))
    settings.set(knob.key, None)
    assert settings.recipe == Recipe()


def test_how_smoke_is_coloured_is_one_of_the_words_of_the_key() -> None:
    settings = StudioSettings()
    (pick,) = settings.described()["picks"]
    assert (pick["key"], pick["words"], pick["value"]) == ("colour", ("off", "style", "keep"), "off")
    for word in pick["words"]:
        settings.set("colour", word)
        assert settings.recipe.colour == settings.described()["picks"][0]["value"] == word
    with pytest.raises(InputError, match="off, style or keep"):
        settings.set("colour", "red")
    assert settings.recipe.colour == "keep"
    settings.set("colour", None)
    assert settings.recipe == Recipe()


def test_sliders_come_with_their_keys_help() -> None:
    described = StudioSettings().described()
    for told in [*described["knobs"], *described["picks"]]:
        assert KINDS[told["key"]].expected == told["expected"]
        assert len(told["help"]) > 40 and not told["set"]


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("lam", 2, "from 0 to 1"),
        ("window", 2, "odd"),
        ("iterations", 2.5, "integer"),
        ("gamma", "thick", "number"),
        ("gamma", float("nan"), "number"),
        ("octaves", [1], "integer"),
        ("strength", True, "number"),
        ("weights", "/etc/passwd", "no slider"),
        ("light", "x.xml", "no slider"),
    ],
)
def test_values_that_a_recipe_refuses_change_nothing(key: str, value: object, message: str) -> None:
    settings = StudioSettings()
    settings.set("lam", 0.5)
    with pytest.raises(InputError, match=message):
        settings.set(key, value)
    assert settings.values == {"lam": 0.5}


def test_goals_are_added_and_removed() -> None:
    settings = StudioSettings(Recipe(style=("net",), gamma=0.3))
    for key, goal in (("style", "cells"), ("tag", "spiral"), ("semantic", "inception_4b/pool_proj:16")):
        settings.toggle(key, goal)
    assert [Path(file).stem for file in settings.recipe.style] == ["net", "cells"]
    assert settings.recipe.tag == ("spiral",) and settings.recipe.gamma == 0.3
    settings.toggle("style", "net")
    assert settings.described()["goals"][0] == {"key": "style", "goal": "cells"}
    for key, goal in (("style", "/no/such.png"), ("semantic", "inception_4b"), ("content", "x.png"), ("match", "a:b")):
        before = settings.recipe
        with pytest.raises(InputError):
            settings.toggle(key, goal)
        assert settings.recipe == before


def test_goals_that_the_page_does_not_offer_stay(tmp_path: Path) -> None:
    Image.fromarray(np.eye(8, dtype=np.uint8) * 255).save(tmp_path / "face.png")
    settings = StudioSettings(Recipe(content=(str(tmp_path / "face.png"),)))
    settings.toggle("style", "net")
    assert settings.described()["other_goals"] == ["content"]
    assert settings.recipe.content == (str(tmp_path / "face.png"),)


def test_a_step_follows_from_lambda_as_in_a_recipe() -> None:
    settings = StudioSettings()
    settings.set("lam", 0.5)
    assert settings.recipe.transport == "step"
    settings.set("lam", 0.0)
    assert settings.recipe.transport == "flow"


def test_keyframes_of_a_recipe_stay_until_they_are_replaced() -> None:
    settings = StudioSettings(Recipe(gamma={1: 0.1, 9: 0.9}))
    told = {knob["key"]: knob for knob in settings.described()["knobs"]}
    assert told["gamma"]["keyframed"] and not told["lam"]["keyframed"]
    settings.set("lam", 0.1)
    assert settings.recipe.at(5).gamma == pytest.approx(0.5)
    settings.set("gamma", 0.2)
    assert settings.recipe.keyframes == {}


# ---------------------------------------------------------------- motifs


def atlas(folder: Path, layer: str, *channels: int) -> None:
    """An atlas with a picture for each of some channels."""
    (folder / "channels").mkdir(parents=True)
    (folder / "atlas.json").write_text(json.dumps({"layer": layer, "flavour": PATTERNS}))
    for channel in channels:
        noise = np.random.default_rng(channel).integers(0, 255, (12, 12), np.uint8)
        Image.fromarray(noise).save(folder / "channels" / f"{channel:03d}_picture.png")


@pytest.fixture
def browser(tmp_path: Path) -> MotifBrowser:
    atlas(tmp_path / "root" / "atlases" / "a", "inception_4b/pool_proj", 6, 16)
    atlas(tmp_path / "root" / "b", "logits", 0)
    (tmp_path / "root" / "broken").mkdir()
    (tmp_path / "root" / "broken" / "atlas.json").write_text("[")
    return MotifBrowser(Places(tmp_path / "root"), tmp_path / "out")


def test_styles_tags_and_channels_are_found_by_their_names(browser: MotifBrowser) -> None:
    everything = browser.found("", PATTERNS)
    goals = {kind: [motif["goal"] for motif in everything if motif["kind"] == kind] for kind in ("styles", "channels")}
    assert goals["styles"] == ["cells", "flames", "net", "spirals"]
    assert goals["channels"] == ["inception_4b/pool_proj:6", "inception_4b/pool_proj:16"]
    spirals = [(motif["key"], motif["goal"]) for motif in browser.found(" SPIRAL ", PATTERNS)]
    assert spirals == [("style", "spirals"), ("tag", "spiral")]
    assert browser.found("pool_proj:16", PATTERNS)[0]["goal"] == "inception_4b/pool_proj:16"
    conv = [motif["goal"] for motif in browser.found("conv2/3x3:7", PATTERNS)]
    assert sorted(conv) == ["conv2/3x3:7", "conv2/3x3_reduce:7"]
    assert browser.found("\0" * 500, PATTERNS) == []


def test_all_names_of_a_class_find_it_and_headings_say_what_is_left_out() -> None:
    browser = MotifBrowser(Places(Path()), Path("none"))
    everything = [motif for motif in browser.found("", PATTERNS) if motif["key"] == "tag"]
    assert len(everything) == 64 and {motif["kind"] for motif in everything} == {"tags"}
    names = class_names(read_weights(shipped_weights()))
    synonyms = [
        (name, tag) for whole, tag in zip(names, browser.tags(PATTERNS), strict=True) for name in whole.split(",")
    ]
    assert len(synonyms) > len(names)
    for name, tag in synonyms:
        assert tag in [motif["goal"] for motif in browser.found(name.strip(), PATTERNS)], name
    many = [Motif("tags", "tag", str(number), str(number)) for number in range(70)]
    assert {motif.kind for motif in _first(64, many)} == {"tags: 64 of 70; search for the others"}
    assert _first(70, many) == many


def test_every_goal_that_is_offered_can_be_chosen(browser: MotifBrowser) -> None:
    settings = StudioSettings()
    for motif in browser.found("", PATTERNS) + browser.found("conv2:3", PATTERNS):
        settings.toggle(motif["key"], motif["goal"])
    assert len(settings.described()["goals"]) > 50


def test_pictures_of_an_atlas_are_those_of_channels_and_tags(browser: MotifBrowser) -> None:
    with_pictures = {motif["goal"]: motif["thumbnail"] for motif in browser.found("", PATTERNS) if motif["thumbnail"]}
    first = browser.tags(PATTERNS)[0]
    assert {"inception_4b/pool_proj:16", first, "net"} <= set(with_pictures)
    assert browser.thumbnail(None, "atlases/a/channels/016_picture.png").startswith(b"\x89PNG")
    assert browser.thumbnail("net", None).startswith(b"\x89PNG")


def test_tags_that_share_a_name_are_whole() -> None:
    browser = MotifBrowser(Places(Path()), Path("none"))
    tags = browser.tags(PATTERNS)
    assert len(tags) == len(set(tags)) == 64


def test_the_latest_recipe_outlives_the_studio(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    latest = LatestRecipe(tmp_path / "out")
    latest.keep(Recipe(frames="7:9"))
    assert not (tmp_path / "out").exists()  # nothing has been set
    latest.keep(Recipe(style=("net",), gamma=0.3, frames="7:9"))
    kept = LatestRecipe(tmp_path / "out").recipe
    assert kept.to_toml() == latest.recipe.to_toml() == Recipe(style=("net",), gamma=0.3).to_toml()
    (tmp_path / "out" / "latest.toml").write_text("gamma = 'x'")
    assert LatestRecipe(tmp_path / "out").recipe == Recipe()
    assert "begins with the defaults, since" in capsys.readouterr().err
    # A folder that cannot be written is told once.
    (tmp_path / "file").write_text("")
    latest = LatestRecipe(tmp_path / "file")
    for gamma in (0.4, 0.5):
        latest.keep(Recipe(gamma=gamma))
    assert capsys.readouterr().err.count("is not kept") == 1


@pytest.mark.parametrize(
    ("recipe", "keys"),
    [
        (Recipe(), set()),
        (Recipe(preset="paper", lam=0.5), {"preset", "lam"}),
        (Recipe(gamma={1: 0.1, 9: 0.9}, style=("net",)), {"gamma", "style"}),
        (Recipe(style={1: ["net"], 5: ["cells"]}, lam={1: 0.0, 9: 1.0}), {"style", "lam"}),
        (Recipe(mask={"shape": "sphere", "centre": [1, 2, 3], "radius": 3}, steps=3), {"mask", "steps"}),
    ],
)
def test_of_the_latest_recipe_what_was_given_counts_as_set(tmp_path: Path, recipe: Recipe, keys: set[str]) -> None:
    LatestRecipe(tmp_path).keep(recipe)
    latest = LatestRecipe(tmp_path)
    assert set(latest.values) == keys
    assert StudioSettings(values=latest.values).recipe == latest.recipe


def test_a_studio_begins_with_what_was_set_last(tmp_path: Path) -> None:
    (tmp_path / "root").mkdir()
    for expected in ([], ["net"]):
        with running(tmp_path / "root", tmp_path / "out") as studio:
            assert [goal["goal"] for goal in studio.session.state()["goals"]] == expected
            if not expected:
                studio.post("/goal", key="style", goal="net")
