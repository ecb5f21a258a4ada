"""The network: against a numpy oracle in every flavour, its layers, names and classes."""

from __future__ import annotations

from pathlib import Path

import googlenet_oracle as oracle
import networks
import numpy as np
import pytest
import safetensors.numpy
import torch
from PIL import Image

from tnst_mi.errors import InputError
from tnst_mi.network.googlenet import ALIASES, LAYERS, GoogLeNet
from tnst_mi.network.readers.network_weights import FLAVOUR_NAMES


@pytest.fixture(scope="module")
def narrow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file with an eighth of BVLC's widths and all of its layers."""
    return networks.random_googlenet(tmp_path_factory.mktemp("weights") / "narrow.safetensors", narrow=8)


@pytest.fixture(scope="module")
def net(narrow: Path) -> GoogLeNet:
    return GoogLeNet.load(narrow)


@pytest.fixture(autouse=True)
def seed() -> None:
    torch.manual_seed(0)


def image(height: int, width: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((3, height, width), dtype=np.float32)


def assert_layers_match(network: GoogLeNet, picture: np.ndarray, expected: dict[str, np.ndarray]) -> None:
    """Every layer to 1e-4 of its own largest value."""
    found = network(torch.from_numpy(picture)[None], network.layer_names)
    assert found.keys() == expected.keys()
    for layer, values in expected.items():
        assert found[layer].shape[1:] == values.shape, layer
        error = np.abs(found[layer][0].numpy() - values).max() / np.abs(values).max()
        assert error <= 1e-4, f"{layer}: relative error {error:.1e}"


def volcano(path: Path) -> np.ndarray:
    """Shorter side to 256 (bicubic), then the central 224 x 224."""
    picture = Image.open(path).convert("RGB")
    scale = 256 / min(picture.size)
    picture = picture.resize((round(picture.width * scale), round(picture.height * scale)), Image.BICUBIC)
    left, top = (picture.width - 224) // 2, (picture.height - 224) // 2
    picture = picture.crop((left, top, left + 224, top + 224))
    return np.moveaxis(np.asarray(picture, np.float32) / 255, 2, 0).copy()


def test_bvlc_recognises_the_volcano(bvlc_weights: Path, asset) -> None:
    network = GoogLeNet.load(bvlc_weights, stride1=False)
    picture = torch.from_numpy(volcano(asset("styles/erupting_volcano.jpg")))[None]
    scores = network(picture, ["logits"])["logits"].softmax(1)[0]
    assert network.class_index("volcano") == int(scores.argmax()) == 980
    assert scores[980] >= 0.99


def test_bvlc_features_match_the_oracle(bvlc_weights: Path, asset) -> None:
    picture = volcano(asset("styles/erupting_volcano.jpg"))
    expected = oracle.features(safetensors.numpy.load_file(bvlc_weights), picture, "bvlc", stride=2)
    assert_layers_match(GoogLeNet.load(bvlc_weights, stride1=False), picture, expected)


# Odd, even and mixed sizes: the padding rules differ by parity. At 20 x 12 a pooling meets a single cell.
@pytest.mark.parametrize(
    ("stride", "size"), [(2, (64, 50)), (2, (75, 93)), (1, (37, 40)), (1, (20, 12)), (2, (20, 12))]
)
@pytest.mark.parametrize("flavour", FLAVOUR_NAMES)
def test_every_flavour_matches_the_oracle(tmp_path: Path, flavour: str, stride: int, size: tuple[int, int]) -> None:
    path = networks.random_googlenet(tmp_path / "random.safetensors", flavour, seed=1, narrow=8)
    tensors = networks.random_tensors(flavour, seed=1, narrow=8)
    if flavour == "patterns":
        tensors = networks.expanded(networks.quantised(tensors))
    batch_norm = networks.torchvision_state_dict(tensors, seed=1) if flavour == "torchvision" else None
    expected = oracle.features(tensors, image(*size), flavour, stride, batch_norm=batch_norm)
    network = GoogLeNet.load(path, stride1=stride == 1)
    assert network.flavour == flavour
    assert_layers_match(network, image(*size), expected)


def test_widths_come_from_the_file(tmp_path: Path) -> None:
    network = GoogLeNet.load(networks.random_googlenet(tmp_path / "random.safetensors", "inception5h"))
    assert network.channels("mixed4a") == 508
    assert network.channels("logits") == 1008
    assert network.channels("inception_5a/5x5_reduce") == 48
    bvlc = GoogLeNet.load(networks.random_googlenet(tmp_path / "bvlc.safetensors"))
    assert (bvlc.channels("mixed4a"), bvlc.channels("logits"), bvlc.channels("conv2d2")) == (512, 1000, 192)


def test_channels_are_those_of_the_values(net: GoogLeNet) -> None:
    values = net(torch.rand(2, 3, 24, 24), net.layer_names)
    assert {layer: net.channels(layer) for layer in net.layer_names} == {k: v.shape[1] for k, v in values.items()}


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (20, 12), (7, 33)])
@pytest.mark.parametrize("flavour", FLAVOUR_NAMES)
def test_small_images_reach_the_classifier(tmp_path: Path, flavour: str, size: tuple[int, int]) -> None:
    network = GoogLeNet.load(networks.random_googlenet(tmp_path / "r.safetensors", flavour, narrow=16), stride1=False)
    logits = network(torch.rand(2, 3, *size), ["logits"])["logits"]
    assert logits.shape == (2, network.channels("logits"))
    assert bool(logits.isfinite().all())


def test_stride_one_doubles_every_layer(narrow: Path) -> None:
    images = torch.rand(1, 3, 96, 64)
    layers = [layer for layer in LAYERS if layer != "logits"]
    fine = GoogLeNet.load(narrow)(images, layers)
    coarse = GoogLeNet.load(narrow, stride1=False)(images, layers)
    for layer in layers:
        assert fine[layer].shape[2:] == tuple(2 * size for size in coarse[layer].shape[2:]), layer
    # The same convolution, evaluated at every second cell.
    first = "conv1/7x7_s2"
    torch.testing.assert_close(fine[first][:, :, ::2, ::2], coarse[first], rtol=1e-5, atol=1e-3)


def test_images_of_a_batch_do_not_mix(net: GoogLeNet) -> None:
    images = torch.rand(3, 3, 40, 32)
    together = net(images, ["inception_5b/output"])["inception_5b/output"]
    for index in range(3):
        alone = net(images[index : index + 1], ["inception_5b/output"])["inception_5b/output"]
        # torch may choose another order of summation for another number of images.
        error = (together[index] - alone[0]).abs().max() / alone.abs().max()
        assert float(error) <= 1e-5


def test_branch_layers_are_before_the_relu(net: GoogLeNet) -> None:
    branches = [f"inception_4b/{branch}" for branch in ("1x1", "3x3", "5x5", "pool_proj")]
    values = net(torch.rand(1, 3, 48, 40), [*branches, "inception_4b/output"])
    assert all(bool((values[branch] < 0).any()) for branch in branches)
    expected = torch.cat([values[branch] for branch in branches], dim=1).clamp(min=0)
    assert torch.equal(values["inception_4b/output"], expected)


def test_only_what_is_needed_is_evaluated(narrow: Path) -> None:
    network = GoogLeNet.load(narrow)
    evaluated = []
    for name, convolution in network.convolutions.items():
        convolution.register_forward_hook(lambda *_, name=name: evaluated.append(name))
    network(torch.rand(1, 3, 32, 32), ["inception_3b/pool_proj", "conv2/3x3"])
    needed = ["conv1/7x7_s2", "conv2/3x3_reduce", "conv2/3x3"]
    needed += [f"inception_3a/{branch}" for branch in ("1x1", "3x3_reduce", "3x3", "5x5_reduce", "5x5", "pool_proj")]
    assert sorted(evaluated) == sorted([*needed, "inception_3b/pool_proj"])  # each once, nothing else


def test_deeper_layers_cannot_matter(narrow: Path) -> None:
    network = GoogLeNet.load(narrow)
    images = torch.rand(1, 3, 32, 32)
    before = network(images, ["inception_4b/pool_proj"])["inception_4b/pool_proj"]
    names = list(network.convolutions)
    for name in (*names[names.index("inception_4c/1x1") :], "inception_4b/3x3"):
        network.convolutions[name].weight.fill_(torch.nan)
    after = network(images, ["inception_4b/pool_proj"])["inception_4b/pool_proj"]
    assert torch.equal(before, after)
    assert bool(network(images, ["logits"])["logits"].isnan().all())


@pytest.mark.parametrize(
    ("alias", "layer"),
    [
        ("conv2d0", "conv1/7x7_s2"),
        ("conv2d1", "conv2/3x3_reduce"),
        ("conv2d2", "conv2/3x3"),
        ("mixed3a_1x1_pre_relu", "inception_3a/1x1"),
        ("mixed3b", "inception_3b/output"),
        ("mixed4b_pool_reduce_pre_relu", "inception_4b/pool_proj"),
        ("mixed4d_3x3_bottleneck_pre_relu", "inception_4d/3x3_reduce"),
        ("mixed5b_5x5_bottleneck_pre_relu", "inception_5b/5x5_reduce"),
        ("softmax2_pre_activation", "logits"),
    ],
)
def test_tensorflow_names(net: GoogLeNet, alias: str, layer: str) -> None:
    values = net(torch.rand(1, 3, 24, 24), [alias, layer])
    assert list(values) == [alias, layer]  # the keys are the names as asked
    assert values[alias] is values[layer]
    assert net.resolve(alias) == layer
    assert net.resolve(layer) == layer


def test_every_layer_but_the_logits_has_one_tensorflow_name() -> None:
    layers = [layer for layer in ALIASES.values() if layer != "logits"]
    assert sorted(layers) == sorted(set(LAYERS) - {"logits"})
    assert not set(ALIASES) & set(LAYERS)


def test_an_unknown_layer_names_the_nearest_three(net: GoogLeNet) -> None:
    with pytest.raises(InputError, match="inception_4b/pool_prj") as error:
        net(torch.rand(1, 3, 8, 8), ["inception_4b/pool_prj"])
    assert "nearest are inception_4b/pool_proj, " in str(error.value)
    assert str(error.value).count(",") == 2
    # After the ReLU these do not exist here; they must not be taken for the values before it.
    for name in ("mixed4b_pool_reduce", "conv2d2_pre_relu", ""):
        with pytest.raises(InputError):
            net.resolve(name)


def test_channels_beyond_the_layer_name_the_range(net: GoogLeNet) -> None:
    last = net.channels("inception_4b/pool_proj") - 1
    net.check_channels("mixed4b_pool_reduce_pre_relu", [0, last])
    for channel in (-1, last + 1):
        with pytest.raises(InputError, match=f"channel {channel} .*expected 0 to {last}"):
            net.check_channels("inception_4b/pool_proj", [0, channel])


def test_class_names(net: GoogLeNet) -> None:
    assert len(net.class_names) == 1000
    assert (net.class_names[0], net.class_names[980], net.class_names[999]) == (
        "tench",
        "volcano",
        "toilet tissue",
    )
    assert net.class_index("Volcano ") == 980
    assert all(net.class_index(name) == index for index, name in enumerate(net.class_names))
    # A dog and a jacket.
    assert net.class_index("Cardigan") != net.class_index("cardigan")
    with pytest.raises(InputError, match=r"several classes: 'Cardigan' .*'cardigan'"):
        net.class_index("CARDIGAN")
    with pytest.raises(InputError, match=r"'vulcano': unknown; the nearest are 'volcano', '.*', '.*'"):
        net.class_index("vulcano")


def test_synonyms_separated_by_commas(net: GoogLeNet, narrow: Path) -> None:
    network = GoogLeNet.load(narrow)
    network.class_names = ["tench, Tinca tinca", "crane", "Crane, heron"]
    assert network.class_index("tinca TINCA") == 0
    assert network.class_index("tench, tinca tinca") == 0
    assert network.class_index("crane") == 1
    assert network.class_index("heron") == 2


def test_class_names_of_patterns(tmp_path: Path) -> None:
    network = GoogLeNet.load(networks.random_googlenet(tmp_path / "p.safetensors", "patterns", narrow=16))
    assert network.class_names == list(networks.PATTERN_CLASSES)
    assert network.class_index("Vortex") == network.class_index("spiral") == 1
    assert network.class_index("julia set") == 8
    assert network.class_index("honeycomb") == 7  # ImageNet knows it too, but so does this network
    with pytest.raises(InputError, match=r"'spirral': unknown; the nearest are 'spiral', '.*', '.*'$"):
        network.class_index("spirral")
    hint = "it is an ImageNet class: `tnst-mi weights --download inception5h` gets a network that knows those"
    with pytest.raises(InputError, match=f"'Volcano': unknown; the nearest are .* of the network patterns; {hint}"):
        network.class_index("Volcano")


def test_loading_leaves_torch_alone(narrow: Path) -> None:
    torch.manual_seed(3)
    expected = torch.rand(4)
    torch.manual_seed(3)
    network = GoogLeNet.load(narrow)
    assert torch.equal(torch.rand(4), expected)  # no random numbers drawn
    assert not network.training
    assert not any(parameter.requires_grad for parameter in network.parameters())
    assert all(parameter.dtype == torch.float32 for parameter in network.parameters())
    assert network.source == str(narrow)
    assert len(network.sha256) == 64


@pytest.mark.parametrize("flavour", FLAVOUR_NAMES)
def test_gradient_is_the_finite_difference(tmp_path: Path, flavour: str) -> None:
    network = GoogLeNet.load(networks.random_googlenet(tmp_path / "r.safetensors", flavour, narrow=8)).double()
    images = torch.rand(1, 3, 21, 18, dtype=torch.float64, requires_grad=True)

    def loss(x: torch.Tensor) -> torch.Tensor:
        return sum(value.square().mean() for value in network(x, ["conv2/3x3", "inception_4a/output"]).values())

    (gradient,) = torch.autograd.grad(loss(images), images)
    generator = torch.Generator().manual_seed(0)
    for _ in range(4):
        direction = torch.randn(images.shape, dtype=torch.float64, generator=generator)
        with torch.no_grad():
            step = 1e-7
            difference = (loss(images + step * direction) - loss(images - step * direction)) / (2 * step)
        assert float((gradient * direction).sum()) == pytest.approx(float(difference), rel=1e-3)


def test_the_same_bits_every_time(net: GoogLeNet) -> None:
    images = torch.rand(3, 3, 40, 32, requires_grad=True)

    def run() -> tuple[torch.Tensor, torch.Tensor]:
        value = net(images, ["inception_4b/output"])["inception_4b/output"]
        return value.detach(), torch.autograd.grad(value.square().mean(), images)[0]

    value, gradient = run()
    for _ in range(5):
        again = run()
        assert torch.equal(again[0], value)
        assert torch.equal(again[1], gradient)


@pytest.mark.parametrize(
    "images",
    [
        torch.rand(3, 8, 8),
        torch.rand(1, 1, 8, 8),
        torch.rand(1, 3, 0, 8),
        torch.zeros(1, 3, 8, 8, dtype=torch.uint8),
    ],
    ids=["no batch", "one channel", "empty", "integers"],
)
def test_images_of_another_shape_are_refused(net: GoogLeNet, images: torch.Tensor) -> None:
    with pytest.raises(InputError, match="expected floating point"):
        net(images, ["conv2/3x3"])
