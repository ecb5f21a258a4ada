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
