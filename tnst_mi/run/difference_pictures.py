"""How two results differ, in pictures: main views at equal exposure side by side, their difference, a wipe, a video."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.fields.density_unit import scaled
from tnst_mi.frame import Frame
from tnst_mi.io.pictures.png import write_png
from tnst_mi.io.pictures.video import open_video
from tnst_mi.losses.pictures import resized
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.cameras.views import View
from tnst_mi.rendering.driving import main_view
from tnst_mi.rendering.levels import by_cell
from tnst_mi.run.panels import both_coloured, difference, on_canvas, row, wipe

#: Shares of the proportions up to which grids of different numbers of cells show the same scene.
_ALIKE = 0.02


@dataclass
class MainViews:
    """The main views of frames that two results have, both as the recipe of the first sees them.

    They are in colour where one of the two is.

    Grids of the same proportions but other numbers of cells are taken as the same scene: optical thickness and
    brightness are equal, and the smaller picture is enlarged. Other grids are shown cell by cell.

    Args:
        recipe: whose camera, γ and renderer; its main view.
        factor: of both densities.
    """

    recipe: Recipe
    factor: float
    pairs: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)

    def add(
        self,
        a: Frame,
        b: Frame,
        shot: View | None = None,
        colours: tuple[np.ndarray | None, np.ndarray | None] = (None, None),
    ) -> None:
        """Render a frame of each, from around where the camera of the shot saw it, if there is one.

        `colours` are those in which each is shown, (D, H, W, 3) display values, None for a grey one. Path tracing shows
        all smoke in grey.
        """
        recipe = by_cell(self.recipe.at(a.number), a.density.shape)
        recipe = replace(recipe, shots=() if shot is None else (shot,))
        finer = max(b.density.shape) / max(a.density.shape)
        same_scene = all(
            abs(n / m / finer - 1) <= _ALIKE for n, m in zip(b.density.shape, a.density.shape, strict=True)
        )
        share = 1 / finer if same_scene else 1.0
        tints = colours if recipe.integrator == "emission_absorption" else (None, None)
        thinner = replace(recipe, gamma=share * recipe.extinction)
        first = main_view(scaled(a.density, self.factor), recipe, colour=tints[0])
        second = share * main_view(scaled(b.density, self.factor), thinner, colour=tints[1])
        self.pairs.append(both_coloured(first, second))

    @property
    def exposure(self) -> float:
        """1 / the brightest pixel of all."""
        brightest = max(float(image.max()) for pair in self.pairs for image in pair)
        return 1 / brightest if brightest > 0 else 1.0

    def exposed(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The pictures in [0, 1], all with one exposure, those of a pair in one size."""
        return [_of_one_size(*(self.exposure * image for image in pair)) for pair in self.pairs]


def write_pictures(
    out: Path, titles: tuple[str, str], names: Sequence[str], views: MainViews, frames_per_second: float
) -> dict[str, Any]:
    """Write NAME_side.png and NAME_wipe.png for each frame, and diff.mp4 if there are several.

    Args:
        out: the folder.
        titles: names of the two results.
        names: of the frames.
        views: their main views, in the same order.
        frames_per_second: of the video.

    Returns:
        What diff.json holds of them: exposure, difference_scale (by which differences of exposed pictures are
        multiplied, the same for all), and files.

    Raises:
        InputError: there are several frames and no encoder of videos is installed.
    """
    pairs = views.exposed()
    largest = max(float(np.abs(b - a).max()) for a, b in pairs)
    scale = 1 / largest if largest > 0 else 1.0
    files, film = [], out / "diff.mp4"
    with open_video(film, frames_per_second) if len(pairs) > 1 else nullcontext() as video:
        for name, (a, b) in zip(names, pairs, strict=True):
            grey = f"B - A times {scale:.3g}: orange where B is brighter"
            change = (grey if a.ndim == 2 else f"|B - A| times {scale:.3g}", difference(a, b, scale))
            side = row([(f"A: {titles[0]}", a), (f"B: {titles[1]}", b), change])
            files += [f"{name}_side.png", f"{name}_wipe.png"]
            write_png(out / files[-2], side)
            write_png(out / files[-1], row([(f"{titles[0]} | {titles[1]}", wipe(a, b))]))
            if video is not None:
                video.add(side)
    return {
        "exposure": views.exposure,
        "difference_scale": scale,
        "files": [*files, *([film.name] if len(pairs) > 1 else [])],
    }


def _of_one_size(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if a.shape == b.shape:
        return a, b
    rows, columns = max(a.shape[0], b.shape[0]), max(a.shape[1], b.shape[1])
    if abs(a.shape[0] * b.shape[1] / (a.shape[1] * b.shape[0]) - 1) <= _ALIKE:
        return resized(a, rows, columns), resized(b, rows, columns)
    return on_canvas(a, rows, columns), on_canvas(b, rows, columns)
