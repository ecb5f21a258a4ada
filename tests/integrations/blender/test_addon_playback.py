"""Which file of a sequence is shown in a frame: what Blender 3.4 was seen to show."""

from __future__ import annotations

import blender_addon  # noqa: F401  (makes tnst_mi_blender importable)
import pytest
from tnst_mi_blender.scene.playback import Playback


@pytest.mark.parametrize(
    ("mode", "duration", "shown"),
    [
        ("CLIP", 2, [None, None, 3, 4, None, None, None, None, None]),
        ("EXTEND", 2, [3, 3, 3, 4, 4, 4, 4, 4, 4]),
        ("REPEAT", 2, [3, 4, 3, 4, 3, 4, 3, 4, 3]),
        ("REPEAT", 3, [4, 5, 3, 4, 5, 3, 4, 5, 3]),
        ("PING_PONG", 3, [5, 4, 3, 4, 5, 4, 3, 4, 5]),
    ],
)
def test_frames_from_two_before_the_first_on(mode: str, duration: int, shown: list[int | None]) -> None:
    playback = Playback(start=1, offset=2, duration=duration, mode=mode)
    assert [playback.number_at(frame) for frame in range(-1, 8)] == shown
    assert playback.shift == 2 and [playback.plays(number) for number in (2, 3, 2 + duration, 3 + duration)] == [
        False,
        True,
        True,
        False,
    ]


@pytest.mark.parametrize(
    ("mode", "steps"),
    [
        ("CLIP", [(0, False), (2, True), (3, False), (4, False)]),
        ("EXTEND", [(0, False), (2, True), (3, False), (4, False)]),
        ("REPEAT", [(1, False), (2, True), (3, False), (4, False)]),
        ("PING_PONG", [(1, False), (2, True), (3, False), (4, True), (5, False)]),
    ],
)
def test_steps_of_the_middle_file(mode: str, steps: list[tuple[int, bool]]) -> None:
    playback = Playback(start=1, offset=2, duration=3, mode=mode)
    assert playback.steps({4}) == steps
    first, last = steps[0][0], steps[-1][0]
    again = playback.period
    for frame in range(-20, 20):
        at = (frame - first) % again + first if again else min(max(frame, first), last)
        on = [value for start, value in steps if start <= at][-1]
        assert on == (playback.number_at(frame) == 4), frame


def test_steps_hold_on_both_sides_of_an_extended_sequence() -> None:
    playback = Playback(start=1, offset=2, duration=3, mode="EXTEND")
    assert playback.steps({3}) == [(0, True), (2, False), (4, False)]
    assert playback.steps({5}) == [(0, False), (3, True), (4, True)]
