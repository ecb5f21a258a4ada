"""Training of the network `patterns`: what is shown, the schedule, folding, resuming, and the file that comes of it."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
import train_patterns
from motifs import FAMILIES
from train_patterns import Sheets, folded, learning_rate, logits, random_weights, trainable_network

from tnst_mi.network.googlenet import GoogLeNet
from tnst_mi.network.readers.network_weights import CONVOLUTIONS


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Four families, two pictures of each a sheet, and a folder for the checkpoint."""
    monkeypatch.setattr(train_patterns, "FAMILIES", FAMILIES[11:15])
    monkeypatch.setattr(train_patterns, "COPIES", 2)
    monkeypatch.setattr(train_patterns, "BATCH", 4)
    monkeypatch.setattr(train_patterns, "STATE", tmp_path)
    return tmp_path


def test_a_sheet_shows_every_family_and_no_two_sheets_are_alike(few: Path):
    sheets = Sheets(5, 2)
    (pictures, classes), (others, other_classes) = sheets[0], sheets[1]
    assert pictures.shape == (8, 3, 64, 64) and pictures.dtype == torch.uint8
    for found in (classes, other_classes):
        assert found.bincount().tolist() == [2, 2, 2, 2]
    assert not torch.equal(classes, other_classes)
    assert torch.cdist(pictures.float().flatten(1), others.float().flatten(1)).min() > 0.0
    again = Sheets(6, 1)[0][0]
    assert torch.equal(again, others), "a sheet depends on its number alone"


def test_the_learning_rate_rises_stays_and_falls_to_zero():
    steps = 5000
    rates = [learning_rate(step, steps) for step in range(steps)]
    assert rates[0] == pytest.approx(1 / train_patterns.WARM_UP) and max(rates) == 1.0
    plateau = [step for step, rate in enumerate(rates) if rate == 1.0]
    assert plateau[0] == train_patterns.WARM_UP - 1
    assert plateau[-1] == pytest.approx((1 - train_patterns.DECAY) * steps, abs=1)
    assert rates[-1] == pytest.approx(1 / (train_patterns.DECAY * steps))
    longer = [learning_rate(step, 2 * steps) for step in range(plateau[-1])]
    assert longer == rates[: plateau[-1]], "a longer training begins as a shorter one"


def test_folding_the_batch_normalisations_changes_nothing():
    torch.manual_seed(0)
    network = trainable_network()
    pictures = Sheets(0, 1)[0][0][:6] / 255.0
    for _ in range(3):
        logits(network, pictures, 2)  # moves the running statistics
    for layer in CONVOLUTIONS:
        norm = network.convolutions[layer][1]
        norm.weight.data.uniform_(0.5, 1.5)
        norm.bias.data.uniform_(-0.5, 0.5)
    network.eval()
    plain = GoogLeNet(folded(network))
    with torch.no_grad():
        for stride in (1, 2):
            expected, found = (logits(net, pictures, stride) for net in (network, plain))
            assert (found - expected).abs().max() <= 1e-5 * expected.abs().max()
        names = ["conv1/7x7_s2", "inception_3b/output", "inception_4d/5x5"]
        x = pictures
        for layer, expected in network(x, names).items():
            assert torch.allclose(plain(x, [layer])[layer], expected, atol=1e-5 * expected.abs().max().item())


def test_random_weights_keep_the_scale_of_the_features():
    torch.manual_seed(0)
    network = GoogLeNet(random_weights())
    x = torch.rand(2, 3, 32, 32)
    features = network(x, ["inception_3a/output", "inception_5b/output"])
    low, high = (features[name].std().item() for name in features)
    assert 0.05 < high / low < 20.0
    assert [name.split(",")[0] for name in network.class_names] == [kind.name for kind in FAMILIES]


def test_misleading_pictures_are_changed_little_and_in_grey_and_raise_the_loss(monkeypatch: pytest.MonkeyPatch):
    torch.manual_seed(1)
    network = trainable_network().eval()
    monkeypatch.setattr(train_patterns, "LARGEST_PERTURBATION", 0.004)
    pictures, classes = torch.rand(12, 3, 32, 32) * 0.6 + 0.2, torch.arange(12)
    misleading = train_patterns.misleading(network, pictures.clone(), classes, 2, torch.Generator().manual_seed(2))
    change = misleading - pictures
    assert (change - change.mean(1, keepdim=True)).abs().max() < 1e-6
    size = change.square().mean((1, 2, 3)).sqrt()
    assert size.max() <= 0.004 * (1 + 1e-4) and (size == 0.0).any() and (size > 0.001).any()

    def losses(x: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            return torch.nn.functional.cross_entropy(logits(network, x, 2), classes, reduction="none")

    changed = size > 0.001
    assert (losses(misleading) > losses(pictures))[changed].all()


def test_an_interrupted_training_ends_as_an_uninterrupted_one(few: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(train_patterns, "WARM_UP", 2)
    pictures = 3 * 8
    train_patterns.train(pictures, minutes=60.0)
    whole = torch.load(few / "checkpoint.pt", weights_only=True)
    monkeypatch.setattr(train_patterns, "STATE", few / "again")
    train_patterns.train(pictures, minutes=0.0)  # stops at the first sheet
    assert torch.load(few / "again" / "checkpoint.pt", weights_only=True)["sheets"] == 1
    train_patterns.train(pictures, minutes=60.0)
    resumed = torch.load(few / "again" / "checkpoint.pt", weights_only=True)
    assert resumed["sheets"] == whole["sheets"] == 3
    for part in ("network", "average"):
        for name, value in whole[part].items():
            assert torch.equal(resumed[part][name], value), name


def test_training_exports_what_it_measured(few: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture):
    monkeypatch.setattr(train_patterns, "SHIPPED", few / "googlenet_patterns.safetensors")
    with pytest.raises(SystemExit, match="no checkpoint"):
        train_patterns.export()
    train_patterns.train(16, minutes=60.0)
    train_patterns.export()
    assert "relative difference" in capsys.readouterr().out
    network = GoogLeNet.load(few / "googlenet_patterns.safetensors")
    assert network.class_names == [", ".join(kind.names) for kind in FAMILIES[11:15]]
    state = torch.load(few / "checkpoint.pt", weights_only=True)["average"]
    bias, mean, variance, gain = (
        state[f"module.convolutions.conv2/3x3.1.{part}"] for part in ("bias", "running_mean", "running_var", "weight")
    )
    expected = bias - mean * gain / torch.sqrt(variance + 1e-5)
    assert torch.allclose(network.convolutions["conv2/3x3"].bias, expected, atol=1e-6)
