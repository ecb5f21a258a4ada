"""The light of a picture, found by least squares."""

from __future__ import annotations

import pytest
import torch

from tnst_mi.reconstruction.image_model import ImageModel


def view(brightness: float, background: float | torch.Tensor, picture: bool = False):
    opacity = torch.rand(5, 7, generator=torch.Generator().manual_seed(3))
    values = brightness * opacity + background * (1 - opacity)
    weights = torch.ones_like(opacity)
    weights[2] = 0
    values[2] = 9.0  # masked
    return opacity, values, weights, background if picture else None


@pytest.mark.parametrize("find", [(True, False), (False, True), (True, True)])
def test_what_is_not_known_is_solved_for(find):
    model = ImageModel(1.2 if not find[0] else 3.0, 0.25 if not find[1] else 0.9, *find)
    model.fit([view(1.2, 0.25)])
    assert (model.brightness, model.background) == pytest.approx((1.2, 0.25), abs=1e-6)
    opacity, values, weights, _ = view(1.2, 0.25)
    assert torch.allclose((model.pixels(opacity, None) - values)[weights > 0], torch.zeros(()), atol=1e-6)


def test_the_brightness_is_found_before_pictures_of_the_background():
    model = ImageModel(3.0, 0.4, True, True)
    model.fit([view(1.2, torch.linspace(0, 1, 7).expand(5, 7), picture=True)])
    assert (model.brightness, model.background) == pytest.approx((1.2, 0.4), abs=1e-6)


def test_no_smoke_tells_nothing_of_its_brightness():
    model = ImageModel(3.0, 0.4, True, False)
    model.fit([(torch.zeros(4, 4), torch.ones(4, 4), torch.ones(4, 4), None)])
    assert model.brightness == 3.0
