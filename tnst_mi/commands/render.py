"""`tnst-mi render`: pictures of density files from chosen viewpoints."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from tnst_mi.commands.base import Command, Folder, given, recipe_flags
from tnst_mi.errors import InputError
from tnst_mi.recipe import Recipe
from tnst_mi.recipe_keys import Number

RendererFlags = recipe_flags(("gamma", "quadrature", "variant"))


@dataclass(kw_only=True)
class Render(Command):
    """Render a density file, or each file of a folder, as PNG (clipped to 8 bits) and EXR (exact).

    One exposure is used for all pictures: 1 / the largest value in the first view of any frame.
    """

    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="INPUT")]
    """Density file or folder of numbered ones."""
    out: Folder
    """New or empty folder for the pictures."""
    views: Annotated[tuple[str, ...], tyro.conf.arg(metavar="AZIMUTH,ELEVATION…")] = ("0,0",)
    """Views in degrees, one or more; 0,0 is the front, + is to the right and upwards."""
    overwrite: bool = False
    """Write into a folder that is not empty, replacing pictures of the same names."""
    renderer: RendererFlags = field(default_factory=RendererFlags)
    """How the smoke is rendered."""

    def run(self) -> int:
        """Render every view of every frame."""
        import numpy as np

        from tnst_mi.backend import activate
        from tnst_mi.io import open_frames
        from tnst_mi.io.exr import write_exr
        from tnst_mi.io.png import write_png
        from tnst_mi.outputs import require_writable

        recipe = Recipe().updated_by_flags(given(self.renderer))
        views = [_view(text) for text in self.views]
        remedy = None if self.overwrite else "give another folder, or write into this one with --overwrite"
        require_writable(self.out, remedy=remedy)
        frames = open_frames(self.input)
        activate(recipe.variant)
        from tnst_mi.scene import render

        def pictures(density: np.ndarray, of: list[tuple[float, float]]) -> np.ndarray:
            return np.asarray(render(density, of, recipe.gamma, recipe.quadrature))

        brightest = max(float(pictures(frame.density, views[:1]).max()) for frame in frames)
        exposure = 1.0 / brightest if brightest > 0.0 else 1.0
        for frame in frames:
            for view, image in zip(views, exposure * pictures(frame.density, views), strict=True):
                name = f"{frame.name}_view_{view[0]:g}_{view[1]:g}"
                attributes = {
                    "view": view,
                    "gamma": recipe.gamma,
                    "quadrature": recipe.quadrature,
                    "exposure": exposure,
                }
                write_png(self.out / f"{name}.png", image)
                write_exr(self.out / f"{name}.exr", image, attributes)
                print(f"picture   {self.out / name}.png and {name}.exr")
        return 0


def _view(text: str) -> tuple[float, float]:
    try:
        azimuth, elevation = (Number(-360.0, 360.0).check(float(part)) for part in text.split(","))
    except ValueError:
        raise InputError(f"--views {text}: expected AZIMUTH,ELEVATION in degrees, such as -10,5") from None
    return azimuth, elevation
