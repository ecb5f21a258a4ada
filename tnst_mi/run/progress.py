"""The progress bar of a run, with the time left by `tnst_mi.run.time_left`.

tqdm goes by the wall clock: set back, it would count negative times, and not draw for as long. So times are measured
here, and what is drawn when.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

from tqdm import tqdm

from tnst_mi.machine.progress_bar import progress_bar
from tnst_mi.machine.terminal import printable
from tnst_mi.optimisation.result import Progress
from tnst_mi.run.time_left import OctaveSize, TimeLeft

#: Seconds after which the bar is drawn again.
_REDRAWN = 0.1


class ProgressBar:
    """Frame, octave, iteration and loss on stderr, with the time left; appears at the first iteration."""

    def __init__(self, shown: bool, octaves: Sequence[OctaveSize], cells: int, frames: int) -> None:
        """Prepare the bar of one run; what is known of its work is that of `TimeLeft`."""
        self._shown, self._time_left = shown, TimeLeft(octaves, cells, frames)
        self._bar: tqdm | None = None
        self._first = 0
        self._begun = self._drawn = time.perf_counter()

    def advance(self, progress: Progress) -> None:
        """Show one more iteration."""
        if self._bar is None:
            # A resumed run begins where the earlier one stopped.
            self._first = progress.done - 1
            self._bar = progress_bar(total=progress.total, initial=self._first, unit="it", disable=not self._shown)
            self._begun = time.perf_counter()
        now = time.perf_counter()
        left = tqdm.format_interval(self._time_left.after(progress.octave, progress.done, progress.total))
        elapsed = tqdm.format_interval(now - self._begun)
        self._bar.bar_format = (
            f"{{desc}}: {{percentage:3.0f}}%|{{bar}}| {{n_fmt}}/{{total_fmt}} [{elapsed}<{left}{{postfix}}]"
        )
        self._bar.set_description_str(
            f"{progress.frame} octave {progress.octave + 1}/{progress.octaves}", refresh=False
        )
        self._bar.n += 1
        postfix = f"iteration {progress.iteration + 1}/{progress.iterations}, loss {progress.loss:.4g}"
        if progress.workers:
            each = (self._bar.n - self._first) / max(now - self._begun, _REDRAWN) / progress.workers
            postfix += f", {progress.workers} worker{'' if progress.workers == 1 else 's'}, {each:.2g} it/s each"
        self._bar.set_postfix_str(postfix, refresh=False)
        if now - self._drawn >= _REDRAWN or progress.done == progress.total:
            self._bar.refresh()
            self._drawn = now

    def frame_done(self) -> None:
        """Take note that the results of a frame have been written."""
        self._time_left.frame_done()

    def say(self, line: str) -> None:
        """Write a line above the bar."""
        if self._shown:
            tqdm.write(printable(line), file=sys.stderr)

    def close(self) -> None:
        """End the line."""
        if self._bar is not None:
            self._bar.close()
