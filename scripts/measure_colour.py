"""How near the colours of stylized smoke are to those of its picture, and how they flicker over a sequence.

    python scripts/measure_colour.py RUN…

Of each folder of a run with colour = "style", by frame: the sliced Wasserstein distance in RGB, inside the smoke, of
pictures from views that no iteration saw to each of the style's pictures, before and after: of white smoke, of smoke in
the colours with which the run began (the mean of the pictures, or those of the input, unmoved), and of the result. And
of a sequence the flicker of what its colours change, times the density, so that only smoke counts, beside that of its
density (docs/sequences.md says what flicker is).
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
from tnst_mi.frame import Frame
from tnst_mi.io.pictures.srgb import srgb
from tnst_mi.losses.palette import Palette
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.rendering.smoke_colour import colour_name, colours_of
from tnst_mi.run.carry import chosen
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
    """The lines of the table about a run: for each frame with smoke, one of each picture of its style.

    Raises:
        InputError: it is none with such colours, has a style for each of several regions, or its input is not there any
            more.
    """
    run = reopened(folder)
    if run.record is None or run.recipe is None or run.recipe.colour != "style" or run.inputs is None:
        raise InputError(f"{folder}: expected a run with colour = 'style' whose input is still there")
    recipe = run.recipe.located(folder)
    if not recipe.style:
        raise InputError(
            f"{folder}: its pictures are those of [[target]], each with smoke of its own; expected a run with a style "
            "for all smoke"
        )
    views = [(azimuth, elevation) for azimuth in _beyond(recipe.azimuth) for elevation in _beyond(recipe.elevation)]
    lines, changes = [], []
    for name, source, result in zip(run.names, run.inputs, run.frames, strict=True):
        if not source.density.any():
            lines.append(f"| {folder.name} | {name} | no smoke | | | | | |")
            changes.append(None)
            continue
        record, at_frame = run.recorded(name), recipe.at(source.number)
        pictures = [
            (Palette(path), share)
            for path, share in zip(at_frame.style, at_frame.style_shares, strict=True)
            if share > 0
        ]
        grid = colour_name(result.grids)
        colour = srgb(colours_of(result.grids, grid or "Cd", name))
        start = _start(source, at_frame, pictures)
        for palette, _ in pictures:
            target = palette.picture.fitted(*source.density.shape[1:]).colours.reshape(-1, 3)
            shown = Shown(at_frame, record, run.record["density_scale"], views, target)
            white = shown.distance(source.density, np.ones_like(colour))
            begun, after = shown.distance(source.density, start), shown.distance(result.density, colour)
            lines.append(
                f"| {folder.name} | {name} | {palette.picture.name} | {white:.3f} | {begun:.3f} | {after:.3f} | "
                f"{after / white:.2f} | {after / begun:.2f} |"
            )
        light = (colour - start) * result.density[..., None]
        changes.append((light, result.density - source.density, source.velocity))
    pairs = [
        (_of_vectors(first[0], second[0], first[2]), flicker(first[1], second[1], first[2]) or 0.0)
        for first, second in itertools.pairwise(changes)
        if first is not None and second is not None and first[2] is not None
    ]
    if pairs:
        of_colour, of_density = np.mean(pairs, axis=0)
        lines.append(f"\n{folder.name}: flicker of colours {of_colour:.3f}, of the density {of_density:.3f}")
    return "\n".join(lines)


def _start(source: Frame, recipe: Recipe, pictures: Sequence[tuple[Palette, float]]) -> np.ndarray:
    """The colours (D, H, W, 3) with which a frame began: its own that moved with it, or else the pictures' mean."""
    own = colour_name(chosen(recipe.carry, source.grids))
    if own is not None:
        return np.clip(srgb(colours_of(source.grids, own, source.name)), 0, 1)
    size = source.density.shape[1:]
    means = [palette.picture.fitted(*size).mean_colour for palette, _ in pictures]
    mean = np.average(means, axis=0, weights=[share for _, share in pictures]).astype(np.float32)
    return np.ascontiguousarray(np.broadcast_to(mean, (*source.density.shape, 3)))


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
    print("| run | frame | picture | white | start | after | ÷ white | ÷ start |\n|---|---|---|---|---|---|---|---|")
    print("\n".join(tables))
    return 0


if __name__ == "__main__":
    sys.exit(main())
