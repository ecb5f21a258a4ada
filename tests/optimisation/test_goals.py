"""From a recipe to its terms and weights: content layers and maps of features."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import torch
from networks import random_googlenet
from PIL import Image

from tnst_mi.errors import InputError
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.optimisation.goals import objective_of, require_known, require_meant, term_weights
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.measure import file_digests

LAYERS = {"conv2/3x3": 0.5, "inception_3b/output": 2.0}


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> GoogLeNet:
    """A narrow GoogLeNet with random weights."""
    return GoogLeNet.load(random_googlenet(tmp_path_factory.mktemp("weights") / "random.safetensors", narrow=8))


def files(folder: Path) -> Recipe:
    """A recipe with a content picture, a map, a channel and a style, its files in a folder."""
    pixels = np.random.default_rng(0).integers(0, 256, (32, 24), dtype=np.uint8)
    Image.fromarray(pixels).save(folder / "face.png")
    np.savez(folder / "map.npz", map=np.linspace(0, 1, 24, dtype=np.float32)[:, None, None] * np.ones((1, 3, 5)))
    keys = {
        "semantic": ["inception_3a/3x3:2"],
        "content": ["face.png"],
        "content_layers": LAYERS,
        "match": ["conv2/3x3:map.npz"],
        "style": ["net"],
        "semantic_weight": 3.0,
        "style_weight": 7.0,
    }
    return Recipe.from_dict(keys, folder=folder)


def test_content_pictures_are_matched_at_every_layer_with_its_weight(network: GoogLeNet, tmp_path: Path) -> None:
    recipe = files(tmp_path)
    objective = objective_of(recipe)
    names = ["content face.png conv2/3x3", "content face.png inception_3b/output"]
    assert objective.names == ["semantic inception_3a/3x3:2", *names, "match conv2/3x3", "style net.png"]
    assert [weight for weight, _ in objective.weighted_terms] == term_weights(recipe) == [3.0, 1.5, 6.0, 3.0, 7.0]

    images = torch.rand((2, 32, 24), generator=torch.Generator().manual_seed(0))
    grey = torch.from_numpy(np.asarray(Image.open(tmp_path / "face.png"), np.float32) / 255)[None]
    found = objective.bind(network, 32, 24).evaluate(images)[1]
    with torch.no_grad():
        seen, wanted = (network(x[:, None].expand(-1, 3, -1, -1), layers=list(LAYERS)) for x in (images, grey))
    for name, layer in zip(names, LAYERS, strict=True):
        expected = (seen[layer] - wanted[layer]).square().flatten(1).mean(1).sum()
        assert found[name].item() == pytest.approx(expected.item(), rel=1e-5)


def test_maps_are_files_of_the_recipe(tmp_path: Path) -> None:
    """Relative to it, absolute once it is read, written to its TOML, and hashed like pictures."""
    recipe = files(tmp_path)
    assert recipe.maps == [("conv2/3x3", tmp_path / "map.npz")]
    (tmp_path / "recipe.toml").write_text(recipe.to_toml(), "utf-8")
    assert Recipe.from_toml(tmp_path / "recipe.toml") == recipe
    before = file_digests(recipe)
    assert set(before) == {str(tmp_path / "face.png"), str(tmp_path / "map.npz"), recipe.style[0]}
    np.savez(tmp_path / "map.npz", map=np.zeros((24, 1, 1)))
    changed = {path for path, digest in file_digests(recipe).items() if digest != before[path]}
    assert changed == {str(tmp_path / "map.npz")}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (["conv2/3x3:nowhere.npz"], r"^recipe: match = 'conv2/3x3:nowhere.npz': no such file \(.*nowhere.npz\)$"),
        (["map.npz"], "^recipe: match = .*: expected a list of layers with files, such as"),
        ({"49": ["conv2/3x3:map.npz"]}, "^recipe: match = .*: cannot be keyframed"),
    ],
)
def test_bad_values_of_match_are_one_line(value: object, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message) as error:
        Recipe.from_dict({"match": value}, folder=tmp_path)
    assert "\n" not in str(error.value)


def test_a_map_of_another_number_of_channels_is_refused_when_it_is_bound(network: GoogLeNet, tmp_path: Path) -> None:
    recipe = files(tmp_path)
    np.savez(tmp_path / "map.npz", map=np.zeros((23, 1, 1)))
    with pytest.raises(InputError, match=r"^match conv2/3x3: the map has shape \(23, 1, 1\), expected 24 channels"):
        objective_of(recipe).bind(network, 32, 24)


def test_maps_are_of_one_network_as_channels_are(tmp_path: Path) -> None:
    patterns = GoogLeNet.load("patterns")
    recipe = files(tmp_path).updated({"semantic": []}, "", tmp_path)
    with pytest.raises(InputError, match=r"^match 'conv2/3x3:.*map.npz': "):
        require_meant(recipe, patterns, fallback=True)
    require_meant(recipe.updated({"match": []}, "", tmp_path), patterns, fallback=True)


def test_a_class_or_channel_that_is_not_there_says_which_network_was_taken_and_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = GoogLeNet.from_file(random_googlenet(tmp_path / "tiny.safetensors", narrow=8))
    monkeypatch.delenv("TNST_MI_WEIGHTS", raising=False)
    with pytest.raises(InputError) as error:
        require_known(Recipe(tag=("flower",)), network, fallback=False)
    message = str(error.value)
    which = f"network {network.flavour} (found at {tmp_path / 'tiny.safetensors'}): "
    assert message.startswith(f"{which}class tag 'flower': unknown; the nearest are 'cauliflower', ")
    assert message.endswith("; --weights patterns has this tag")
    message = rf"^{re.escape(which)}channel 9999 of layer 'conv2/3x3': expected 0 to \d+$"
    with pytest.raises(InputError, match=message):
        require_known(Recipe(semantic=("conv2/3x3:9999",)), network, fallback=False)
    with pytest.raises(
        InputError, match=r"^network \w+ \(as weights says\): class tag 'zzzz'(?!.*patterns)"
    ):  # patterns has none of that name
        require_known(Recipe(tag=("zzzz",), weights="tiny.safetensors"), network, fallback=False)
    monkeypatch.setenv("TNST_MI_WEIGHTS", "tiny.safetensors")
    with pytest.raises(InputError, match=r"\(as \$TNST_MI_WEIGHTS says\): .*; --weights patterns has"):
        require_known(Recipe(tag=("flower",)), network, fallback=False)
    require_known(Recipe(tag=("volcano",), semantic=("conv2/3x3:1",)), network, fallback=False)
