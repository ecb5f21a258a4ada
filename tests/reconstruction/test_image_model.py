"""The light of a picture: a background by least squares, and which way the brightness has to go."""

from __future__ import annotations

import pytest
import torch

from tnst_mi.reconstruction.fitting.brightness_search import BrightnessSearch
from tnst_mi.reconstruction.fitting.image_model import ImageModel

OPACITY = torch.rand(5, 7, generator=torch.Generator().manual_seed(3), dtype=torch.float64)


def view(brightness: float, background: float | torch.Tensor, picture: bool = False):
    values = brightness * OPACITY + background * (1 - OPACITY)
    weights = torch.ones_like(OPACITY)
    weights[2] = 0
    values[2] = 9.0  # masked
    return OPACITY, values, weights, background if picture else None


def test_the_background_is_solved_for():
    model = ImageModel(1.2, 0.9, find_background=True)
    across = torch.linspace(0, 1, 7, dtype=torch.float64).expand(5, 7)
    model.fit_background([view(1.2, 0.25), view(1.2, across, picture=True)])
    assert model.background == pytest.approx(0.25, abs=1e-9)
    opacity, values, weights, _ = view(1.2, 0.25)
    assert torch.allclose((model.pixels(opacity, None) - values)[weights > 0], torch.zeros((), dtype=torch.float64))


def test_where_all_backgrounds_are_pictures_there_is_none_to_find():
    model = ImageModel(1.2, 0.9, find_background=True)
    model.fit_background([view(1.2, torch.zeros(5, 7, dtype=torch.float64), picture=True)])
    assert model.background == 0.9


@pytest.mark.parametrize("background", [None, torch.linspace(0, 1, 7, dtype=torch.float64).expand(5, 7)])
def test_the_slope_is_that_for_given_emission(background):
    """By central differences: optical depths, and no emission, change with 1 / brightness."""
    _, values, weights, _ = view(1.2, 0.25)

    def at(inverse: float) -> tuple[ImageModel, torch.Tensor]:
        return ImageModel(1 / inverse, 0.1), 1 - (1 - OPACITY) ** (inverse / 0.5)

    def misfit(inverse: float) -> float:
        model, opacity = at(inverse)
        return float((weights * (model.pixels(opacity, background) - values) ** 2).mean())

    model, opacity = at(0.5)
    numeric = (misfit(0.5 + 1e-4) - misfit(0.5 - 1e-4)) / 2e-4
    assert model.slope([(opacity, values, weights, background)]) == pytest.approx(numeric, rel=1e-5)


@pytest.mark.parametrize("start", [0.2, 0.6, 1.4, 3.0])
def test_the_search_finds_a_root_that_is_steep_on_one_side(start):
    search, inverse = BrightnessSearch(), start
    for _ in range(12):
        inverse = search.next(inverse, (inverse - 1) * (30 if inverse > 1 else 1))
    assert inverse == pytest.approx(1, abs=1e-3)
