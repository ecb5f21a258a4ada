"""Frames that can be read, what is said of how they were, and those that cannot, all of them named at once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from tnst_mi.errors import InputError, UnforeseenError
from tnst_mi.frame import Frame
from tnst_mi.io.files.frame_numbers import first_gap
from tnst_mi.io.sequence import FrameFiles
from tnst_mi.machine.progress_bar import progress_bar
from tnst_mi.machine.terminal import LONGEST, some_of

# Bounds of a message: frames that it names, and characters of a cause.
_NAMED, _LONGEST = 3, 68


class Readable(Iterable[Frame]):
    """The frames of a sequence, one after the other; those that cannot be read are passed over and named at the end.

    Args:
        frames: the sequence.
        skip_bad: whether to go on without frames that cannot be read.
        window: the frames that a frame is averaged over; several have to be equally far apart.

    Attributes:
        kept: the places in the sequence of the frames that could be read.
    """

    def __init__(self, frames: Sequence[Frame], skip_bad: bool = False, window: int = 1) -> None:
        self._frames, self._skip_bad, self._window = frames, skip_bad, window
        self.kept: list[int] = []
        self._numbers: list[int | float | None] = []
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
                self.reject(error)
                continue
            self.keep(index, frame)
            yield frame
        self.require()

    def keep(self, index: int, frame: Frame) -> None:
        """Note what is to be said of a frame that has been read, from a place in the sequence."""
        self.kept.append(index)
        self._numbers.append(frame.number)
        if frame.reading:
            self._readings.setdefault(frame.reading, []).append(frame.name)
        for note in frame.notes:
            detail = f" ({note.detail})" if note.detail else ""
            self._notes.setdefault(note.text, []).append(f"{frame.name}{detail}")

    def reject(self, error: InputError) -> None:
        """Note that a frame cannot be read."""
        self._bad.append(str(error))

    def require(self) -> None:
        """Check, once all frames have been tried, that they could be read, or may be left out.

        Raises:
            InputError: they could not; or the window needs those that are to be left out.
        """
        gap = first_gap(self._numbers) if self._bad and self._window > 1 else None
        if gap is None:
            require_readable(self._bad, len(self._frames), self._skip_bad)
            return
        before, after, _ = gap
        needs = f"window = {self._window} needs the frames between {before} and {after}"
        remedy = f"; {needs}: mend them, select with --frames, or add --window 1"
        if self._skip_bad:
            raise InputError(_fitting(f"left out: {_shortened(self._bad)}", LONGEST - len(remedy)) + remedy)
        require_readable(self._bad, len(self._frames), False, f"{remedy} --skip-bad")

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


def require_readable(bad: Sequence[str], total: int, skip_bad: bool, remedy: str | None = None) -> None:
    """Check that all frames could be read, or some if the others are to be left out.

    Args:
        bad: the messages of those that could not.
        total: number of all frames.
        skip_bad: whether to go on without them.
        remedy: the end of the message; None for the flag that leaves them out, if others are left.

    Raises:
        InputError: it names them, and says each reason once.
    """
    if not bad or (skip_bad and len(bad) < total):
        return
    if remedy is None:
        remedy = "" if len(bad) == total else f"; --skip-bad leaves {'it' if len(bad) == 1 else 'them'} out"
    if len(bad) == 1:
        raise InputError(_fitting(bad[0], LONGEST - len(remedy)) + remedy)
    if len(set(bad)) == 1:  # of all frames together
        raise InputError(bad[0])
    reasons, start = _by_reason(bad), f"{len(bad)} of {total} frames cannot be read"
    if len(reasons) > 1:
        raise InputError(f"{start}: {_shortened(bad)}{remedy}")
    ((reason, names),) = reasons.items()
    for named in range(_NAMED, 0, -1):
        message = f"{start} ({some_of(names, named)}): {reason}{remedy}"
        if len(message) <= LONGEST:
            raise InputError(message)
    start = f"{start} ({some_of(names, 1)}): "
    raise InputError(start + _fitting(reason, LONGEST - len(start) - len(remedy)) + remedy)


def _by_reason(messages: Sequence[str]) -> dict[str, list[str]]:
    """The names of the files at the start of messages, by what follows them."""
    reasons: dict[str, list[str]] = {}
    for text in messages:
        path, separator, rest = text.partition(": ")
        reasons.setdefault(rest if separator else text, []).append(Path(path).name if separator else "")
    return reasons


def _shortened(messages: Sequence[str]) -> str:
    """The reasons of some messages, each with the names of its files and cut short."""
    parts = []
    for reason, names in _by_reason(messages).items():
        text = f"{some_of([name for name in names if name], 1)}: {reason}" if any(names) else reason
        parts.append(text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…")
    named = sum(len(names) for names in list(_by_reason(messages).values())[:_NAMED])
    return "; ".join(parts[:_NAMED]) + (f"; and {len(messages) - named} more" if len(messages) > named else "")


def _fitting(text: str, most: int) -> str:
    """A text of at most so many characters: what is left out is before its last clause, which is the remedy."""
    if len(text) <= most:
        return text
    body, separator, remedy = text.rpartition("; ")
    room = most - len(separator) - len(remedy) - 1
    return f"{body[:room]}…{separator}{remedy}" if separator and room > 0 else f"{text[: most - 1]}…"


def watched(frames: Sequence[Frame] | Readable, doing: str, shown: bool) -> Iterable[Frame]:
    """The frames, with a progress bar on stderr while they are read; a single one needs none."""
    shown = shown and len(frames) > 1
    return progress_bar(frames, doing, unit="frame", disable=not shown, leave=False, delay=1.0)
