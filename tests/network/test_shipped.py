"""The network that ships with the package: when it is used, what is then said and refused, and the file itself."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from command_line import Run, refused, run, smoke, tiny_weights
from networks import PATTERN_CLASSES, random_googlenet

import tnst_mi
from tnst_mi.network import shipped, weights
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.recipe.recipe import Recipe

__all__ = ["run", "smoke", "tiny_weights"]

NOTICE = (
    "no ImageNet weights found: using the shipped network patterns; "
    "`tnst-mi weights --download inception5h` gets the paper's network"
)
SCENES = Path(__file__).parents[2] / "scenes"
SHORT = ("--octaves", "1", "--iterations", "1", "--views", "1")


@pytest.fixture
def nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine without any weights but the shipped ones, here random; their file."""
    monkeypatch.delenv("TNST_MI_WEIGHTS", raising=False)
    monkeypatch.setattr(weights, "cache_folder", lambda: tmp_path / "cache")
    monkeypatch.setattr(weights, "shared_folder", lambda: tmp_path / "shared")
    monkeypatch.setattr("urllib.request.urlopen", lambda *_, **__: pytest.fail("the network was asked"))
    monkeypatch.setattr(shipped, "FILE", random_googlenet(tmp_path / "p.safetensors", "patterns", narrow=8))
    weights.announce_fallback.cache_clear()
    return shipped.FILE


# ---- the notice ------------------------------------------------------------------------------------------


def test_a_run_without_other_weights_says_so_once(run: Run, smoke: Path, tmp_path: Path, nothing_else: Path) -> None:
    for out, told in (("a", [NOTICE]), ("b", [])):
        ran = run("stylize", smoke / "f_07.npz", "--out", tmp_path / out, "--style", "net", *SHORT)
        assert ran.code == 0, ran.errors
        assert ran.errors[1] == f"network: patterns, {nothing_else}"
        assert [line for line in ran.errors if "ImageNet" in line] == told
        assert "ImageNet" not in ran.out


def test_a_run_on_weights_that_were_named_says_nothing(
    run: Run, smoke: Path, tmp_path: Path, nothing_else: Path, tiny_weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stylize = ("stylize", smoke / "f_07.npz", "--tag", "honeycomb", *SHORT)
    for source in ("patterns", nothing_else, tiny_weights):
        ran = run(*stylize, "--out", tmp_path / Path(source).stem, "--weights", source)
        assert ran.code == 0 and NOTICE not in ran.errors
    monkeypatch.setenv("TNST_MI_WEIGHTS", "patterns")
    ran = run(*stylize, "--out", tmp_path / "by environment")
    assert ran.code == 0 and NOTICE not in ran.errors


def test_loading_without_other_weights_says_so_once(
    nothing_else: Path, capsys: pytest.CaptureFixture[str], tiny_weights: Path
) -> None:
    for source, flavour in (("patterns", None), (None, "patterns"), (tiny_weights, None), (nothing_else, None)):
        GoogLeNet.load(source, flavour)
    assert capsys.readouterr().err == ""
    for told in (f"{NOTICE}\n", ""):
        network = GoogLeNet.load()
        assert (network.flavour, network.source) == ("patterns", str(nothing_else))
        assert capsys.readouterr() == ("", told)


def test_the_demo_needs_no_other_weights(
    run: Run, tmp_path: Path, nothing_else: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    recipe = Recipe.from_toml(SCENES / "suzanne" / "recipe.toml")
    assert recipe.style and not recipe.semantic and recipe.weights is None
    short = recipe.updated({"octaves": 1, "iterations": 1, "views": 1}, "", tmp_path)
    monkeypatch.setattr(Recipe, "from_toml", lambda path: short)
    ran = run("demo")
    assert ran.code == 0, ran.errors
    assert NOTICE in ran.errors and "picture   tnst_mi-demo/images/frame_0010_comparison.png" in ran.out


def test_the_fast_demo_needs_none_either(
    run: Run, tmp_path: Path, nothing_else: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = run("demo", "--fast")
    assert ran.code == 0, ran.errors
    assert NOTICE in ran.errors and "picture   tnst_mi-demo/images/frame_0010_comparison.png" in ran.out
    assert json.loads((tmp_path / "tnst_mi-demo" / "run.json").read_text())["model"]["file"] == "flames"


# ---- what is refused -------------------------------------------------------------------------------------

REFUSAL = (
    r"semantic 'mixed4b_pool_reduce_pre_relu:1': channel numbers are those of one network; this run would take the "
    r"shipped patterns \({}\); {}, or weights = \"patterns\" if its own are meant, or a tag, such as 'net', 'spiral'$"
)


@pytest.mark.parametrize("in_recipe", [True, False])
def test_channels_chosen_for_another_network_are_refused(
    run: Run, smoke: Path, tmp_path: Path, nothing_else: Path, monkeypatch: pytest.MonkeyPatch, in_recipe: bool
) -> None:
    channels = "mixed4b_pool_reduce_pre_relu:1"
    (tmp_path / "r.toml").write_text(f'style = ["net"]\nsemantic = ["{channels}"]\n')
    goal = ("--recipe", tmp_path / "r.toml") if in_recipe else ("--style", "net", "--semantic", channels)
    stylize = ["stylize", smoke, "--out", tmp_path / "out", *goal]
    remedy = "get the paper's network with `tnst-mi weights --download inception5h`"
    refused(run, tmp_path, stylize, REFUSAL.format("no other was found", remedy))
    for named in ("patterns", str(nothing_else)):
        monkeypatch.setenv("TNST_MI_WEIGHTS", named)
        remedy = "name the network that they are of with --weights"
        refused(run, tmp_path, stylize, REFUSAL.format(r"\$TNST_MI_WEIGHTS names it", remedy))


@pytest.mark.parametrize("source", ["patterns", "file"])
def test_channels_of_the_shipped_network_itself_are_not(
    run: Run, smoke: Path, tmp_path: Path, nothing_else: Path, source: str
) -> None:
    source = nothing_else if source == "file" else source
    (tmp_path / "r.toml").write_text(f'weights = "{source}"\nsemantic = ["logits:9", "inception_4b/pool_proj:1"]\n')
    ran = run("stylize", smoke / "f_07.npz", "--recipe", tmp_path / "r.toml", "--out", tmp_path / "out", *SHORT)
    assert ran.code == 0, ran.errors


def test_channels_of_other_networks_are_not(run: Run, smoke: Path, tmp_path: Path, nothing_else: Path) -> None:
    named = random_googlenet(tmp_path / "tiny.safetensors", narrow=8)
    goal = ("--semantic", "inception_4b/pool_proj:1", "--weights", named)
    ran = run("stylize", smoke / "f_07.npz", "--out", tmp_path / "out", *goal, *SHORT)
    assert ran.code == 0, ran.errors


@pytest.mark.parametrize("source", [(), ("--weights", "patterns")])
def test_tags_of_imagenet_are_refused_with_a_hint(
    run: Run, smoke: Path, tmp_path: Path, nothing_else: Path, source: tuple[str, ...]
) -> None:
    stylize = ["stylize", smoke, "--out", tmp_path / "out", *source]
    hint = "it is an ImageNet class: `tnst-mi weights --download inception5h` gets a network that knows those$"
    refused(run, tmp_path, [*stylize, "--tag", "volcano"], rf"'volcano': unknown; .* of the network patterns; {hint}")
    refused(run, tmp_path, [*stylize, "--tag", "swirll"], r"'swirll': unknown; the nearest are 'swirl', '.*', '.*'$")


def test_tags_and_their_synonyms(nothing_else: Path) -> None:
    frame = tnst_mi.Frame(torch.rand(4, 6, 5, generator=torch.Generator().manual_seed(0)).numpy())
    short = {"octaves": 1, "iterations": 1, "views": 1}
    pair = [tnst_mi.stylize(frame, {"tag": [tag], **short}, progress=False) for tag in ("spiral", "Vortex")]
    assert pair[0].history[0][0]["terms"]["tag spiral"] == pair[1].history[0][0]["terms"]["tag Vortex"]
    assert (pair[0].densities[0] == pair[1].densities[0]).all()


# ---- tnst-mi weights -------------------------------------------------------------------------------------


def test_weights_lists_the_shipped_network_and_its_tags(run: Run, nothing_else: Path) -> None:
    ran = run("weights")
    assert (ran.code, ran.errors) == (0, [])
    line = f"found      patterns     {nothing_else} (shipped; tnst-mi weights --tags lists its class tags)"
    assert ran.out.splitlines()[0] == line
    assert "download   tnst-mi weights --download inception5h" in ran.out
    ran = run("weights", "--tags")
    assert (ran.code, ran.out.splitlines(), ran.errors) == (0, list(PATTERN_CLASSES), [])


def test_weights_downloads_the_papers_network(
    run: Run, tmp_path: Path, nothing_else: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fetched = []

    def download(url: str, target: Path, sha256: str) -> None:
        fetched.append((url.rpartition("/")[2], target, sha256))

    monkeypatch.setattr(weights, "download", download)
    archive = tmp_path / "cache" / "inception5h.zip"
    for flavour in ((), ("inception5h",)):
        ran = run("weights", "--download", *flavour)
        assert (ran.code, ran.errors) == (0, [])
        assert ran.out == f"found      inception5h  {archive} (hash verified)\n"
        assert fetched.pop() == (
            archive.name,
            archive,
            "d13569f6a98159de37e92e9c8ec4dae8f674fbf475f69fe6199b514f756d4364",
        )
    assert run("weights", "--download", "bvlc", "torchvision").code == 0
    assert [name for name, *_ in fetched] == ["bvlc_googlenet.caffemodel", "googlenet-1378be20.pth"]
    refused(run, tmp_path, ["weights", "--download", "patterns"], "'patterns': .* expected one of bvlc, inception5h, ")


# ---- the file that ships ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def real() -> Path:
    """The file itself, or a skip where it has not been trained yet."""
    if not shipped.FILE.is_file():
        pytest.skip(f"{shipped.FILE.name} is not in this checkout yet")
    return shipped.FILE


def test_the_shipped_file(real: Path) -> None:
    assert real.stat().st_size <= 7_000_000
    network = GoogLeNet.load("patterns")
    assert (network.flavour, network.source) == ("patterns", str(real))
    assert len(network.class_names) == network.channels("logits") >= 60
    assert (network.channels("conv2/3x3"), network.channels("inception_4b/output")) == (192, 512)
    for index, name in enumerate(network.class_names):
        for tag in (name, *name.split(",")):
            assert network.class_index(tag) == index
    for tag in ("spiral", "net", "flower", "fire"):
        network.class_index(tag)
    features = network(torch.rand(1, 3, 48, 40), network.layer_names)
    assert all(bool(values.isfinite().all()) and bool(values.any()) for values in features.values())


def test_the_recipe_of_tags_runs_on_the_shipped_network() -> None:
    recipe = Recipe.from_toml(SCENES / "by_name.toml")
    assert recipe.weights == "patterns" and recipe.tag and not recipe.semantic
