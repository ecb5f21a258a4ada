"""Which file of a sequence Blender shows in a frame of the scene."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass


@dataclass(frozen=True)
class Playback:
    """How a volume plays the files of a sequence; as Blender's `volume_sequence_frame` has it.

    Attributes:
        start: the scene's frame that shows the first file.
        offset: number of that file, less 1.
        duration: how many numbers are played.
        mode: what is before and after: "CLIP" (nothing), "EXTEND", "REPEAT" or "PING_PONG".
    """

    start: int
    offset: int
    duration: int
    mode: str = "CLIP"

    @property
    def shift(self) -> int:
        """Number of a file less the scene's frame, where it is played for the first time."""
        return self.offset + 1 - self.start

    @property
    def period(self) -> int | None:
        """After how many frames it is played again; None if it is played once."""
        return {"REPEAT": self.duration, "PING_PONG": max(2 * (self.duration - 1), 1)}.get(self.mode)

    def plays(self, number: int) -> bool:
        """Whether the file of a number is ever shown."""
        return self.offset < number <= self.offset + self.duration

    def number_at(self, frame: int) -> int | None:
        """The number of the file that a frame of the scene shows; None if it shows none."""
        place, last = frame - self.start, self.duration - 1
        if self.mode == "EXTEND":
            place = min(max(place, 0), last)
        if self.period is not None:
            place %= self.period
        if self.mode == "PING_PONG":
            place = min(place, 2 * last - place)
        return self.offset + 1 + place if 0 <= place <= last else None

    def steps(self, numbers: Set[int]) -> list[tuple[int, bool]]:
        """When files of some numbers are shown: frames of the scene, and whether it is so from there on.

        The first step is so before its frame, too. If it is played again, the last one is where the second period
        begins.
        """
        last = self.start + (self.duration if self.period is None else self.period)
        frames = range(self.start - (self.period is None), last + 1)
        shown = [(frame, self.number_at(frame) in numbers) for frame in frames]
        return [
            step for place, step in enumerate(shown) if place in (0, len(shown) - 1) or step[1] != shown[place - 1][1]
        ]
