"""The search for weights: its order, what it refuses, and what it says when nothing is found."""

from __future__ import annotations

import hashlib
from pathlib import Path

import networks
import pytest

from tnst_mi.errors import InputError
from tnst_mi.network import weights


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Empty places to search, and published files whose hashes are those of small files written here."""
    monkeypatch.delenv("TNST_MI_WEIGHTS", raising=False)
    monkeypatch.setattr(weights, "cache_folder", lambda: tmp_path / "cache")
    monkeypatch.setattr(weights, "shared_folder", lambda: tmp_path / "shared")
    published = [
        weights.PublishedFile(known.flavour, known.name, digest(known.name), known.url) for known in weights.PUBLISHED
    ]
    monkeypatch.setattr(weights, "PUBLISHED", tuple(published))
    shipped = networks.random_googlenet(tmp_path / "shipped.safetensors", "patterns", narrow=16)
    monkeypatch.setattr("tnst_mi.network.shipped.FILE", shipped)
    # Nothing in these tests may reach the network.
    monkeypatch.setattr("urllib.request.urlopen", no_network)
    return tmp_path


def no_network(*_: object, **__: object) -> None:
    raise OSError("Network is unreachable")


def digest(name: str) -> str:
    return hashlib.sha256(name.encode()).hexdigest()


def put(folder: Path, name: str) -> Path:
    """A file that the places above take for the published one: it holds its own name."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(name.encode())
    return folder / name


BVLC, GRAPH, TORCHVISION = (
    "googlenet_bvlc.safetensors",
    "tensorflow_inception_graph.pb",
    "googlenet-1378be20.pth",
)


def test_the_published_hashes() -> None:
    known = {file.name: (file.flavour, file.sha256) for file in weights.PUBLISHED}
    assert known == {
        BVLC: ("bvlc", "8d4a38bb3ec8bb01a9a6c13bf9ee55877a8f5b23ad09f297eb9f03d96b05ea3b"),
        "bvlc_googlenet.caffemodel": ("bvlc", "6f7101e3a2183738a7125a0c5021ba82a1feb4228c5ca0924d991b6daf6f6fad"),
        GRAPH: ("inception5h", "a39b08b826c9d5a5532ff424c03a3a11a202967544e389aca4b06c2bd8aef63f"),
        "inception5h.zip": ("inception5h", "d13569f6a98159de37e92e9c8ec4dae8f674fbf475f69fe6199b514f756d4364"),
        TORCHVISION: ("torchvision", "1378be20a8e875cf1568b8a71654e704449655e34711a959a38b04fb34905cef"),
    }


def test_search_order(places: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shipped = places / "shipped.safetensors"
    assert weights.find_weights() == weights.ChosenWeights(shipped, "patterns", fallback=True)
    shared = put(places / "shared", BVLC)
    assert weights.find_weights() == weights.ChosenWeights(shared, "bvlc")
    cached = put(places / "cache", BVLC)
    assert weights.find_weights() == weights.ChosenWeights(cached, "bvlc")
    named = put(places / "named", GRAPH)
    monkeypatch.setenv("TNST_MI_WEIGHTS", str(named.parent))
    assert weights.find_weights() == weights.ChosenWeights(named, "inception5h")
    monkeypatch.setenv("TNST_MI_WEIGHTS", str(named))
    assert weights.find_weights() == weights.ChosenWeights(named, "inception5h")
    asked = put(places / "asked", TORCHVISION)
    assert weights.find_weights(asked) == weights.ChosenWeights(asked, "torchvision")
    assert weights.find_weights(str(asked.parent)) == weights.ChosenWeights(asked, "torchvision")


def test_the_preferred_flavour_and_the_one_asked_for(places: Path) -> None:
    folder = put(places / "shared", TORCHVISION).parent
    put(folder, GRAPH)
    put(places / "cache", TORCHVISION)
    assert weights.find_weights()[1] == "inception5h"
    put(folder, BVLC)
    assert weights.find_weights()[1] == "bvlc"
    assert weights.find_weights(flavour="torchvision") == weights.ChosenWeights(
        places / "cache" / TORCHVISION, "torchvision"
    )
    assert weights.find_weights(folder, "inception5h") == weights.ChosenWeights(folder / GRAPH, "inception5h")
    with pytest.raises(
        InputError, match="flavour 'vgg': unknown; expected one of bvlc, inception5h, torchvision, patterns"
    ):
        weights.find_weights(flavour="vgg")


def test_a_named_place_is_decisive(places: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put(places / "shared", BVLC)
    empty = places / "empty"
    empty.mkdir()
    for source in (empty, places / "absent"):
        with pytest.raises(InputError, match=f"weights {source}: no "):
            weights.find_weights(source)
        monkeypatch.setenv("TNST_MI_WEIGHTS", str(source))
        with pytest.raises(InputError, match=rf"\$TNST_MI_WEIGHTS {source}: no "):
            weights.find_weights()
        monkeypatch.delenv("TNST_MI_WEIGHTS")
    with pytest.raises(InputError, match="flavour bvlc, expected torchvision"):
        weights.find_weights(places / "shared" / BVLC, "torchvision")


def test_a_renamed_file_is_known_by_its_contents(places: Path) -> None:
    for flavour in ("bvlc", "inception5h", "torchvision", "patterns"):
        path = networks.random_googlenet(places / f"{flavour}.safetensors", flavour, narrow=16)
        assert weights.find_weights(path) == weights.ChosenWeights(path, flavour)


def test_the_shipped_network_by_name(places: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shipped = weights.ChosenWeights(places / "shipped.safetensors", "patterns")
    put(places / "cache", BVLC)
    assert weights.find_weights("patterns") == shipped
    assert weights.find_weights("patterns", "patterns") == shipped
    monkeypatch.setenv("TNST_MI_WEIGHTS", str(put(places / "named", GRAPH)))
    assert weights.find_weights(flavour="patterns") == shipped
    monkeypatch.setenv("TNST_MI_WEIGHTS", "patterns")
    assert weights.find_weights() == shipped
    with pytest.raises(InputError, match=r"\$TNST_MI_WEIGHTS patterns: the shipped network, expected bvlc; put one of"):
        weights.find_weights(flavour="bvlc")
    with pytest.raises(InputError, match=r"named: no patterns weights in this folder; name it with --weights patterns"):
        weights.find_weights(places / "named", "patterns")


def test_a_file_or_folder_called_patterns(places: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(places)
    shipped = weights.ChosenWeights(places / "shipped.safetensors", "patterns")
    with pytest.raises(InputError, match="weights patterns: no such file or folder"):
        weights.find_weights("./patterns")
    here = put(places / "patterns", GRAPH)
    assert weights.find_weights("patterns") == shipped
    found = weights.ChosenWeights(here.relative_to(places), "inception5h")
    assert weights.find_weights("./patterns") == weights.find_weights(Path("patterns")) == found
    for named, expected in (("patterns", shipped), ("./patterns", found)):
        monkeypatch.setenv("TNST_MI_WEIGHTS", named)
        assert weights.find_weights() == expected


def test_an_installation_without_the_shipped_network(places: Path) -> None:
    (places / "shipped.safetensors").unlink()
    for arguments in ((), ("patterns",), (None, "patterns")):
        with pytest.raises(InputError, match=r"shipped.safetensors: .* is missing; install the package again, or get"):
            weights.find_weights(*arguments)
    put(places / "cache", BVLC)
    assert weights.find_weights().flavour == "bvlc"


def test_nothing_is_downloaded_unless_it_is_asked_for(places: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("a download was tried")

    monkeypatch.setattr(weights, "download", refuse)
    assert weights.find_weights().fallback
    put(places / "cache", "inception5h.zip")
    assert weights.download_weights("inception5h") == places / "cache" / "inception5h.zip"  # it is there already
    with pytest.raises(AssertionError, match="tried"):
        weights.find_weights(flavour="bvlc")
    for flavour in ("patterns", "vgg"):
        with pytest.raises(InputError, match=f"'{flavour}': .* expected one of bvlc, inception5h, torchvision"):
            weights.download_weights(flavour)


def test_a_wrong_hash_is_an_error_and_not_a_reason_to_look_further(places: Path) -> None:
    put(places / "shared", BVLC)
    damaged = put(places / "cache", BVLC)
    damaged.write_bytes(b"other")
    for source in (None, damaged, damaged.parent):
        with pytest.raises(InputError) as error:
            weights.find_weights(source)
        found = hashlib.sha256(b"other").hexdigest()
        for part in (str(damaged), "wrong hash", found, digest(BVLC), "weights --download bvlc`"):
            assert part in str(error.value)


def test_listing_what_is_there(places: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shipped = weights.FoundWeights("patterns", places / "shipped.safetensors", None)
    assert weights.list_weights() == [shipped]
    shared, cached = put(places / "shared", BVLC), put(places / "cache", GRAPH)
    cached.write_bytes(b"other")
    mine = networks.random_googlenet(places / "mine.safetensors", narrow=16)
    monkeypatch.setenv("TNST_MI_WEIGHTS", str(mine))
    assert weights.list_weights() == [
        weights.FoundWeights("bvlc", mine, None),
        weights.FoundWeights("inception5h", cached, False),
        weights.FoundWeights("bvlc", shared, True),
        shipped,
    ]
    monkeypatch.setenv("TNST_MI_WEIGHTS", "patterns")
    assert [found.path for found in weights.list_weights()] == [shipped.path, cached, shared]
    monkeypatch.setenv("TNST_MI_WEIGHTS", str(places / "absent"))
    with pytest.raises(InputError, match="absent"):
        weights.list_weights()


def test_offline_and_the_flavour_asked_for_is_nowhere(places: Path) -> None:
    for flavour in ("bvlc", "inception5h", "torchvision"):
        with pytest.raises(InputError, match=f"{flavour} weights: no download .*Network is unreachable") as error:
            weights.find_weights(flavour=flavour)
        for known in (known for known in weights.PUBLISHED if known.flavour == flavour):
            assert all(part in str(error.value) for part in (known.name, known.sha256, known.url or ""))
        assert str(places / "cache") in str(error.value)
        assert "\n" not in str(error.value)
    assert not (places / "cache").exists()
