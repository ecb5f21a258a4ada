"""What a tab is told of what is opened, as values for JSON."""

from __future__ import annotations

from typing import Any

from tnst_mi.io.files.frame_numbers import Number
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.driving import image_size
from tnst_mi.studio.places import Places
from tnst_mi.studio.shown import Shown
from tnst_mi.studio.source import stylized_frames

#: Of recipes whose images are not those of the view.
_PATH_TRACED = (
    'integrator = "prbvolpath": tries and renders show the network scattered light, path traced. The view shows '
    "emission and absorption; for path-traced pictures choose a look, and lit."
)


#: The largest whole number below which browsers know them all.
_LARGEST_EXACT = 2**53


def opened_told(shown: Shown, places: Places, recipe: Recipe, work: str | None) -> dict[str, Any]:
    """What is opened, and how large pictures are that are painted over it.

    Args:
        shown: what is opened.
        places: by which its path is told.
        recipe: as it is set.
        work: the name of the try or render that it is; None if it is none.
    """
    results, found, source = shown.results, shown.painter.opened, shown.source
    d, h, w = found.shape
    own = results.recipe or Recipe()
    return {
        "title": results.title,
        "path": places.relative(results.path),
        "work": work,
        "run": results.record is not None,
        "after": found.has_after,
        "names": list(results.names),
        "numbers": [_exact(number) for number in results.numbers],
        "stylized": stylized_frames(results),
        "of_several": source is not None and len(source.numbers) > 1,
        "painted_size": list(image_size(recipe, found.shape)),
        "shape": [d, h, w],
        "coloured": found.coloured,
        "main_view": list(own.main_view[:2]),
        "notes": list(results.notes),
    }


def _exact(number: Number | None) -> Number | str | None:
    """The number of a frame; as a text where browsers would round it, so that it is another one's."""
    return str(number) if isinstance(number, int) and abs(number) > _LARGEST_EXACT else number


def physics_told(recipe: Recipe) -> str | None:
    """In what the images of a recipe are others than those of the view; None if they are not."""
    return _PATH_TRACED if recipe.integrator == "prbvolpath" else None
