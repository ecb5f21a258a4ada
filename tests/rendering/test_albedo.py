"""Coloured smoke in the studio: its colour multiplies the albedo that the look states."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.rendering.smoke_colour import find_colour
from tnst_mi.rendering.studio import Smoke, Studio

SIZE = (24, 32)
SHAPE = (8, 12, 10)


def density() -> np.ndarray:
    """A slab that does not fill its grid, so that only a part of it is loaded."""
    slab = np.zeros(SHAPE, np.float32)
    slab[2:6, 3:10, 2:8] = 0.3
    return slab


def studio(look: str, coloured: bool) -> Studio:
    return Studio(look, "volpath", Smoke.of([density()]), [(0.0, 0.0)], SIZE, coloured=coloured)


@pytest.mark.parametrize("share", [None, 1.0, 0.5])
def test_a_grey_colour_is_a_lower_albedo(share: float | None) -> None:
    """The same paths in smoke of the albedo 0.92 · share, which the look without a grid is given as a number."""
    plain, coloured = studio("medium", False), studio("medium", True)
    key = "smoke.interior_medium.albedo.value.value"
    white = float(np.array(plain.parameters[key]).ravel()[0])
    assert white == pytest.approx(0.92)
    plain.parameters[key] = mi.Color3f(white * (share or 1.0))
    plain.parameters.update()
    colour = None if share is None else np.full((*SHAPE, 3), share, np.float32)
    expected = plain.render(density(), (0.0, 0.0), 8)
    np.testing.assert_allclose(coloured.render(density(), (0.0, 0.0), 8, colour=colour), expected, rtol=0, atol=1e-5)


def test_smoke_has_its_colour_where_the_frame_has_it() -> None:
    """Red on the left of the picture, and blue on the right; values beyond 1 scatter no more light than there is."""
    colour = np.zeros((*SHAPE, 3), np.float32)
    colour[:, :, :5, 0] = colour[:, :, 5:, 2] = 7.0
    scene = studio("thick", True)
    image = scene.render(density(), (0.0, 0.0), 16, colour=colour)
    black = scene.render(density(), (0.0, 0.0), 16, colour=0 * colour)
    glow = (image - black)[8:24]
    left, right = glow[:, 6:12].sum((0, 1)), glow[:, 12:18].sum((0, 1))
    assert left[0] > 3 * abs(left[2]) and right[2] > 3 * abs(right[0])
    at_most = scene.render(density(), (0.0, 0.0), 16, colour=np.minimum(colour, 1))
    np.testing.assert_array_equal(image, at_most)


def test_the_colour_of_frames_is_found_by_its_name_or_chosen() -> None:
    smoke, colour = density(), np.ones((*SHAPE, 3), np.float32)
    frames = [Frame(smoke), Frame(smoke, grids={"heat": smoke, "tint": colour, "wind": colour})]
    assert find_colour(frames, None) == "tint"
    assert find_colour(frames, "wind") == "wind"
    assert find_colour(frames, "none") is None
    assert find_colour(frames[:1], None) is None
    assert find_colour([Frame(smoke, grids={"Cd": smoke})], None) is None, "a scalar grid is no colour"
    with pytest.raises(InputError, match="--colour Cd: no frame has such a grid"):
        find_colour(frames, "Cd")
    with pytest.raises(InputError, match=r"grid 'heat' has shape .* expected colours"):
        find_colour(frames, "heat")
