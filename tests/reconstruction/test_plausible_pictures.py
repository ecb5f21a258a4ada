"""Pictures with values that no smoke has are refused, by the file and the pixel, and what is plausible is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from render_views import camera_at, places, radius_around

import tnst_mi
from tnst_mi.reconstruction.checks.plausible_pictures import require_plausible
from tnst_mi.reconstruction.photographs import Photograph
from tnst_mi.reconstruction.settings import ReconstructionSettings

FILES = [Path(f"{number}.exr") for number in range(4)]
UNKNOWN = {"gamma": "auto"}


@pytest.fixture(scope="module")
def photographs(cloud, renderer) -> list[Photograph]:
    cameras = [camera_at(place) for place in places(4, radius_around(cloud.shape))]
    images, ones = renderer.render(mi.TensorXf(cloud), cameras).numpy(), np.ones(renderer.size, np.float32)
    return [Photograph("", camera, image, ones, None, False) for camera, image in zip(cameras, images, strict=True)]


def check(photographs: list[Photograph], keys: dict) -> None:
    require_plausible(FILES, photographs, ReconstructionSettings().updated({"gamma": 0.3, **keys}))


@pytest.mark.parametrize("keys", [{}, UNKNOWN, {"background": "auto"}, {"integrator": "prbvolpath"}])
@pytest.mark.parametrize("value", [1e30, -1e30, 3000.0])
@pytest.mark.parametrize("views", [[2], [0, 1, 2, 3]])
def test_a_wild_pixel_is_named_and_can_be_masked(photographs, keys, value, views):
    wild = list(photographs)
    for number in views:
        values = wild[number].values.copy()
        values[3, 5] = value
        wild[number] = replace(wild[number], values=values)
    told = rf"^{views[0]}\.exr: the pixel in row 3, column 5 is {value:.3g}".replace("+", r"\+")
    with pytest.raises(tnst_mi.InputError, match=told + ".*mask it"):
        check(wild, keys)
    weights = np.ones_like(photographs[0].weights)
    weights[3, 5] = 0
    check([replace(one, weights=weights) for one in wild], keys)


def test_pictures_beyond_the_brightness_of_smoke_are_refused_where_that_is_known(photographs):
    bright = [replace(one, values=one.values * np.float32(1e37)) for one in photographs]
    with pytest.raises(
        tnst_mi.InputError, match=r"where no light gets through smoke it would be 3\.33; say how bright"
    ):
        check(bright, {})
    check(bright, UNKNOWN)


def test_smoke_of_few_pixels_noise_and_bright_backgrounds_are_plausible(photographs):
    first = [replace(one, values=np.pad(one.values[9:11, 9:11], 9)) for one in photographs]
    check(first, {})
    check(first, UNKNOWN)
    behind = np.full_like(photographs[0].values, 60)
    check([replace(one, values=one.values + behind, background=behind) for one in photographs], {})
    check([replace(one, values=one.values + behind) for one in photographs], {"background": "auto"})
    check([replace(one, values=0 * one.values) for one in photographs], UNKNOWN)
