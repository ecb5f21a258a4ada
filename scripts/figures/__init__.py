"""The figures and tables of the paper, one module each; `scripts/reproduce.py` makes them.

A module describes its figure in a constant `FIGURE` (`figures.figure.Figure`) and makes it in the function that this
names, from a `figures.setting.Setting`: the smoke, the size, and runs that are kept and resumed.
"""

from __future__ import annotations

import importlib

from figures.figure import Figure

#: Names of the figures, in the order of docs/figures.md, and their modules.
MODULES = {
    "density": "transport_or_density",
    "lambda": "helmholtz",
    "transport": "transport",
    "depth": "semantic_depth",
    "styles": "style_images",
    "style-layers": "style_layers",
    "combined": "semantic_and_style",
    "gamma": "extinction",
    "quadrature": "quadratures",
    "views": "multi_view",
    "invariance": "view_invariance",
    "windows": "windows",
    "stride": "stride",
    "mask": "masking",
    "obstacle": "obstacle",
    "turbulence": "turbulence_transfer",
    "two-dimensional": "two_dimensional",
    "table2": "table2",
    "preset": "paper_formulas",
    "motif": "motif_size",
    "keys": "recipe_keys",
    "look": "final_look",
}


def figure_named(name: str) -> Figure:
    """The figure of a name; its module is imported only now, since each pulls in a part of the package."""
    return importlib.import_module(f"figures.{MODULES[name]}").FIGURE
