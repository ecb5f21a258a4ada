"""Frames that can be read, what is said of how they were, and those that cannot, all of them named at once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from tnst_mi.errors import InputError, UnforeseenError
from tnst_mi.frame import Frame
from tnst_mi.io.sequence import FrameFiles
from tnst_mi.machine.terminal import some_of

# Bounds of a message: frames that it names, and characters of a cause.
_NAMED, _LONGEST = 3, 68


class Readable(Iterable[Frame]):
    """The frames of a sequence, one after the other; those that cannot be read are passed over and named at the end.

    Args:
        frames: the sequence.
        skip_bad: whether to go on without frames that cannot be read.

    Attributes:
        kept: the places in the sequence of the frames that could be read.
    """

    def __init__(self, frames: Sequence[Frame], skip_bad: bool = False) -> None:
        self._frames, self._skip_bad = frames, skip_bad
        self.kept: list[int] = []
        self._bad: list[str] = []
        self._readings: dict[str, list[str]] = {}
        self._notes: dict[str, list[str]] = {}

    def __len__(self) -> int:
        """Number of frames of the sequence."""
        return len(self._frames)

    def __iter__(self) -> Iterator[Frame]:
        """Read the frames, once.

        Raises:
            InputError: after the last one: some cannot be read and are not to be left out, or none can be read.
        """
        for index in range(len(self._frames)):
            try:
                frame = self._frames[index]
            except UnforeseenError:
                # It may be our fault: then leaving the frame out would hide it.
                raise
            except InputError as error:
                self._bad.append(str(error))
                continue
            self.kept.append(index)
            self._note(frame)
            yield frame
        require_readable(self._bad, len(self._frames), self._skip_bad)

    def frames(self) -> Sequence[Frame]:
        """The frames that could be read, once all have been tried; if these are all, the sequence itself."""
        if len(self.kept) == len(self._frames):
            return self._frames
        if isinstance(self._frames, FrameFiles):
            return self._frames.only(self.kept)
        return [self._frames[index] for index in self.kept]

    def lines(self) -> list[str]:
        """What is to be said once all have been read: what was taken for what, assumed, mended and left out."""
        files = self._frames if isinstance(self._frames, FrameFiles) else None
        lines = [
            f"read as: {reading}" + (f" ({some_of(names)})" if len(self._readings) > 1 else "")
            for reading, names in self._readings.items()
        ]
        lines += [f"note: {note}" for note in (files.notes if files else ())]
        lines += [f"note: {text}: {some_of(names)}" for text, names in self._notes.items()]
        lines += [f"note: {note}" for note in (files.grid_notes if files and self.kept else ())]
        if self._bad:
            lines.append(f"note: left out, since they cannot be read: {_shortened(self._bad)}")
        return lines

    def _note(self, frame: Frame) -> None:
        if frame.reading:
            self._readings.setdefault(frame.reading, []).append(frame.name)
        for note in frame.notes:
            detail = f" ({note.detail})" if note.detail else ""
            self._notes.setdefault(note.text, []).append(f"{frame.name}{detail}")


def require_readable(bad: Sequence[str], total: int, skip_bad: bool) -> None:
    """Check that all frames could be read, or some if the others are to be left out.

    Args:
        bad: the messages of those that could not.
        total: number of all frames.
        skip_bad: whether to go on without them.

    Raises:
        InputError: it names them.
    """
    if not bad or (skip_bad and len(bad) < total):
        return
    if len(set(bad)) == 1:
        raise InputError(bad[0])
    remedy = "; --skip-bad leaves them out" if len(bad) < total else ""
    raise InputError(f"{len(bad)} of {total} frames cannot be read: {_shortened(bad)}{remedy}")


def _shortened(messages: Sequence[str]) -> str:
    """Some messages, each cut short and without the folder of the file that it starts with."""
    parts = [text.partition(": ") for text in messages]
    messages = [f"{Path(path).name}: {rest}" if separator else path for path, separator, rest in parts]
    shown = [text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…" for text in messages[:_NAMED]]
    return "; ".join(shown) + (f"; and {len(messages) - len(shown)} more" if len(messages) > len(shown) else "")
