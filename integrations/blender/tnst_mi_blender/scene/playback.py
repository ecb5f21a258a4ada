"""Which file of a sequence Blender shows in a frame of the scene."""

from __future__ import annotations

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

    def plays(self, number: int) -> bool:
        """Whether the file of a number is ever shown."""
        return self.offset < number <= self.offset + self.duration

    def number_at(self, frame: int) -> int | None:
        """The number of the file that a frame of the scene shows; None if it shows none."""
        place, last = frame - self.start, self.duration - 1
        if self.mode == "EXTEND":
            place = min(max(place, 0), last)
        elif self.mode == "REPEAT":
            place %= self.duration
        elif self.mode == "PING_PONG":
            place %= max(2 * last, 1)
            place = min(place, 2 * last - place)
        return self.offset + 1 + place if 0 <= place <= last else None
