"""How near the colours of stylized smoke are to those of its picture, and how they flicker over a sequence.

    python scripts/measure_colour.py RUN…

Of each folder of a run with colour = "style", by frame: the sliced Wasserstein distance in RGB, inside the smoke, of
pictures from views that no iteration saw to the style's picture, before and after: of white smoke, of smoke that has
the picture's mean everywhere, and of the result. And of a sequence the flicker of what its colours change, times the
density, so that only smoke counts, beside that of its density (docs/sequences.md says what flicker is).
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.io.pictures.srgb import srgb
from tnst_mi.losses.pictures import read_image
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.smoke_colour import colour_name, colours_of
from tnst_mi.run.flicker import flicker
from tnst_mi.run.reopened import reopened

#: Degrees beyond the ranges of a recipe, from which no iteration looks.
_OUTSIDE = 0.25

_DIRECTIONS, _QUANTILES = 128, 512


def distance(pixels: np.ndarray, weights: np.ndarray, picture: np.ndarray) -> float:
    """The sliced 2-Wasserstein distance of weighted colours (P, 3) and those of a picture (Q, 3)."""
    lines = np.random.default_rng(0).normal(size=(_DIRECTIONS, 3))
    lines /= np.linalg.norm(lines, axis=1, keepdims=True)
    levels, square = (np.arange(_QUANTILES) + 0.5) / _QUANTILES, 0.0
    for line in lines:
        shadows = pixels @ line
        order = np.argsort(shadows)
        ends = np.cumsum(weights[order])
        own = shadows[order][np.searchsorted(ends / ends[-1], levels).clip(max=len(order) - 1)]
        square += np.square(own - np.quantile(picture @ line, levels)).mean()
    return float(np.sqrt(square / _DIRECTIONS))


@dataclass(frozen=True)
class Shown:
    """How the pictures of a frame are made, and the colours of its style (Q, 3).

    Attributes:
        recipe: of the frame.
        record: of it in run.json.
        unit: factor of its density.
        views: (azimuth, elevation) from which no iteration looked.
        target: display values of the style's picture.
    """

    recipe: Recipe
    record: Mapping[str, Any]
    unit: float
    views: Sequence[tuple[float, float]]
    target: np.ndarray

    def distance(self, density: np.ndarray, colour: np.ndarray) -> float:
        """The distance of the pictures of a density (D, H, W) in colours (D, H, W, 3) to the style."""
        gamma, quadrature = self.record["gamma"], self.recipe.quadrature
        smoke = density * np.float32(self.unit)
        colours, opacities = [], []
        for view in self.views:
            image = tnst_mi.render(smoke, view, gamma=gamma, quadrature=quadrature, colour=colour)
            colours.append(self.record["exposure"] * np.asarray(image).reshape(-1, 3))
            opacities.append(gamma * np.asarray(tnst_mi.render(smoke, view, gamma=gamma, quadrature="exact")).ravel())
        return distance(np.concatenate(colours), np.concatenate(opacities).astype(np.float64), self.target)


def measured(folder: Path) -> str:
    """The lines of the table about a run.

    Raises:
        InputError: it is none with such colours, or its input is not there any more.
    """
    run = reopened(folder)
    if run.record is None or run.recipe is None or run.recipe.colour != "style" or run.inputs is None:
        raise InputError(f"{folder}: expected a run with colour = 'style' whose input is still there")
    recipe = run.recipe.located(folder)
    picture = read_image(recipe.style[0])
    views = [(azimuth, elevation) for azimuth in _beyond(recipe.azimuth) for elevation in _beyond(recipe.elevation)]
    lines, changes = [], []
    for name, source, result in zip(run.names, run.inputs, run.frames, strict=True):
        target = picture.fitted(*source.density.shape[1:]).colours.reshape(-1, 3)
        record = run.recorded(name)
        shown = Shown(recipe.at(source.number), record, run.record["density_scale"], views, target)
        grid = colour_name(result.grids)
        colour = srgb(colours_of(result.grids, grid or "Cd", name))
        mean = np.ascontiguousarray(np.broadcast_to(picture.mean_colour, colour.shape))
        white = shown.distance(source.density, np.ones_like(colour))
        begun, after = shown.distance(source.density, mean), shown.distance(result.density, colour)
        lines.append(
            f"| {folder.name} | {name} | {white:.3f} | {begun:.3f} | {after:.3f} | {after / white:.2f} | "
            f"{after / begun:.2f} |"
        )
        light = (colour - mean) * result.density[..., None]
        changes.append((light, result.density - source.density, source.velocity))
    pairs = [
        (_of_vectors(light, light_next, u), flicker(change, change_next, u) or 0.0)
        for (light, change, u), (light_next, change_next, _) in itertools.pairwise(changes)
        if u is not None
    ]
    if pairs:
        of_colour, of_density = np.mean(pairs, axis=0)
        lines.append(f"\n{folder.name}: flicker of colours {of_colour:.3f}, of the density {of_density:.3f}")
    return "\n".join(lines)


def _of_vectors(change: np.ndarray, following: np.ndarray, velocity: np.ndarray) -> float:
    """The flicker of changes (D, H, W, 3): of all components together."""
    shares = [np.square(following[..., i], dtype=np.float64).sum() for i in range(3)]
    squares = [
        (flicker(change[..., i].copy(), following[..., i].copy(), velocity) or 0.0) ** 2 * shares[i] for i in range(3)
    ]
    return float(np.sqrt(sum(squares) / sum(shares)))


def _beyond(bounds: tuple[float, float]) -> tuple[float, float]:
    """Angles a quarter of a range beyond its ends."""
    reach = _OUTSIDE * (bounds[1] - bounds[0])
    return bounds[0] - reach, bounds[1] + reach


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="folders of runs with colour = style")
    tnst_mi.activate()
    try:
        tables = [measured(run) for run in parser.parse_args(arguments).runs]
    except InputError as error:
        print(f"measure_colour: {error}", file=sys.stderr)
        return 2
    print("| run | frame | white | mean | after | ÷ white | ÷ mean |\n|---|---|---|---|---|---|---|")
    print("\n".join(tables))
    return 0


if __name__ == "__main__":
    sys.exit(main())
