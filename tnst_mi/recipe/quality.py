"""How far a run goes on the way that its recipe describes: to a draft, a preview, or the end.

A recipe describes the final stylization. What comes early on its way, the coarse octaves and the first iterations of
the finest, decides where motifs are and costs little; so a draft ends before the finest octave, and a preview after
three fifths of it. Both are states that the final passes through, and it can go on from them (docs/preview.md).
"""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

from tnst_mi.choices import QUALITIES
from tnst_mi.recipe.recipe import Recipe

DRAFT, PREVIEW, FINAL = QUALITIES


def octaves_run(recipe: Recipe) -> int:
    """How many of a recipe's octaves a run of its quality goes through, from the coarsest on.

    Example:
        >>> octaves_run(Recipe(octaves=3, quality="draft")), octaves_run(Recipe(octaves=3, quality="preview"))
        (2, 3)
    """
    return max(1, recipe.octaves - 1) if recipe.quality == DRAFT else recipe.octaves


def iterations_run(recipe: Recipe, octave: int) -> int:
    """How many iterations of an octave, counted from 0, a run of a recipe's quality goes through.

    Of the finest octave a preview has three fifths; a draft of a recipe with no coarser one has a quarter.

    Example:
        >>> recipe = Recipe(octaves=3, iterations=20, quality="preview")
        >>> [iterations_run(recipe, octave) for octave in range(3)]
        [20, 20, 12]
    """
    if octave < recipe.octaves - 1 or recipe.quality == FINAL:
        return recipe.iterations
    share = Fraction(3, 5) if recipe.quality == PREVIEW else Fraction(1, 4)
    return math.ceil(share * recipe.iterations)


def following(recipe: Recipe) -> str:
    """The quality after that of a recipe; final after final.

    Example:
        >>> following(Recipe(quality="draft"))
        'preview'
    """
    return QUALITIES[min(QUALITIES.index(recipe.quality) + 1, len(QUALITIES) - 1)]


def quality_beyond(recipe: Recipe, octave: int, iterations: int) -> str:
    """The lowest quality with which a run has something left to do from a state on; final if none has.

    Args:
        recipe: of the run; its own quality does not matter.
        octave: of the state, counted from 0.
        iterations: that are done in this octave.

    Example:
        >>> recipe = Recipe(octaves=3, iterations=20)
        >>> [quality_beyond(recipe, octave, 20) for octave in range(3)]
        ['draft', 'preview', 'final']
    """
    for quality in QUALITIES:
        run = replace(recipe, quality=quality)
        last = octaves_run(run) - 1
        if octave < last or (octave == last and iterations < iterations_run(run, octave)):
            return quality
    return FINAL
