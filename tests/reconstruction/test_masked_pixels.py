"""Pixels that a mask covers decide nothing: neither what is behind the smoke, nor how thick it is."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
from render_views import camera_at, places, radius_around

from tnst_mi.fields.grid import Octave
from tnst_mi.reconstruction.one_frame import FrameReconstruction
from tnst_mi.reconstruction.photographs import Photograph
from tnst_mi.reconstruction.settings import ReconstructionSettings


def test_neither_the_background_nor_the_thickness_is_that_of_masked_pixels(cloud, renderer):
    cameras = [camera_at(place) for place in places(4, radius_around(cloud.shape))]
    images = renderer.render(mi.TensorXf(cloud), cameras).numpy() + 0.2
    weights = np.ones(renderer.size, np.float32)
    weights[[0, -1]] = weights[:, [0, -1]] = 0
    plain = [Photograph("", camera, image, weights, None, False) for camera, image in zip(cameras, images, strict=True)]
    framed = [replace(one, values=np.where(weights > 0, one.values, np.float32(50))) for one in plain]
    levels = [Octave(cloud.shape, 1.0)]
    settings = ReconstructionSettings().updated({"gamma": 0.3, "background": "auto"})
    of_plain, of_framed = (
        FrameReconstruction(settings, levels, pictures, 1 / 0.3, None, None, 0) for pictures in (plain, framed)
    )
    assert of_framed.background == of_plain.background == pytest.approx(0.2, abs=0.02)
    # The rate of a step is in proportion to a typical extinction.
    rates = []
    for frame in (of_plain, of_framed):
        descent = frame.descent(0, None)
        descent.step()
        rates.append(descent.adam.param_groups[0]["lr"])
    assert rates[0] == rates[1]
