"""Transport between frames: the nested sum against the double sum of Eq. 8 and 9, and averages over smoke."""

from __future__ import annotations

from collections.abc import Iterator

import mitsuba as mi
import numpy as np
import pytest
from fields import blob, smooth_noise

import tnst_mi
from tnst_mi.choices import WINDOW_WEIGHTS
from tnst_mi.optimisation.temporal.alignment import averaging_gain, transported_sums
from tnst_mi.optimisation.temporal.window import reading_order, window_of, window_weights

SHAPE = (7, 9, 8)
COUNT = 7


@pytest.fixture(scope="module")
def motion() -> np.ndarray:
    """A smooth velocity for each frame, up to about two cells per frame."""
    rng = np.random.default_rng(0)
    return np.stack([2 * smooth_noise(rng, *SHAPE, 3, passes=2) for _ in range(COUNT)])


def nested(fields: np.ndarray, motion: np.ndarray, frame: int, window: int, kind: str, h: float = 1.0) -> np.ndarray:
    frames = window_of(frame, len(fields), window)

    def neighbours() -> Iterator[tuple[dict[str, mi.TensorXf], mi.TensorXf]]:
        for i in reading_order(frame, frames):
            yield {"f": mi.TensorXf(fields[i])}, mi.TensorXf(motion[i if i < frame else i - 1])

    own = {"f": mi.TensorXf(fields[frame])}
    return transported_sums(own, window_weights(window, kind), frames, frame, neighbours(), h)["f"].numpy()


def double_sum(fields: np.ndarray, motion: np.ndarray, frame: int, window: int, kind: str, h: float) -> np.ndarray:
    """Term by term: T_i^t recursively, from frame to frame (Eq. 8), then the weighted sum (Eq. 9)."""
    total = np.zeros(fields.shape[1:])
    for i in window_of(frame, len(fields), window):
        field = fields[i]
        for j in range(i, frame):
            field = tnst_mi.advect(field, motion[j], "maccormack_unlimited", h)
        for j in range(i, frame, -1):
            field = tnst_mi.advect(field, -motion[j - 1], "maccormack_unlimited", h)
        total += window_weights(window, kind)[abs(i - frame)] * field
    return total


@pytest.mark.parametrize("kind", ["uniform", "gaussian"])
@pytest.mark.parametrize(("frame", "window"), [(3, 1), (3, 5), (3, 7), (0, 5), (5, 5)])
@pytest.mark.parametrize(("channels", "h"), [((), 1.0), ((3,), 1.8)])
def test_nested_sum_is_the_double_sum(frame, window, kind, channels, h, motion: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    fields = np.stack([smooth_noise(rng, *SHAPE, *channels) for _ in range(COUNT)])
    expected = double_sum(fields, motion, frame, window, kind, h)
    np.testing.assert_allclose(nested(fields, motion, frame, window, kind, h), expected, atol=3e-6)


def test_what_moves_with_the_smoke_adds_up() -> None:
    """A blob carried by a uniform integer motion: every frame's field arrives in the same place."""
    motion = np.broadcast_to(np.float32([1, 0, -1]), (COUNT, *SHAPE, 3))
    fields = np.zeros((COUNT, *SHAPE), np.float32)
    for i in range(COUNT):
        fields[i, 6 - i, 4, i] = 1
    np.testing.assert_allclose(nested(fields, motion, 3, 7, "uniform"), fields[3], atol=1e-6)


def test_only_frames_of_the_window_count(motion: np.ndarray) -> None:
    rng = np.random.default_rng(2)
    fields = np.stack([smooth_noise(rng, *SHAPE) for _ in range(COUNT)])
    before = nested(fields, motion, 3, 5, "uniform")
    fields[[0, 6]] = np.nan
    np.testing.assert_array_equal(nested(fields, motion, 3, 5, "uniform"), before)


@pytest.mark.parametrize("window", [1, 3, 9])
def test_weights_of_a_window_sum_to_one(window: int) -> None:
    for kind in WINDOW_WEIGHTS:
        weights = window_weights(window, kind)
        assert len(weights) == window // 2 + 1
        assert weights[0] + 2 * weights[1:].sum() == pytest.approx(1)
        assert (np.diff(weights) <= 0).all()
    np.testing.assert_allclose(window_weights(window), 1 / window)


def test_windows_are_shorter_at_the_ends() -> None:
    assert [list(window_of(t, 4, 3)) for t in range(4)] == [[0, 1], [0, 1, 2], [1, 2, 3], [2, 3]]
    assert reading_order(2, range(0, 6)) == [0, 1, 5, 4, 3]


def test_gain_turns_the_sum_into_an_average_over_smoke() -> None:
    """Neighbours without smoke do not count, and equal steps stay what they are, also in a shorter window."""
    mask = blob(SHAPE, (4, 4, 3), 2)
    still = np.zeros((COUNT, *SHAPE, 3), np.float32)
    direction = 0.7
    for masks, frame in ((np.stack([mask] * COUNT), 1), (np.stack([0 * mask] * 3 + [mask] * 4), 3)):
        transported = nested(masks, still, frame, 5, "uniform")
        gain = averaging_gain(mi.TensorXf(mask), mi.TensorXf(transported), 0.2).numpy()
        steps = nested(direction * masks, still, frame, 5, "uniform")
        np.testing.assert_allclose(gain * steps, direction * mask, atol=1e-6)


def test_gain_is_bounded_by_the_frame_s_own_share() -> None:
    """The transport overshoots, and must not make the sum of the masks smaller than what the frame itself adds."""
    mask = np.float32([[[0.0, 1e-9, 0.5, 1.0]]])
    transported = np.float32([[[-0.1, -0.1, 0.0, 0.2]]])
    gain = averaging_gain(mi.TensorXf(mask), mi.TensorXf(transported), 0.2).numpy()
    np.testing.assert_allclose(gain, [[[0, 1e-3, 5, 5]]], rtol=1e-5)
