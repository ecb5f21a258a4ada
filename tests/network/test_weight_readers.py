"""Weights files: every format against what was written; damaged, hostile and foreign files."""

from __future__ import annotations

import json
import pickle
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import googlenet_oracle as oracle
import networks
import numpy as np
import pytest
import safetensors.numpy
import safetensors.torch
import torch
from hypothesis import given
from hypothesis import strategies as st

from tnst_mi.errors import InputError
from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.network.readers import flavour_of, read_weights
from tnst_mi.network.readers.network_weights import MalformedFile
from tnst_mi.network.readers.protobuf import Message

NORMS = (
    {"depth_radius": 2, "bias": 1.5, "alpha": 0.01, "beta": 0.75},
    {"depth_radius": 3, "bias": 1.0, "alpha": 0.02, "beta": 0.5},
)
CLASS_LIST = "imagenet_comp_graph_label_strings.txt"


@pytest.fixture(scope="module")
def tensors() -> networks.Tensors:
    return networks.random_tensors("bvlc", narrow=16)


@pytest.fixture(scope="module")
def tensors5h() -> networks.Tensors:
    return networks.random_tensors("inception5h", narrow=16)


def assert_same(found: dict[str, torch.Tensor], expected: networks.Tensors) -> None:
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        assert found[name].dtype == torch.float32
        np.testing.assert_array_equal(found[name].numpy(), values)


@pytest.mark.parametrize("as_float_list", [False, True])
def test_graphdef_with_its_own_constants(tmp_path: Path, tensors5h: networks.Tensors, as_float_list: bool) -> None:
    path = tmp_path / "graph.pb"
    path.write_bytes(networks.graphdef(tensors5h, NORMS, as_float_list))
    assert_same(read_weights(path).tensors, tensors5h)
    image = np.random.default_rng(0).random((3, 45, 32), dtype=np.float32)
    expected = oracle.features(tensors5h, image, "inception5h", 2, NORMS)
    network = GoogLeNet.load(path, stride1=False)
    found = network(torch.from_numpy(image)[None], network.layer_names)
    for layer, values in expected.items():
        assert np.abs(found[layer][0].numpy() - values).max() <= 1e-4 * np.abs(values).max(), layer


def test_absent_attributes_have_tensorflows_defaults(tmp_path: Path, tensors5h: networks.Tensors) -> None:
    path = tmp_path / "graph.pb"
    path.write_bytes(networks.graphdef(tensors5h, ({}, NORMS[1])))
    first, second = read_weights(path).response_norms
    assert (first.depth_radius, first.bias, first.alpha, first.beta) == (5, 1.0, 1.0, 0.5)
    assert (second.depth_radius, second.bias) == (3, 1.0)
    assert (second.alpha, second.beta) == pytest.approx((0.02, 0.5))


def test_graphdef_and_lucents_state_dict_are_one_network(tmp_path: Path, tensors5h: networks.Tensors) -> None:
    published = (oracle.INCEPTION5H_LRN, oracle.INCEPTION5H_LRN)
    graph, state = tmp_path / "graph.pb", tmp_path / "state.pth"
    graph.write_bytes(networks.graphdef(tensors5h, published))
    torch.save({name: torch.from_numpy(value) for name, value in networks.lucent_names(tensors5h).items()}, state)
    images = torch.rand(1, 3, 33, 40, generator=torch.Generator().manual_seed(0))
    values = [GoogLeNet.load(path)(images, ["logits"])["logits"] for path in (graph, state)]
    torch.testing.assert_close(values[0], values[1], rtol=1e-6, atol=0)


def test_shorter_tensorflow_names(tmp_path: Path, tensors5h: networks.Tensors) -> None:
    path = tmp_path / "state.safetensors"
    named = {}
    for name, value in tensors5h.items():
        layer, kind = name.rsplit(".", 1)
        named[f"{networks.tensorflow_layer(layer)}.{kind}"] = value
    safetensors.numpy.save_file(named, path)
    weights = read_weights(path)
    assert weights.flavour == "inception5h"
    assert_same(weights.tensors, tensors5h)


def test_the_zip_archive_brings_its_class_names(tmp_path: Path, tensors5h: networks.Tensors) -> None:
    path = tmp_path / "archive.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("tensorflow_inception_graph.pb", networks.graphdef(tensors5h, NORMS))
        archive.writestr(CLASS_LIST, "dummy\nkit fox\nEnglish setter\n")
    network = GoogLeNet.load(path)
    assert network.flavour == "inception5h"
    assert network.class_names == ["dummy", "kit fox", "English setter"]
    assert network.class_index("english setter") == 2


def test_inception5h_never_borrows_class_names(tmp_path: Path, tensors5h: networks.Tensors) -> None:
    path = tmp_path / "graph.pb"
    path.write_bytes(networks.graphdef(tensors5h, NORMS))
    network = GoogLeNet.load(path)
    assert network.class_names == []
    with pytest.raises(InputError, match=f"graph.pb comes without class names.*{CLASS_LIST}"):
        network.class_index("volcano")
    (tmp_path / CLASS_LIST).write_text("dummy\nvolcano\n")
    assert GoogLeNet.load(path).class_index("volcano") == 1


@pytest.mark.parametrize("legacy", [False, True])
def test_caffemodel(tmp_path: Path, tensors: networks.Tensors, legacy: bool) -> None:
    path = tmp_path / "net.caffemodel"
    path.write_bytes(networks.caffemodel(tensors, legacy))
    weights = read_weights(path)
    assert weights.flavour == "bvlc"
    assert_same(weights.tensors, tensors)


@pytest.mark.parametrize("zipped", [False, True])
def test_pth_of_both_formats(tmp_path: Path, tensors: networks.Tensors, zipped: bool) -> None:
    path = tmp_path / "state.pth"
    half = {name: torch.from_numpy(value).half() for name, value in tensors.items()}
    half["loss1/fc.weight"] = torch.ones(2, 2)  # an auxiliary classifier
    torch.save(half, path, _use_new_zipfile_serialization=zipped)
    weights = read_weights(path)
    assert weights.flavour == "bvlc"
    assert_same(
        weights.tensors,
        {name: value.astype(np.float16).astype(np.float32) for name, value in tensors.items()},
    )


@pytest.mark.parametrize("prefix", ["", "module.", "module.model.", "_orig_mod.module."])
@pytest.mark.parametrize("entries", [(), ("state_dict",), ("model",), ("checkpoint", "model_state_dict")])
def test_state_dicts_of_training_programs(
    tmp_path: Path, tensors: networks.Tensors, prefix: str, entries: tuple[str, ...]
) -> None:
    """As torch's DataParallel and torch.compile name them, beside other entries of a checkpoint."""
    contents: dict = {f"{prefix}{name}": torch.from_numpy(value) for name, value in tensors.items()}
    safetensors.torch.save_file(contents, tmp_path / "state.safetensors")
    for entry in reversed(entries):
        contents = {"epoch": 3, entry: contents, "optimizer": {"lr": 0.1}}
    torch.save(contents, tmp_path / "state.pth")
    if "checkpoint" in entries:
        with pytest.raises(InputError, match="expected a dictionary of tensors, or one in an entry state_dict"):
            read_weights(tmp_path / "state.pth")
        return
    for name in ("state.pth", "state.safetensors"):
        assert flavour_of(tmp_path / name) == "bvlc"
        assert_same(read_weights(tmp_path / name).tensors, tensors)


def test_a_state_dict_inside_itself(tmp_path: Path) -> None:
    contents: dict = {"epoch": 3}
    contents["model"] = contents
    torch.save(contents, tmp_path / "state.pth")
    with pytest.raises(InputError, match=r"state.pth: not a torch state dict"):
        read_weights(tmp_path / "state.pth")


def test_batch_normalisation_is_folded(tmp_path: Path) -> None:
    path = networks.random_googlenet(tmp_path / "random.safetensors", "torchvision", narrow=16)
    state = safetensors.numpy.load_file(path)
    folded = read_weights(path).tensors
    x = np.random.default_rng(0).normal(size=(3, 9, 9))
    convolved = oracle.convolve(x, state["conv1.conv.weight"], np.zeros(1), "caffe")
    expected = oracle.normalise(convolved, state, "conv1")
    found = oracle.convolve(x, folded["conv1/7x7_s2.weight"].numpy(), folded["conv1/7x7_s2.bias"].numpy(), "caffe")
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)


class Marker:
    """Unpickled without restriction, this writes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple:
        return Path.write_text, (self.path, "executed")


@pytest.mark.parametrize("plain_pickle", [False, True])
def test_code_in_a_pth_is_not_run(tmp_path: Path, plain_pickle: bool) -> None:
    path, written = tmp_path / "evil.pth", tmp_path / "written"
    contents = {"conv1.conv.weight": torch.zeros(2), "evil": Marker(written)}
    if plain_pickle:
        path.write_bytes(pickle.dumps(contents))
    else:
        torch.save(contents, path)
    with pytest.raises(InputError, match=r"evil.pth: .*more than tensors"):
        read_weights(path)
    assert not written.exists()


def test_a_safetensors_header_that_lies(tmp_path: Path, tensors: networks.Tensors) -> None:
    path = tmp_path / "net.safetensors"
    safetensors.numpy.save_file(tensors, path)
    data = path.read_bytes()
    size = struct.unpack("<Q", data[:8])[0]
    header = json.loads(data[8 : 8 + size])

    def rewritten(**changes: object) -> bytes:
        lying = json.dumps(header | {"conv2/3x3.bias": header["conv2/3x3.bias"] | changes}).encode()
        return struct.pack("<Q", len(lying)) + lying + data[8 + size :]

    end = 1 << 50
    lies = [
        struct.pack("<Q", 1 << 60) + data[8:],
        struct.pack("<Q", len(data)) + data[8:],
        rewritten(data_offsets=[0, end]),
        rewritten(data_offsets=[end, end + 48]),
        rewritten(shape=[end, end]),
        rewritten(dtype="F64"),
        data[:-1],
        b"",
    ]
    for lie in lies:
        path.write_bytes(lie)
        with pytest.raises(InputError, match="truncated or not a safetensors file"):
            read_weights(path)


def _files(tensors: networks.Tensors, tensors5h: networks.Tensors, folder: Path) -> dict[str, bytes]:
    """One good file of each format that is parsed here or unpickled by torch."""
    for name, zipped in (("new.pth", True), ("old.pth", False)):
        state = {name: torch.from_numpy(value) for name, value in tensors.items()}
        torch.save(state, folder / name, _use_new_zipfile_serialization=zipped)
    with zipfile.ZipFile(folder / "net.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("tensorflow_inception_graph.pb", networks.graphdef(tensors5h, NORMS))
    return {
        "net.pb": networks.graphdef(tensors5h, NORMS),
        "net.caffemodel": networks.caffemodel(tensors, legacy=True),
        **{name: (folder / name).read_bytes() for name in ("new.pth", "old.pth", "net.zip")},
    }


def test_truncated_and_corrupted_files(tmp_path: Path, tensors: networks.Tensors, tensors5h: networks.Tensors) -> None:
    random = np.random.default_rng(0)
    for name, data in _files(tensors, tensors5h, tmp_path).items():
        path = tmp_path / name
        path.write_bytes(data)
        read_weights(path)
        for size in (0, 1, 7, 100, len(data) // 3, len(data) - 1000, len(data) - 1):
            path.write_bytes(data[:size])
            with pytest.raises(InputError, match=name) as error:
                read_weights(path)
            assert "\n" not in str(error.value)
        for _ in range(30):
            damaged = bytearray(data)
            for position in random.integers(-2000, 2000, 4):  # structure at the start, a zip's directory at the end
                damaged[position] = random.integers(256)
            path.write_bytes(damaged)
            try:  # the damage may hit a weight or an unused name
                read_weights(path)
            except InputError as error:
                assert name in str(error) and "\n" not in str(error)


@given(st.binary(max_size=200))
def test_any_bytes_are_a_message_or_malformed(data: bytes) -> None:
    try:
        message = Message(memoryview(data))
    except MalformedFile:
        return
    for number in range(1, 16):
        for read in (message.text, message.integers, message.floats, message.messages):
            try:
                read(number)
            except MalformedFile:
                pass


def test_a_field_longer_than_the_file() -> None:
    with pytest.raises(MalformedFile, match="a field of 1152921504606846976 bytes where 3 are left"):
        Message(memoryview(networks.varint(1 << 3 | 2) + networks.varint(1 << 60) + b"abc"))


def test_shapes_that_lie_about_the_values(tmp_path: Path, tensors5h: networks.Tensors) -> None:
    path = tmp_path / "net.pb"
    bias = tensors5h["conv1/7x7_s2.bias"]
    good = networks.graphdef(tensors5h, NORMS)
    shape = networks.field(2, networks.field(2, networks.field(1, bias.size)))
    assert good.count(shape + networks.field(4, bias.tobytes())) == 1
    # The same number of bytes, so that all lengths around it stay true.
    lie = networks.field(2, networks.field(2, networks.field(1, 127)))
    assert len(lie) == len(shape)
    path.write_bytes(good.replace(shape + networks.field(4, bias.tobytes()), lie + networks.field(4, bias.tobytes())))
    with pytest.raises(InputError, match=rf"'conv2d0_b' states the shape \[127\] for {bias.size} values"):
        read_weights(path)


def _without(name: str) -> Callable[[networks.Tensors], networks.Tensors]:
    return lambda tensors: {key: value for key, value in tensors.items() if key != name}


def _with(name: str, values: np.ndarray) -> Callable[[networks.Tensors], networks.Tensors]:
    return lambda tensors: tensors | {name: values}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_without("inception_4b/5x5.bias"), "1 missing tensor.*'inception_4b/5x5.bias'"),
        (_with("conv3/3x3.weight", np.ones(3, np.float32)), "1 unexpected tensor.*'conv3/3x3.weight'"),
        (
            _with("conv1/7x7_s2.weight", np.ones((4, 1, 7, 7), np.float32)),
            r"weight \(4, 1, 7, 7\).*expected \(4, 3, 7, 7\)",
        ),
        (_with("inception_3a/5x5.bias", np.ones(5, np.float32)), "'inception_3a/5x5' has weight"),
        (_with("loss3/classifier.weight", np.ones((1000, 7), np.float32)), "'loss3/classifier' has weight"),
        (
            _with("conv2/3x3.bias", np.full(12, np.nan, np.float32)),
            "'conv2/3x3.bias' has values that are not finite",
        ),
        (_with("conv2/3x3.bias", np.ones(12, np.int32)), "'conv2/3x3.bias' is torch.int32"),
        (
            lambda tensors: {"fc1.weight": np.ones((2, 2), np.float32)},
            "another network: 1 tensors, such as 'fc1.weight'",
        ),
    ],
)
def test_weights_of_another_network(tmp_path: Path, tensors: networks.Tensors, change: Callable, message: str) -> None:
    path = tmp_path / "net.safetensors"
    safetensors.numpy.save_file(change(tensors), path)
    with pytest.raises(InputError, match=message) as error:
        GoogLeNet.load(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_torchvisions_kernels_are_not_bvlcs(tmp_path: Path) -> None:
    state = networks.torchvision_state_dict(networks.random_tensors("bvlc", narrow=16))
    path = tmp_path / "net.safetensors"
    safetensors.numpy.save_file(state, path)
    with pytest.raises(InputError, match=r"expected \(\d+, \d+, 3, 3\)"):
        read_weights(path)


def test_an_unknown_ending(tmp_path: Path) -> None:
    path = tmp_path / "net.onnx"
    path.touch()
    with pytest.raises(InputError, match=r"'.onnx', not in .safetensors, .caffemodel"):
        GoogLeNet.load(path)
