"""The 8-bit form of a network: rounding, what a round trip keeps, and files that break the form."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import networks
import numpy as np
import pytest
import safetensors.numpy
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from tnst_mi.errors import InputError
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.network.readers import flavour_of, read_weights
from tnst_mi.network.readers.network_weights import MalformedFile, NetworkWeights
from tnst_mi.network.readers.quantised import from_quantised, quantised, write_quantised

CLASSIFIER = "loss3/classifier"


@pytest.fixture(scope="module")
def tensors() -> networks.Tensors:
    """A narrow network in float32."""
    return networks.random_tensors("patterns", narrow=16)


def weights_of(tensors: networks.Tensors, names: tuple[str, ...] | None = networks.PATTERN_CLASSES) -> NetworkWeights:
    return NetworkWeights("patterns", {k: torch.from_numpy(v) for k, v in tensors.items()}, class_names=names)


def save(path: Path, tensors: networks.Tensors, **metadata: str) -> Path:
    safetensors.numpy.save_file(tensors, path, networks.pattern_metadata(**metadata))
    return path


# ---- writing and reading ---------------------------------------------------------------------------------


@given(
    arrays.arrays(
        np.float32,
        st.tuples(*[st.integers(1, 4)] * 3),
        elements=st.just(0.0) | st.floats(2.0**-60, 2.0**60, width=32) | st.floats(-(2.0**60), -(2.0**-60), width=32),
    )
)
def test_rounding_is_to_half_a_step_of_the_channel(weight: np.ndarray) -> None:
    integers, scale = (part.numpy() for part in quantised(torch.from_numpy(weight)))
    assert (integers.dtype, scale.dtype) == (np.int8, np.float32)
    largest = np.abs(weight.reshape(len(weight), -1)).max(1)
    np.testing.assert_allclose(scale, largest / 127, rtol=1e-6)
    steps = scale.astype(np.float64)[:, None, None]
    assert np.all(np.abs(integers * steps - weight) <= steps * (0.5 + 1e-4))
    assert np.array_equal(np.abs(integers.astype(int).reshape(len(weight), -1)).max(1), 127 * (largest > 0))


def test_a_round_trip_changes_the_weights_by_half_a_step(tmp_path: Path, tensors: networks.Tensors) -> None:
    tensors = tensors | {"conv2/3x3.weight": tensors["conv2/3x3.weight"].copy()}
    tensors["conv2/3x3.weight"][3] = 0
    path = tmp_path / "net.safetensors"
    write_quantised(path, weights_of(tensors))
    assert flavour_of(path) == "patterns"
    found = read_weights(path)
    assert (found.flavour, found.class_names) == ("patterns", networks.PATTERN_CLASSES)
    for name, values in tensors.items():
        if name.endswith(".bias"):
            np.testing.assert_array_equal(found.tensors[name].numpy(), values)
            continue
        step = np.abs(values.reshape(len(values), -1)).max(1) / 127
        error = np.abs(found.tensors[name].numpy() - values).reshape(len(values), -1).max(1)
        assert np.all(error <= 0.5001 * step), name
    assert not found.tensors["conv2/3x3.weight"][3].any()


def test_values_that_are_rounded_already_stay(tmp_path: Path, tensors: networks.Tensors) -> None:
    """The integers stay in any case; the scales too where 127 times them is a float32."""
    rounded = networks.quantised(tensors)
    write_quantised(tmp_path / "a.safetensors", weights_of(networks.expanded(rounded)))
    again = safetensors.numpy.load_file(tmp_path / "a.safetensors")
    assert again.keys() == rounded.keys()
    for name, values in rounded.items():
        assert again[name].dtype == values.dtype
        np.testing.assert_allclose(again[name], values, rtol=1e-6 if name.endswith(".scale") else 0)
    for name in rounded:
        if name.endswith(".scale"):
            rounded[name] = rounded[name].astype(np.float16).astype(np.float32)
    exact = weights_of(networks.expanded(rounded))
    write_quantised(tmp_path / "b.safetensors", exact)
    for name, values in read_weights(tmp_path / "b.safetensors").tensors.items():
        assert torch.equal(values, exact.tensors[name]), name


def test_the_file_is_a_quarter_as_large_and_its_features_are_close(tmp_path: Path) -> None:
    # Wide enough for the errors of many weights to average out, as in the real network.
    weights = weights_of(networks.random_tensors("patterns", narrow=4))
    path = tmp_path / "net.safetensors"
    write_quantised(path, weights)
    numbers = sum(tensor.numel() for tensor in weights.tensors.values())
    assert path.stat().st_size < 1.15 * numbers
    images = torch.rand(2, 3, 40, 32, generator=torch.Generator().manual_seed(0))
    layers = ["conv2/3x3", "inception_3b/output", "inception_4b/output", "logits"]
    whole, rounded = (network(images, layers) for network in (GoogLeNet(weights), GoogLeNet.load(path)))
    for layer in layers:
        assert (rounded[layer] - whole[layer]).norm() <= 0.05 * whole[layer].norm(), layer


def test_networks_that_do_not_fit_the_form_are_not_written(tmp_path: Path, tensors: networks.Tensors) -> None:
    path = tmp_path / "net.safetensors"
    for names in (None, ("net", "spiral")):
        with pytest.raises(MalformedFile, match=r"are \d names, expected a list of 10"):
            write_quantised(path, weights_of(tensors, names))
    bvlc = {name: torch.from_numpy(values) for name, values in networks.random_tensors(narrow=16).items()}
    with pytest.raises(MalformedFile, match="flavour 'bvlc', expected 'patterns'"):
        write_quantised(path, NetworkWeights("bvlc", bvlc))
    assert not path.exists()


# ---- malformed files -------------------------------------------------------------------------------------


def _as(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[networks.Tensors], networks.Tensors]:
    return lambda tensors: tensors | {name: np.array(change(tensors[name]), order="C")}


def _spoilt(value: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda values: np.concatenate([values[:-1], np.float32([value])])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            _as("conv2/3x3.weight", lambda v: v.astype(np.float32)),
            "'conv2/3x3.weight' is torch.float32, expected .*int8",
        ),
        (_as("conv2/3x3.weight", lambda v: v.view(np.uint8)), "'conv2/3x3.weight' is torch.uint8, expected torch.int8"),
        (_as("conv2/3x3.scale", lambda v: v.astype(np.float16)), "'conv2/3x3.scale' is torch.float16, expected"),
        (_as("conv2/3x3.bias", lambda v: v.astype(np.float64)), "'conv2/3x3.bias' is torch.float64, expected"),
        (_as("conv2/3x3.scale", lambda v: v[:-1]), r"'conv2/3x3.scale' has shape \(11,\), expected \(12,\)"),
        (_as("conv2/3x3.scale", lambda v: v[:, None]), r"'conv2/3x3.scale' has shape \(12, 1\), expected \(12,\)"),
        (_as("conv2/3x3.scale", lambda v: v.sum()), r"'conv2/3x3.scale' has shape \(\), expected \(12,\)"),
        (_as("conv2/3x3.weight", lambda v: v[0, 0, 0, 0]), r"'conv2/3x3.scale' has shape \(12,\), expected \(\)"),
        (_as("conv2/3x3.scale", _spoilt(np.nan)), "'conv2/3x3.scale' has values that are not finite"),
        (_as("conv2/3x3.scale", _spoilt(np.inf)), "'conv2/3x3.scale' has values that are not finite"),
        (_as("conv2/3x3.scale", _spoilt(-1e-3)), "'conv2/3x3.scale' has values .* 0 or more"),
        (_as("conv2/3x3.scale", _spoilt(3e38)), "'conv2/3x3.weight' has values that are not finite"),
        (_as("conv2/3x3.bias", _spoilt(np.nan)), "'conv2/3x3.bias' has values that are not finite"),
        (_as("conv2/3x3.weight", lambda v: v[:, :, :1]), "another network: 'conv2/3x3' has weight"),
        (_as("inception_4b/1x1.weight", lambda v: v[:, :-1]), "another network: 'inception_4b/1x1' has weight"),
        (lambda tensors: {k: v for k, v in tensors.items() if k != "conv2/3x3.scale"}, "1 missing .*'conv2/3x3.scale'"),
        (lambda tensors: tensors | {"fc.scale": np.ones(2, np.float32)}, "1 unexpected .*'fc.scale'"),
        (
            lambda tensors: {k: v[:0] for k, v in tensors.items()},
            "the classes in the metadata are 10 names, expected a list of 0 names",
        ),
        (networks.expanded, "57 missing|58 missing"),
    ],
)
def test_tensors_of_another_form(tmp_path: Path, tensors: networks.Tensors, change: Callable, message: str) -> None:
    path = save(tmp_path / "net.safetensors", change(networks.quantised(tensors)))
    assert flavour_of(path) == "patterns"
    with pytest.raises(InputError, match=message) as error:
        read_weights(path)
    assert str(error.value).startswith(f"{path}: ") and "\n" not in str(error.value)


TEN = [f"class {index}" for index in range(10)]


@pytest.mark.parametrize(
    ("classes", "message"),
    [
        ("net, spiral", "are not JSON"),
        ("", "are not JSON"),
        ("[" * 100_000, "are not JSON"),
        ("null", "are a NoneType, expected a list of 10 names"),
        (json.dumps(dict.fromkeys(TEN)), "are a dict, expected a list"),
        (json.dumps(TEN[:9]), "are 9 names, expected a list of 10"),
        (json.dumps([*TEN, "more"]), "are 11 names, expected a list of 10"),
        (json.dumps([*TEN[:9], 9]), "class 9 in the metadata is 9, expected names"),
        (json.dumps([*TEN[:9], TEN]), "class 9 in the metadata is .*, expected names"),
        (json.dumps(["", *TEN[:9]]), "class 0 in the metadata is '', expected names"),
        (json.dumps(["a, ,b", *TEN[:9]]), "class 0 in the metadata is 'a, ,b', expected names"),
        (json.dumps(["a\n", *TEN[:9]]), "class 0 in the metadata is"),
        (json.dumps(["\x1b[2J", *TEN[:9]]), "class 0 in the metadata is"),
        (json.dumps(["\ud800", *TEN[:9]]), "class 0 in the metadata is"),
    ],
)
def test_class_names_of_another_form(tmp_path: Path, tensors: networks.Tensors, classes: str, message: str) -> None:
    path = save(tmp_path / "net.safetensors", networks.quantised(tensors), classes=classes)
    with pytest.raises(InputError, match=message) as error:
        read_weights(path)
    assert str(error.value).startswith(f"{path}: ") and str(error.value).isprintable()


@given(st.text(max_size=60) | st.recursive(st.none() | st.text(), st.lists).map(json.dumps))
def test_any_text_is_the_class_names_or_malformed(classes: str) -> None:
    tensors = {name: torch.from_numpy(values) for name, values in QUANTISED.items()}
    try:
        weights = from_quantised(tensors, networks.pattern_metadata(classes=classes))
    except MalformedFile:
        return
    assert list(weights.class_names) == json.loads(classes)


QUANTISED = networks.quantised(networks.random_tensors("patterns", narrow=64))


def test_metadata_that_lack_a_key_or_lie(tmp_path: Path, tensors: networks.Tensors) -> None:
    path = tmp_path / "net.safetensors"
    for metadata, message in (
        (None, "flavour None, not 'patterns'"),
        ({"flavour": "bvlc"}, "flavour 'bvlc', not 'patterns'"),
        ({"flavour": "patterns"}, "the metadata lack the classes"),
    ):
        safetensors.numpy.save_file(networks.quantised(tensors), path, metadata)
        assert flavour_of(path) == "patterns"
        with pytest.raises(InputError, match=message):
            read_weights(path)


@pytest.mark.parametrize(
    "changes",
    [{"shape": [-12, 12, 3, 3]}, {"shape": [1 << 40, 12, 3, 3]}, {"data_offsets": [-1, 10]}, {"dtype": "F32"}],
)
def test_headers_with_impossible_sizes(tmp_path: Path, tensors: networks.Tensors, changes: dict[str, object]) -> None:
    path = save(tmp_path / "net.safetensors", networks.quantised(tensors))
    data = path.read_bytes()
    size = struct.unpack("<Q", data[:8])[0]
    header = json.loads(data[8 : 8 + size])
    header["conv2/3x3.weight"] |= changes
    lying = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(lying)) + lying + data[8 + size :])
    for read in (read_weights, flavour_of):
        with pytest.raises(InputError, match="truncated or not a safetensors file"):
            read(path)
