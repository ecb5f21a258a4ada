"""The keys of a recipe about the colour of the smoke."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from tnst_mi.recipe.keys import Choice, Number


@dataclass(frozen=True)
class Colouring:
    """The colour of the smoke."""

    colour: Annotated[str, Choice(("off", "style", "keep"))] = "off"
    """Colour of the smoke: off shows it in grey; style gives it the colours of the style pictures, which the network
    sees in colour then, and writes them as Cd; keep shows it in the colour that moves with it, the grid Cd, color or
    the like of the input, or else its temperature as the hue of a black body, while the network sees grey
    (docs/colour.md)."""
    colour_weight: Annotated[float, Number(low=0.0)] = 1.0
    """With colour = style, the weight of the pictures' palettes, which colours alone follow, beside that of their
    strokes, style_weight, 0 or more. With style_weight = 0 the smoke takes on a palette without strokes."""
    colour_eta: Annotated[float, Number(above=0.0, high=1.0)] = 0.03
    """Step size of colours, above 0 and up to 1: by how much an iteration changes the display values, which go from 0
    to 1, at most."""
    colour_smoothness: Annotated[float, Number(low=0.0, high=100.0)] = 1.2
    """How smooth changes of colours are: width, in cells of the octave, of the blur of their gradient, 0 or more."""
