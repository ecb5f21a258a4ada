"""How near the colours of stylized smoke are to those of its picture, and how they flicker over a sequence.

    python scripts/measure_colour.py RUN…

Of each folder of a run with colour = "style", by frame: the sliced Wasserstein distance in RGB, inside the smoke, of
pictures from views that no iteration saw to the style's picture, before and after: of white smoke, of smoke that has
the picture's mean everywhere, and of the result. And of a sequence the flicker of the change of its colours beside that
of its density, both times the density so that only smoke counts (docs/sequences.md says what flicker is).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import tnst_mi
from tnst_mi.errors import InputError
from tnst_mi.io.pictures.srgb import srgb
from tnst_mi.losses.pictures import read_image
from tnst_mi.rendering.smoke_colour import colour_name
from tnst_mi.run.flicker import flicker
from tnst_mi.run.resuming import recipe_of_run

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


def measured(run: Path) -> str:
    """The lines of a table about a run, and one about its flicker."""
    result = tnst_mi.Result.open(run)
    recipe, record = recipe_of_run(run).located(run), result.run
    if recipe.colour != "style":
        raise InputError(f"{run}: its colour is {recipe.colour!r}; expected a run with colour = 'style'")
    azimuths = _beyond(recipe.azimuth)
    views = [(azimuth, elevation) for azimuth in azimuths for elevation in _beyond(recipe.elevation)]
    lines, changes = [], []
    for index, frame in enumerate(result.frames):
        at, of_frame = recipe.at(frame.number), record["frames"][index]
        density = result.densities[index]
        name = colour_name(result.grids[index])
        assert name is not None
        colour = srgb(result.grids[index][name])
        rows, columns = density.shape[1:]
        picture = read_image(recipe.style[0])
        target = picture.fitted(rows, columns).colours.reshape(-1, 3)
        mean = np.broadcast_to(picture.mean_colour, colour.shape)

        def of(smoke: np.ndarray, tint: np.ndarray) -> float:
            scaled = (smoke * np.float32(record["density_scale"])).astype(np.float32)
            shown = [
                tnst_mi.render(scaled, view, gamma=of_frame["gamma"], quadrature=at.quadrature, colour=tint)
                for view in views
            ]
            opacity = [
                np.clip(of_frame["gamma"] * tnst_mi.render(scaled, view, gamma=of_frame["gamma"], quadrature="exact"), 0, 1)
                for view in views
            ]
            pixels = of_frame["exposure"] * np.concatenate([np.asarray(image).reshape(-1, 3) for image in shown])
            return distance(pixels, np.concatenate([np.asarray(o).ravel() for o in opacity]).astype(float), target)

        white, begun, after = (
            of(frame.density, np.ones_like(colour)),
            of(frame.density, np.ascontiguousarray(mean)),
            of(density, colour),
        )
        lines.append(
            f"| {run.name} | {frame.name} | {white:.3f} | {begun:.3f} | {after:.3f} | {after / white:.2f} | "
            f"{after / begun:.2f} |"
        )
        inside = np.clip(density / max(float(density.max()), 1e-30) * 4, 0, 1)[..., None]
        changes.append(((colour - mean) * inside, density - frame.density, frame.velocity))
    flickers = [
        (
            np.mean([flicker(c[..., i].copy(), after[..., i].copy(), u) or 0.0 for i in range(3)]),
            flicker(d, d_after, u) or 0.0,
        )
        for (c, d, u), (after, d_after, _) in zip(changes, changes[1:], strict=False)
        if u is not None
    ]
    if flickers:
        of_colour, of_density = np.mean(flickers, axis=0)
        lines.append(f"| {run.name} | flicker of colours {of_colour:.3f}, of the density {of_density:.3f} | | | | | |")
    return "\n".join(lines)


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
