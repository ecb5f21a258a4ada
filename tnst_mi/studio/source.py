"""The input that is stylized: all of its frames, also while a try of one of them is shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.io import open_frames
from tnst_mi.io.files.frame_numbers import Number
from tnst_mi.io.sequence import FrameFiles
from tnst_mi.machine.terminal import displayable
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.inputs import FramesOnAccess, conventions_of
from tnst_mi.run.reopened import Reopened
from tnst_mi.studio.choices.masks import starts_of_following


@dataclass(frozen=True)
class Source:
    """An input.

    Attributes:
        path: its file, folder or pattern.
        numbers: of all of its frames; of what can be shown of a run whose input is gone, if that is all there is.
    """

    path: Path
    numbers: tuple[Number | None, ...]

    @classmethod
    def of(cls, results: Reopened) -> Source | None:
        """The input of what is opened: itself, or what a run has stylized; None if that was no file."""
        if results.record is None:
            return cls(results.path, results.numbers)
        path = results.record.get("input")
        if not isinstance(path, str):
            return None
        files = _all_frames(results)
        return cls(Path(path), results.numbers if files is None else tuple(files.numbers))

    def only(self, number: Number | None, recipe: Recipe) -> Number | None:
        """The number of the only frame that is to be stylized; None for all, and of an input that has but one.

        Raises:
            InputError: there is no such frame, or a mask follows the smoke to it from another one.
        """
        if number is None or len(self.numbers) < 2:
            return None
        if number not in self.numbers:
            raise InputError(f"studio: there is no frame {number} in {displayable(self.path.name)}; open it anew")
        if away := starts_of_following(recipe, self.numbers[0]) - {number}:
            raise InputError(
                f"studio: a mask follows the smoke from frame {away.pop()}, which a try of frame {number} alone "
                "does not have; show that frame, or try all frames"
            )
        return number


def among_all_frames(results: Reopened) -> Reopened:
    """A run with all frames of its input, those that it has not stylized as they are there.

    As it is, if its input cannot be read.
    """
    files = _all_frames(results)
    if files is None or results.inputs is None:
        return results
    names = tuple(displayable(file.stem) for file in files.files)
    if not set(results.names) <= set(names):
        return results
    stylized = {names.index(name): frame for frame, name in enumerate(results.names)}
    frames = _AmongOthers(results.frames, files, tuple(stylized.get(index) for index in range(len(names))))
    return replace(results, frames=frames, inputs=files, names=names, numbers=tuple(files.numbers))


def stylized_frames(results: Reopened) -> list[int]:
    """The indices of the frames that a run has stylized."""
    frames = results.frames
    places = frames.places if isinstance(frames, _AmongOthers) else range(len(frames))
    return [index for index, place in enumerate(places) if place is not None]


class _AmongOthers(FramesOnAccess):
    """Stylized frames, and those of the input where there are none."""

    def __init__(self, results: Sequence[Frame], inputs: FrameFiles, places: tuple[int | None, ...]) -> None:
        self._results, self._inputs, self.places = results, inputs, places

    def __len__(self) -> int:
        return len(self.places)

    def _part(self, chosen: slice) -> _AmongOthers:
        return _AmongOthers(self._results, self._inputs.only(range(len(self))[chosen]), self.places[chosen])

    def _frame(self, index: int) -> Frame:
        place = self.places[index]
        return self._inputs[index] if place is None else self._results[place]


def _all_frames(results: Reopened) -> FrameFiles | None:
    """All frames of the input of a run; None if they cannot be listed."""
    source = None if results.record is None else results.record.get("input")
    if not isinstance(source, str) or results.recipe is None:
        return None
    try:
        return open_frames(source, None, conventions_of(results.recipe))
    except InputError:
        return None
