"""The pictures of a run while it goes on, so that one can look, and stop: images/ as they are after each octave.

They have the names that the results will have, and their places are taken by these in the end.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping

import numpy as np

from tnst_mi.losses.pictures import resized
from tnst_mi.optimisation.glimpse import Glimpses, SmokeColour, grey
from tnst_mi.run.folder import RunFolder
from tnst_mi.run.report import on_sheet

#: Of a sequence, seconds between two updates, at least: a fine octave of many frames takes hours, a coarse one moments.
PAUSE = 30.0


class LivePictures:
    """Keeps images/ up to date: the main views of up to 12 frames, and of a sequence the contact sheet.

    Args:
        folder: of the run.
        names: of the frames that have results, by their indices, in their order.
        size: rows and columns of the pictures of results, to which those of coarser octaves are enlarged.
        finished: names of the frames that have been written already.
        colours: those of a frame by its index, before it is stylized; None for a grey one.
        clock: seconds that pass.
    """

    def __init__(
        self,
        folder: RunFolder,
        names: Mapping[int, str],
        size: tuple[int, int],
        finished: Collection[str] = (),
        colours: Callable[[int], SmokeColour | None] = grey,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._folder, self._names, self._size, self._clock = folder, names, size, clock
        self._colours = colours
        every = list(names)
        self._chosen, self._finished = [every[place] for place in on_sheet(len(every))], set(finished)
        #: The pictures of the contact sheet so far.
        self._shown: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        if len(names) > 1:
            written = [names[index] for index in self._chosen if names[index] in self._finished]
            self._shown.update((name, (before, after)) for name, before, after in folder.main_views(written))
        self._updated = -np.inf

    def octave_done(self, glimpses: Glimpses) -> None:
        """An octave of all frames is done, and it is not the last one."""
        if not self._due:
            return
        left = [index for index in self._chosen if self._names[index] not in self._finished]
        for name, *views in glimpses.of(left, self._colours):
            before, after = (resized(view, *self._size) for view in views)
            self._folder.write_glimpse(name, before, after)
            self._shown[name] = before, after
        self._update()

    def frame_done(self, name: str, views: tuple[np.ndarray, np.ndarray] | None = None) -> None:
        """A frame is finished, and its own pictures have been written.

        Args:
            name: of the frame.
            views: its main views before and after; None to read those that were written.
        """
        self._finished.add(name)
        if name in [self._names[index] for index in self._chosen]:
            if views is None:
                ((_, *read),) = self._folder.main_views([name])
                views = read[0], read[1]
            self._shown[name] = views
            # What the sheet becomes in the end is written with the results.
            if self._due and len(self._finished) < len(self._names):
                self._update()

    @property
    def _due(self) -> bool:
        return len(self._names) == 1 or self._clock() - self._updated >= PAUSE

    def _update(self) -> None:
        if len(self._names) > 1 and self._shown:
            named = [self._names[index] for index in self._chosen]
            self._folder.write_contact_sheet([(name, *self._shown[name]) for name in named if name in self._shown])
        # Writing takes time too.
        self._updated = self._clock()
