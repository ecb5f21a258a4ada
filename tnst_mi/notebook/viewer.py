"""`tnst_mi.view`: a result or frames in a small page of their own, to be looked through within a notebook.

The page is the `srcdoc` of an iframe, whose scripts and styles can neither reach the page around it nor be reached; it
forbids itself whatever is not in it.
"""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from string import Template

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.machine.terminal import printable, shortened
from tnst_mi.notebook.main_views import ShownFrame, shown_frames, shown_results
from tnst_mi.notebook.markup import embedded, shown_size
from tnst_mi.resources import DATA
from tnst_mi.run.api import Result
from tnst_mi.run.report import on_sheet

_TEMPLATE = DATA / "viewer.html"

#: Most frames of a viewer, which keeps their pictures in the notebook.
_MOST_FRAMES = 48

#: In pixels: the least width of a page, which its text needs; its margin; the height of a slider and of three lines.
_LEAST_WIDTH, _MARGIN, _SLIDER, _TEXT = 260, 8, 26, 64


@dataclass(frozen=True)
class Viewer:
    """What `tnst_mi.view` returns; a notebook shows it.

    Attributes:
        page: the whole page, in HTML that needs nothing else.
        size: width and height of its place in a notebook, in pixels.
        title: what it shows, in words.
    """

    page: str = field(repr=False)
    size: tuple[int, int]
    title: str

    def _repr_html_(self) -> str:
        """The page in a frame of its own."""
        width, height = self.size
        return (
            f'<iframe srcdoc="{html.escape(self.page)}" title="{html.escape(self.title)}" sandbox="allow-scripts" '
            f'width="{width}" height="{height}" style="border:0;max-width:100%"></iframe>'
        )


def view(shown: Result | Frame | Sequence[Frame]) -> Viewer:
    """Look through a result or frames in a notebook: a slider over the frames, and one that wipes from before to after.

    Pictures are those of the main view, at most 400 pixels wide and high; of more than 48 frames, 48 are shown, evenly
    spread. The viewer works without a network, and in a notebook converted to HTML.

    Args:
        shown: what `tnst_mi.stylize` returned, a frame, or several.

    Raises:
        InputError: it is something else, or there is no frame, or a file of the result has been damaged or removed.

    Example:
        >>> import numpy as np, tnst_mi
        >>> density = np.zeros((8, 12, 8))
        >>> density[2:6, 3:9, 2:6] = 0.5
        >>> tnst_mi.view(tnst_mi.Frame(density, name="smoke"))
        Viewer(size=(280, 476), title='smoke')
    """
    if isinstance(shown, Result):
        count = len(shown.run["frames"])
        frames = shown_results(shown, on_sheet(count, _MOST_FRAMES))
    else:
        chosen, count = _chosen(shown)
        frames = shown_frames(chosen)
    if not frames:
        raise InputError("view: no frame given, expected one or more")
    return viewer_of(frames, count)


def _chosen(shown: object) -> tuple[list[Frame], int]:
    """The frames that are shown, and out of how many; those in files are read on access.

    Raises:
        InputError: they are no frames.
    """
    given = [shown] if isinstance(shown, Frame) else shown
    if isinstance(given, Sequence):
        chosen = [given[index] for index in on_sheet(len(given), _MOST_FRAMES)]
        if all(isinstance(frame, Frame) for frame in chosen):
            return chosen, len(given)
    raise InputError(f"view: a {type(shown).__name__} given, expected a result, a tnst_mi.Frame, or several")


def viewer_of(frames: Sequence[ShownFrame], count: int) -> Viewer:
    """The viewer of some frames, one or more, out of `count`."""
    width, height = shown_size(frames[0].pictures[0].shape)
    names = [shortened(printable(frame.name)) for frame in frames]
    title = names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"
    if len(frames) < count:
        title += f", {len(frames)} of {count} frames"
    contents = [
        {"name": name, "told": frame.told, "pictures": [embedded(picture) for picture in frame.pictures]}
        for name, frame in zip(names, frames, strict=True)
    ]
    page = Template(_TEMPLATE.read_text("utf-8")).substitute(
        title=html.escape(title),
        width=width,
        height=height,
        before=contents[0]["pictures"][0],
        after=contents[0]["pictures"][-1],
        # A name may not end the element that holds it.
        frames=json.dumps(contents).replace("<", r"\u003c"),
        last=len(frames) - 1,
        one="one" if len(frames) == 1 else "",
        alone="alone" if len(frames[0].pictures) == 1 else "",
    )
    sliders = (len(frames) > 1) + (len(frames[0].pictures) > 1)
    size = max(width, _LEAST_WIDTH) + 2 * _MARGIN, height + sliders * _SLIDER + _TEXT + 2 * _MARGIN
    return Viewer(page, size, title)
