"""All octaves in one loss: images of the sizes of coarser octaves."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from small_network import SmallNetwork, picture

from tnst_mi.losses.guided import Guide, Guides
from tnst_mi.losses.sizes import Shrinking, by_size, coarser_sizes, layer_at
from tnst_mi.losses.style import Style

HEIGHT, WIDTH, RATIO = 60, 46, 1.8


def images(seed: int = 3) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).random((2, HEIGHT, WIDTH)))


@pytest.mark.parametrize("size", [(60, 46), (53, 35), (30, 23), (24, 24)])
def test_a_smaller_image_has_the_means_of_areas(size: tuple[int, int]) -> None:
    """Against sums over an image whose pixels are repeated, so that areas are whole numbers of them."""
    rows, columns = size
    found = Shrinking((HEIGHT, WIDTH), size, images())(images()[:, None])[:, 0].numpy()
    repeated = images().numpy().repeat(rows, axis=1).repeat(columns, axis=2)
    expected = repeated.reshape(2, rows, HEIGHT, columns, WIDTH).mean((2, 4))
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    np.testing.assert_allclose(found.mean((1, 2)), images().numpy().mean((1, 2)), rtol=1e-12)


def test_sizes_are_those_of_the_octaves_down_to_what_a_motif_needs() -> None:
    assert coarser_sizes(96, 64, RATIO, 4) == [(53, 36), (30, 20)]
    assert coarser_sizes(29, 19, RATIO, 2) == []
    assert coarser_sizes(96, 1, RATIO, 2) == [(53, 1), (30, 1)]
    assert by_size(["deep", layer_at("deep", (53, 36)), layer_at("shallow", (53, 36))]) == (
        ["deep"],
        {(53, 36): ["deep", "shallow"]},
    )


@pytest.mark.parametrize("distance", ["gram", "paper", "swd", "nnfm", "histogram"])
def test_the_loss_is_the_mean_of_those_of_the_sizes(distance: str) -> None:
    net, layers = SmallNetwork(), {"shallow": 2.0, "deep": 0.5}
    sizes = [(HEIGHT, WIDTH), *coarser_sizes(HEIGHT, WIDTH, RATIO, 2)]
    assert len(sizes) == 2
    found = Style(picture(), layers, distance, octaves=3, ratio=RATIO).bind(net, HEIGHT, WIDTH)(images())
    if distance == "swd":  # its directions at a size are not those of another
        assert found > 0
        return
    alone = [
        Style(picture(), layers, distance).bind(net, *size)(
            Shrinking((HEIGHT, WIDTH), size, images())(images()[:, None])[:, 0]
        )
        for size in sizes
    ]
    assert float(found) == pytest.approx(float(sum(alone)) / len(sizes), rel=1e-12)


@pytest.mark.parametrize("statistics", ["image", "smoke"])
@pytest.mark.parametrize("distance", ["gram", "paper"])
def test_the_derivative_is_that_of_central_differences(distance: str, statistics: str) -> None:
    bound = Style(picture(), {"shallow": 2.0, "deep": 0.5}, distance, statistics, octaves=2, ratio=RATIO).bind(
        SmallNetwork(), HEIGHT, WIDTH
    )
    guides = Guides(None, Guide(images(5).sqrt()) if statistics == "smoke" else None)
    shown = images().requires_grad_()
    bound.evaluate(shown, guides)[0].backward()
    direction = torch.from_numpy(np.random.default_rng(1).normal(size=shown.shape))
    step = 1e-6
    with torch.no_grad():
        ahead, behind = (bound.evaluate(shown + sign * step * direction, guides)[0] for sign in (1, -1))
    assert shown.grad is not None
    assert float((shown.grad * direction).sum()) == pytest.approx(float(ahead - behind) / (2 * step), rel=1e-5)


def test_a_single_octave_is_the_loss_without_them() -> None:
    """To the bit: what is not asked for costs and changes nothing."""
    net = SmallNetwork()
    plain, one = (
        Style(picture(), {"deep": 1.0}, **keys).bind(net, HEIGHT, WIDTH)(images()) for keys in ({}, {"octaves": 1})
    )
    assert plain == one
