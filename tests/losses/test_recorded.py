"""The recorded evaluation gives the bits of the evaluation itself, whatever its images and weights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from networks import random_googlenet

from tnst_mi.choices import STYLE_LOSSES, STYLE_STATISTICS
from tnst_mi.losses import evaluation
from tnst_mi.losses.evaluation import BoundObjective
from tnst_mi.losses.guided import UNGUIDED
from tnst_mi.losses.pictures import GreyImage
from tnst_mi.losses.style import Style
from tnst_mi.losses.terms import Content, Match, Semantic
from tnst_mi.network.googlenet import GoogLeNet

pytestmark = pytest.mark.skipif(
    not torch.cuda.is_available(), reason="needs a GPU: only there, evaluations are recorded"
)


ONCE, OTHERS = (1.0,) * 5, (2.0, 0.3, -1.0, 5.0, 0.7)


@pytest.fixture(params=[False, True], ids=["plain", "sigma"])
def bound(request: pytest.FixtureRequest, tmp_path: Path) -> BoundObjective:
    random_googlenet(tmp_path / "random.safetensors", narrow=8)
    network = GoogLeNet.load(tmp_path / "random.safetensors").to("cuda")
    picture = GreyImage("picture", np.random.default_rng(1).random((64, 48)).astype(np.float32))
    objective = (
        Semantic("inception_3a/3x3", (2,))
        + Semantic("conv2/3x3", (1,), damping=0.1)
        + Style(picture, {"conv2/3x3": 1.0, "inception_3b/output": 0.5})
        + Content(picture, "inception_3a/3x3")
        + Match("inception_3a/3x3", np.ones((1, 1, 1), np.float32))
    )
    return objective.bind(network, 64, 48, record=True, sigma=request.param)


@pytest.mark.parametrize("distance", STYLE_LOSSES)
@pytest.mark.parametrize("statistics", STYLE_STATISTICS)
def test_each_loss_of_a_style_is_the_same_recorded(tmp_path: Path, distance: str, statistics: str) -> None:
    random_googlenet(tmp_path / "random.safetensors", narrow=8)
    network = GoogLeNet.load(tmp_path / "random.safetensors").to("cuda")
    picture = GreyImage("picture", np.random.default_rng(1).random((64, 48)).astype(np.float32))
    style = Style(picture, {"conv2/3x3": 1.0}, distance=distance, statistics=statistics)
    recorded, plain = (style.bind(network, 64, 48, record=record).drawn((0, 1)) for record in (True, False))
    for seed in (0, 1):
        (losses, gradient), (expected, expected_gradient) = (
            bound._differentiated(images(seed, 3), UNGUIDED) for bound in (recorded, plain)
        )
        (name,) = style.names
        assert losses[name].item() == expected[name].item()
        assert torch.equal(gradient, expected_gradient) and gradient.any()


def images(seed: int, count: int) -> torch.Tensor:
    return torch.rand((count, 64, 48), generator=torch.Generator().manual_seed(seed)).cuda()


def test_replaying_gives_the_bits_of_the_evaluation(bound: BoundObjective) -> None:
    for seed, count, weights in ((0, 3, ONCE), (1, 3, OTHERS), (2, 2, ONCE), (3, 3, OTHERS)):
        weighed = bound.weighed(weights).scaled({name: 0.7 for name in bound.names})
        losses, gradient = weighed._differentiated(images(seed, count), UNGUIDED)
        factors = [weight / 0.7 for weight in weights]
        expected, expected_gradient = weighed._evaluated(images(seed, count), factors, UNGUIDED)
        assert {name: loss.item() for name, loss in losses.items()} == {n: v.item() for n, v in expected.items()}
        assert torch.equal(gradient, expected_gradient) and gradient.any()
    assert len(bound._recorded) == 2


def test_results_are_not_overwritten_by_the_next(bound: BoundObjective) -> None:
    losses, gradient = bound._differentiated(images(0, 3), UNGUIDED)
    kept = [loss.item() for loss in losses.values()], gradient.clone()
    bound._differentiated(images(1, 3), UNGUIDED)
    assert [loss.item() for loss in losses.values()] == kept[0] and torch.equal(gradient, kept[1])


def test_the_memory_of_a_recording_is_given_back_with_its_objective(bound: BoundObjective) -> None:
    # The first evaluation makes libraries allocate what they keep.
    bound._differentiated(images(0, 3), UNGUIDED)
    bound._recorded.clear()
    before = torch.cuda.memory_allocated()
    bound._differentiated(images(0, 3), UNGUIDED)
    assert torch.cuda.memory_allocated() > before
    bound._recorded.clear()
    assert torch.cuda.memory_allocated() == before


def test_large_batches_are_not_recorded(bound: BoundObjective, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluation, "LARGEST_RECORDED", 2 * 64 * 48)
    for count in (2, 3):
        bound._differentiated(images(0, count), UNGUIDED)
    assert list(bound._recorded) == [(2, 64, 48)]
