"""Recipes: files, flags and documentation come from one set of keys; every bad value is named."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from tnst_mi.errors import InputError
from tnst_mi.recipe.paths import STYLES, shipped_styles
from tnst_mi.recipe.recipe import KINDS, Recipe, documentation

CHANGED: dict[str, Any] = {
    "style": ("spirals", "net"),
    "style_layers": {"conv2/3x3": 0.5, "inception_3b/output": 2.0},
    "style_loss": "paper",
    "style_statistics": "smoke",
    "all_octaves": True,
    "semantic": ("inception_4b/pool_proj:16", "mixed3b:1,2"),
    "tag": ("volcano",),
    "content": (),
    "content_layers": {"inception_3b/output": 0.5},
    "match": (),
    "style_weight": 3.0,
    "semantic_weight": 0.0,
    "damping": 0.25,
    "mask": "heat",
    "target": (
        {
            "style": ("flames",),
            "weight": {3: 0.0, 9: 1.0},
            "mask": {"shape": "sphere", "centre": (0.0, 1.0, 0.5), "radius": {3: 0.5, 9: 1.5}, "follow": True},
        },
        {"tag": ("volcano",), "mask": ("heat", {"height": (2.0, 0.5), "strength": 0.5, "invert": True})},
    ),
    "preset": "paper",
    "quality": "draft",
    "lam": 0.5,
    "gamma": 1e-3,
    "look": 40.0,
    "density_scale": 20.0,
    "quadrature": "exact",
    "octaves": 2,
    "scale_factor": 1.5,
    "iterations": 7,
    "views": 1,
    "camera": str(Path(__file__).resolve()),
    "azimuth": (80.0, 110.0),
    "elevation": (0.0, 0.0),
    "fit": True,
    "motif_size": 0.3,
    "loss_scaling": "none",
    "sigma": "loss",
    "eta": 0.01,
    "pyramid_levels": 0,
    "mask_strength": 2.5,
    "window": 9,
    "window_average": "plain",
    "step_order": "align_first",
    "coherence": 2.0,
    "window_weights": "gaussian",
    "steps": "auto",
    "transport": "flow",
    "stages": 12,
    "conservative": True,
    "reach": "5%",
    "keep_silhouette": 1.5,
    "strength": 0.8,
    "parameterisation": "density",
    "integrator": "prbvolpath",
    "albedo": 0.5,
    "anisotropy": -0.3,
    "light": "environment",
    "spp": 3,
    "blend": 0.25,
    "seed": 777,
    "frames": "70:89",
    "context": 2,
    "weights": "somewhere.pb",
    "variant": "llvm_ad_rgb",
    "threads": 3,
    "format": "npz",
    "carry": "flame,velocity",
    "colour": "keep",
    "colour_weight": 0.5,
    "colour_eta": 0.01,
    "colour_smoothness": 2.0,
    "keep_octaves": True,
    "fps": 12.0,
    "density": "smoke",
    "velocity": "vel",
    "obstacle": "none",
    "up": "z",
    "flip": "xz",
    "units": "length-per-time",
    "dt": 0.04,
    "scale": 0.5,
    "voxel_size": 0.1,
    "origin": (1.0, -2.0, 0.5),
    "fog": True,
    "crop": False,
    "ignore_stray": True,
    "skip_bad": True,
}


def write(folder: Path, text: str) -> Path:
    path = folder / "r.toml"
    path.write_text(text, "utf-8")
    return path


def test_the_defaults_are_the_published_ones() -> None:
    recipe = Recipe()
    assert (recipe.lam, recipe.transport, recipe.gamma, recipe.quadrature) == (0.0, "flow", 0.1, "paper")
    assert (recipe.octaves, recipe.scale_factor, recipe.iterations, recipe.views) == (3, 1.8, 20, 9)
    assert (recipe.azimuth, recipe.elevation, recipe.eta) == ((-10.0, 10.0), (-5.0, 5.0), 0.002)
    assert recipe.style_layers == {"conv2/3x3": 1, "inception_3b/output": 1, "inception_4b/output": 1}
    assert recipe.main_view == (0.0, 0.0)
    assert Recipe(azimuth=(80, 110), elevation=(0, 10)).main_view == (95.0, 5.0)


def test_every_key_is_documented_and_has_a_kind() -> None:
    derived = {"keyframes", "style_shares", "shots", "given"}
    names = [field.name for field in dataclasses.fields(Recipe) if field.name not in derived]
    assert set(CHANGED) == set(KINDS) == set(names) == set(documentation())
    assert list(KINDS) == names == list(documentation())
    for name, text in documentation().items():
        assert text.endswith("."), name
        assert KINDS[name].expected and KINDS[name].placeholder


def test_a_recipe_survives_toml(tmp_path: Path) -> None:
    for recipe in (Recipe(), Recipe.from_dict(CHANGED)):
        text = recipe.to_toml()
        assert Recipe.from_toml(write(tmp_path, text)) == recipe
        for name in KINDS:
            assert name in text
    assert tomllib.loads(text)["style"] == ["spirals", "net"]


def test_flags_say_what_toml_says() -> None:
    texts = {name: KINDS[name].show(value) for name, value in CHANGED.items() if not isinstance(value, tuple)}
    texts |= {"azimuth": "80,110", "elevation": "0,0", "origin": "1,-2,0.5"}
    texts |= {name: CHANGED[name] for name in ("style", "semantic", "tag")}
    by_flags = Recipe().updated_by_flags(texts)
    # Targets are tables, for which there is no flag.
    expected = {name: value for name, value in CHANGED.items() if name != "target"}
    assert by_flags == Recipe().updated(expected, "", Path.cwd())


@settings(max_examples=50)
@given(st.floats(allow_nan=False, allow_infinity=False), st.floats(allow_nan=False, allow_infinity=False))
def test_a_range_is_kept_or_refused(low: float, high: float) -> None:
    if -360 <= low <= high <= 360:
        assert Recipe(azimuth=(low, high)).azimuth == (low, high)
    else:
        with pytest.raises(InputError, match="azimuth"):
            Recipe(azimuth=(low, high))


def test_style_layers_as_table_list_or_flag(tmp_path: Path) -> None:
    expected = {"conv2/3x3": 1.0, "inception_3b/output": 0.5}
    table = '[style_layers]\n"conv2/3x3" = 1\n"inception_3b/output" = 0.5\n'
    entries = 'style_layers = ["conv2/3x3", "inception_3b/output=0.5"]\n'
    assert Recipe.from_toml(write(tmp_path, table)).style_layers == expected
    assert Recipe.from_toml(write(tmp_path, entries)).style_layers == expected
    assert Recipe().updated_by_flags({"style_layers": "conv2/3x3,inception_3b/output=0.5"}).style_layers == expected


def test_semantic_targets_are_split() -> None:
    recipe = Recipe(semantic=("inception_4b/pool_proj:16", "mixed3b:0,7"))
    assert recipe.semantic_channels == [("inception_4b/pool_proj", (16,)), ("mixed3b", (0, 7))]


def test_pictures_are_looked_for_beside_the_recipe_and_among_the_shipped(tmp_path: Path) -> None:
    Image.new("L", (4, 4)).save(tmp_path / "mine.png")
    recipe = Recipe.from_toml(write(tmp_path, 'style = ["mine.png", "spirals"]'))
    assert recipe.style == (str((tmp_path / "mine.png").resolve()), str(STYLES / "spirals.png"))
    assert tomllib.loads(recipe.to_toml())["style"] == [recipe.style[0], "spirals"]
    (tmp_path / "spirals").touch()  # a file wins over the shipped picture of that name
    assert Recipe.from_toml(tmp_path / "r.toml").style[1] == str((tmp_path / "spirals").resolve())


def test_the_word_patterns_is_no_file(tmp_path: Path) -> None:
    (tmp_path / "patterns").touch()
    assert Recipe.from_toml(write(tmp_path, 'weights = "patterns"')).weights == "patterns"
    file = str((tmp_path / "patterns").resolve())
    assert Recipe.from_toml(write(tmp_path, 'weights = "./patterns"')).weights == file


def test_the_shipped_styles() -> None:
    assert shipped_styles() == ["cells", "flames", "net", "spirals"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lamda = 1", "unknown key 'lamda'; did you mean 'lam'"),
        ("style-weight = 1", "unknown key 'style-weight'; did you mean 'style_weight'"),
        ("[how]\nlam = 1", "unknown key 'how'"),
        ('gamma = "0.1"', "gamma = '0.1': expected a number above 0"),
        ("gamma = 0", "gamma = 0: expected a number above 0"),
        ("gamma = nan", "gamma = nan: expected a number above 0"),
        ("gamma = true", "gamma = True: expected a number above 0"),
        ("lam = 1.5", "lam = 1.5: expected a number from 0 to 1"),
        ("scale_factor = 1", "expected a number above 1, at most 8"),
        ("octaves = 2.0", "octaves = 2.0: expected an integer from 1 to 16"),
        ("octaves = 0", "octaves = 0: expected an integer"),
        (f"seed = {2**400}", r"seed = .*: expected an integer from 0 to \d+$"),
        ("window = 4", "window = 4: expected an odd integer"),
        ('steps = "many"', "steps = 'many': expected an integer from 1 to 1000 or auto"),
        ("stages = 65", "stages = 65: expected an integer from 1 to 64 or auto"),
        ('transport = "curve"', "transport = 'curve': expected step or flow"),
        ("azimuth = [10, -10]", "expected two numbers LOW,HIGH, in this order, from -360 to 360"),
        ("azimuth = 10", "azimuth = 10: expected two numbers"),
        (
            'quadrature = "Paper"',
            "quadrature = 'Paper': expected paper, exact, .* or int.*; did you mean paper",
        ),
        (
            'style = "spirals"',
            r'style = \'spirals\': expected a list of picture files, such as \["fire.png"\]',
        ),
        ('style = ["nowhere.png"]', "no such picture .*nowhere.png.*; those shipped are cells, flames"),
        ('semantic = ["conv2/3x3"]', "semantic = .*: expected a list of layers with channels"),
        ('semantic = ["conv2/3x3:-1"]', "expected a list of layers with channels"),
        ("style_layers = {}", "expected layers with weights"),
        ('style_layers = ["conv2/3x3=-1"]', "expected layers with weights"),
        ('style_layers = ["conv2/3x3=one"]', "expected layers with weights"),
        ('frames = "9:7"', "expected the smaller number first"),
        ('frames = "7:"', "expected a range of frame numbers"),
        ('format = "abc"', "format = 'abc': expected npz, vol, uni or vdb"),
        ("gamma = ", "not valid TOML"),
        ("a = " + "[" * 5000, "r.toml: more than 8 brackets inside of one another"),
    ],
)
def test_a_bad_recipe_is_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        Recipe.from_toml(write(tmp_path, text))
    assert "\n" not in str(error.value)
    assert "r.toml" in str(error.value) or text.startswith("frames")


def test_unreadable_recipe_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.toml: no such file"):
        Recipe.from_toml(tmp_path / "none.toml")
    with pytest.raises(InputError, match="cannot be read"):
        Recipe.from_toml(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="UTF-16 text or no text, expected UTF-8"):
        Recipe.from_toml(tmp_path / "binary.toml")
    (tmp_path / "huge.toml").write_bytes(b"#" * (1 << 21))
    with pytest.raises(InputError, match="at most 512 KiB"):
        Recipe.from_toml(tmp_path / "huge.toml")


@pytest.mark.parametrize("scene", ["suzanne", "smokejet"])
def test_the_bundled_recipes_are_valid(scene: str) -> None:
    recipe = Recipe.from_toml(Path(__file__).parents[2] / "scenes" / scene / "recipe.toml")
    assert recipe.style and recipe.octaves == 2


def test_names_of_grids_are_a_text_or_a_list() -> None:
    for value in ("flame,velocity", " flame , velocity", ["flame", "velocity"]):
        assert Recipe(carry=value).carry == "flame,velocity"
    for value in ("", "flame,", [], ["flame", 3], None, ["a,b"]):
        with pytest.raises(InputError, match=r'carry = .*: expected "all", "none", or names of grids'):
            Recipe(carry=value)
