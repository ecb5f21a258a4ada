"""The octaves of a recipe: the grids on which it is optimised, and the images in which the network sees them.

A network draws motifs of so many pixels, whatever they show. With `motif_size = "cells"` a pixel is a cell, as in the
paper, so that motifs shrink as a grid gets finer. A number fixes the rows of the images instead, and with them the size
of motifs relative to the frame. The octaves are then those of a grid of so many rows: where the input's grid is finer,
it is the smoke that is resampled, and where it is coarser, its cells stay and its images get finer than they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from tnst_mi.fields.grid import Octave, Shape, octaves
from tnst_mi.recipe.quality import octaves_run
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering import looks
from tnst_mi.rendering.driving import image_size

#: Size in pixels of what `motif_size` calls a motif: on 96 rows, "cells" is a motif size of a quarter.
MOTIF_PIXELS = 24.0

#: Rows from which on "auto" no longer makes a pixel of every cell.
MOST_ROWS = 96


@dataclass(frozen=True)
class Level(Octave):
    """An octave with its images.

    Attributes:
        size: rows and columns of an image.
        pixel: distance between pixels in full-resolution cells.
    """

    size: tuple[int, int]
    pixel: float


def finest_rows(recipe: Recipe, shape: Shape) -> int:
    """Rows of the grid of square pixels that stands for the finest octave's images (without the room of `fit`)."""
    rows, size = shape[1], recipe.motif_size
    # On a single row nothing can be drawn, and it has no height to measure a motif by.
    if rows == 1 or size == "cells":
        return rows
    return max(1, round(MOTIF_PIXELS / size)) if isinstance(size, float) else min(rows, MOST_ROWS)


def levels_of(recipe: Recipe, shape: Shape) -> list[Level]:
    """The octaves that a run goes through with frames (D, H, W), from coarse to fine: a draft leaves out the finest."""
    return all_levels(recipe, shape)[: octaves_run(recipe)]


def all_levels(recipe: Recipe, shape: Shape) -> list[Level]:
    """The octaves that a recipe describes for frames (D, H, W), from coarse to fine, whatever its quality."""
    rows = finest_rows(recipe, shape)
    finest = [n if n == 1 or rows == shape[1] else max(1, round(n * rows / shape[1])) for n in shape]
    levels = []
    for seen in octaves(finest, recipe.octaves, recipe.scale_factor):
        pixel = shape[1] / seen.shape[1]
        size = image_size(recipe, seen.shape, pixel)
        # Octaves of the input's own grid may have as many rows as it: one row stays one.
        finer = seen.shape[1] >= shape[1] and rows > shape[1]
        levels.append(Level(shape, 1.0, size, pixel) if finer else Level(seen.shape, pixel, size, pixel))
    return levels


def full_level(recipe: Recipe, shape: Shape) -> Level:
    """The input's own grid, and images of which a pixel is a cell: those of results."""
    return Level(shape, 1.0, image_size(recipe, shape), 1.0)


def levels_seen(recipe: Recipe, shape: Shape) -> list[Level]:
    """All grids of which images are rendered: the octaves, and last the input's own.

    Those that a draft leaves out count: what follows from them, such as the exposure, must not depend on the quality.
    """
    levels, full = all_levels(recipe, shape), full_level(recipe, shape)
    return levels if levels[-1] == full else [*levels, full]


def by_frame(recipe: Recipe, numbers: Sequence[int | float | None], shape: Shape) -> list[Recipe]:
    """The recipe of each frame of a run: without keyframes, with its own shot, and with γ per full-resolution cell.

    Args:
        recipe: of the run.
        numbers: of its frames.
        shape: (D, H, W) of their grids.

    Raises:
        InputError: there are keyframes, and a frame has no number.
    """
    recipes = [by_cell(recipe.at(number), shape) for number in numbers]
    shots = [(shot,) for shot in recipe.shots] or [()] * len(recipes)
    return [replace(of_frame, shots=shot) for of_frame, shot in zip(recipes, shots, strict=True)]


def by_cell(recipe: Recipe, shape: Shape) -> Recipe:
    """A frame's recipe with γ as a number per full-resolution cell.

    With a motif size, a recipe has it per pixel of the images, and "auto" is that of a look.
    """
    if recipe.gamma == "auto":
        return replace(recipe, gamma=looks.gamma(recipe.look, shape))
    rows = finest_rows(recipe, shape)
    return recipe if rows == shape[1] else replace(recipe, gamma=recipe.extinction * rows / shape[1])
