"""Losses of a region: against float64 sums over positions, finite differences, and crops."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from networks import random_googlenet
from small_network import HEIGHT, TERMS, WIDTH, SmallNetwork, features, picture, views

from tnst_mi.losses.gram import mean_gram
from tnst_mi.losses.guided import Guide, Guides
from tnst_mi.losses.objective import Objective
from tnst_mi.losses.style import Style
from tnst_mi.losses.terms import ClassTag, Content, Match, Semantic
from tnst_mi.network.googlenet import GoogLeNet

#: Terms of layers that have positions.
GUIDED = {name: term for name, term in TERMS.items() if name not in ("tag", "sum")}


def shares(n: int = 3, seed: int = 2) -> torch.Tensor:
    """Random shares of pixels, none in the left third."""
    values = torch.from_numpy(np.random.default_rng(seed).random((n, HEIGHT, WIDTH)))
    values[:, :, : WIDTH // 3] = 0
    return values


def test_weights_are_averages_over_the_pixels_of_a_position() -> None:
    guide = Guide(shares())
    weights = guide.weights(HEIGHT // 2, WIDTH // 2).reshape(3, HEIGHT // 2, WIDTH // 2).numpy()
    blocks = shares().numpy().reshape(3, HEIGHT // 2, 2, WIDTH // 2, 2).mean((2, 4))
    np.testing.assert_allclose(weights, blocks / blocks.sum((1, 2), keepdims=True), rtol=1e-12)


def test_terms_are_weighted_means_over_positions() -> None:
    """Each against its formula in float64, one view by one."""
    net, images = SmallNetwork(), views()
    shallow, deep = (features(net, images, layer) for layer in ("shallow", "deep"))
    w = Guide(shares()).weights(*deep.shape[2:]).reshape(3, *deep.shape[2:]).numpy()
    fine = Guide(shares()).weights(HEIGHT, WIDTH).reshape(3, HEIGHT, WIDTH).numpy()
    own, target = picture(), np.linspace(-1, 1, 6).reshape(6, 1, 1)
    content = features(net, torch.from_numpy(own.grey)[None].double(), "deep")[0]
    gram = np.einsum("chw,dhw->cd", *2 * [features(net, torch.from_numpy(own.grey)[None].double(), "shallow")[0]])
    gram /= HEIGHT * WIDTH
    guided = np.einsum("nhw,nchw,ndhw->ncd", fine, shallow, shallow)
    expected = {
        Semantic("deep", (1, 4)): -np.einsum("nhw,nchw->n", w, deep[:, [1, 4]]) / 2,
        Match("deep", target): np.einsum("nhw,nchw->n", w, (deep - target) ** 2) / 6,
        Content(own, "deep"): np.einsum("nhw,nchw->n", w, (deep - content) ** 2) / 6,
        Style(own, {"shallow": 1.0}): ((guided - gram) ** 2).sum((1, 2)) / (gram**2).sum(),
    }
    for term, of_views in expected.items():
        found, _ = term.bind(net, HEIGHT, WIDTH).evaluate(images, Guides(Guide(shares())))
        assert found.item() == pytest.approx(of_views.sum(), rel=1e-9), term.name


@pytest.mark.parametrize("name", GUIDED)
def test_a_region_that_is_all_of_the_image_is_no_region(name: str) -> None:
    bound, images = GUIDED[name].bind(SmallNetwork(), HEIGHT, WIDTH), views()
    whole = Guide(torch.full((3, HEIGHT, WIDTH), 0.25, dtype=torch.float64))
    assert bound.evaluate(images, Guides(whole))[0].item() == pytest.approx(bound(images).item(), rel=1e-9)


@pytest.mark.parametrize("name", GUIDED)
def test_derivatives_are_those_of_finite_differences(name: str) -> None:
    bound, guide = GUIDED[name].bind(SmallNetwork(), HEIGHT, WIDTH), Guide(shares())
    images = views().requires_grad_()
    (gradient,) = torch.autograd.grad(bound.evaluate(images, Guides(guide))[0], images)
    direction, step = views(seed=9) - 0.5, 1e-5
    with torch.no_grad():
        ends = [bound.evaluate(images + sign * step * direction, Guides(guide))[0] for sign in (1, -1)]
    assert ((ends[0] - ends[1]) / (2 * step)).item() == pytest.approx((gradient * direction).sum().item(), rel=1e-5)


@pytest.mark.parametrize("name", GUIDED)
def test_a_view_that_does_not_show_the_region_counts_nothing(name: str) -> None:
    bound, unseen = GUIDED[name].bind(SmallNetwork(), HEIGHT, WIDTH), shares()
    unseen[1] = 0
    images = views().requires_grad_()
    value, _ = bound.evaluate(images, Guides(Guide(unseen)))
    (gradient,) = torch.autograd.grad(value, images)
    others, _ = bound.evaluate(images.detach()[[0, 2]], Guides(Guide(shares()[[0, 2]])))
    assert value.item() == pytest.approx(others.item(), rel=1e-12)
    assert (gradient[1] == 0).all() and gradient[0].abs().max() > 0


def test_a_gram_matrix_of_a_window_is_that_of_the_crop() -> None:
    values = torch.from_numpy(np.random.default_rng(0).random((2, 3, 6, 8)))
    window = torch.zeros(2, 6, 8, dtype=torch.float64)
    window[:, 1:4, 2:7] = 1
    torch.testing.assert_close(mean_gram(values, Guide(window)), mean_gram(values[:, :, 1:4, 2:7]))


def test_a_class_is_looked_for_in_the_region(tmp_path: Path) -> None:
    """The classifier sees the mean of the last block's features over the region."""
    net = GoogLeNet.load(random_googlenet(tmp_path / "w.safetensors", narrow=8))
    images = torch.from_numpy(np.random.default_rng(0).random((2, 40, 36))).float()
    window = torch.zeros(2, 40, 36)
    window[:, 5:30, 20:] = 1
    term: Objective = ClassTag("volcano")
    found, _ = term.bind(net, 40, 36).evaluate(images, Guides(Guide(window)))
    last = net(images[:, None].expand(-1, 3, -1, -1), layers=["inception_5b/output"])["inception_5b/output"]
    weights = Guide(window).weights(*last.shape[2:]).reshape(2, 1, *last.shape[2:])
    logits = net.classifier((last * weights).sum((2, 3)))
    assert found.item() == pytest.approx(-logits[:, net.class_index("volcano")].sum().item(), rel=1e-5)
