"""What a tab is told of what is opened, as values for JSON."""

from __future__ import annotations

from typing import Any

from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.driving import image_size
from tnst_mi.studio.places import Places
from tnst_mi.studio.source import Source, stylized_frames
from tnst_mi.studio.view.painting import SightPainter

#: Of recipes whose images are not those of the view.
_PATH_TRACED = (
    'integrator = "prbvolpath": tries and renders show the network scattered light, path traced. The view shows '
    "emission and absorption; for path-traced pictures choose a look, and lit."
)


def opened_told(
    painter: SightPainter, places: Places, recipe: Recipe, source: Source | None, work: str | None
) -> dict[str, Any]:
    """What is opened, and how large pictures are that are painted over it.

    Args:
        painter: of what is opened.
        places: by which its path is told.
        recipe: as it is set.
        source: the input that is stylized.
        work: the name of the try or render that it is; None if it is none.
    """
    results = painter.opened.results
    d, h, w = painter.opened.shape
    own = results.recipe or Recipe()
    return {
        "title": results.title,
        "path": places.relative(results.path),
        "work": work,
        "run": results.record is not None,
        "after": painter.opened.has_after,
        "names": list(results.names),
        "numbers": list(results.numbers),
        "stylized": stylized_frames(results),
        "of_several": source is not None and len(source.numbers) > 1,
        "painted_size": list(image_size(recipe, painter.opened.shape)),
        "shape": [d, h, w],
        "main_view": list(own.main_view[:2]),
        "notes": list(results.notes),
    }


def physics_told(recipe: Recipe) -> str | None:
    """In what the images of a recipe are others than those of the view; None if they are not."""
    return _PATH_TRACED if recipe.integrator == "prbvolpath" else None
