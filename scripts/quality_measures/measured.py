"""All measures of one stylization."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from quality_measures import flicker
from quality_measures.crops import Picture
from quality_measures.seen import FRONT, Look
from quality_measures.spectrum import contrast, energy_shares, mean_frequency, scrambled, spectral_distance
from quality_measures.texture import relative_texture, texture_distances
from tnst_mi import Frame, GoogLeNet
from tnst_mi.fields.density_unit import scaled
from tnst_mi.rendering.cameras.views import View


def measured(
    judge: GoogLeNet,
    style: Picture,
    frames: Sequence[Frame],
    stylized: Sequence[np.ndarray],
    looks: Sequence[Look],
    views: Sequence[View],
) -> dict[str, Any]:
    """Measure a stylization; docs/quality.md says what each number means.

    Args:
        judge: a network that took no part.
        style: of the size of the images.
        frames: one or more consecutive ones; texture and spectrum are those of the first.
        stylized: their densities d*, (D, H, W).
        looks: how the run shows each frame.
        views: that the optimisation has not seen.

    Raises:
        InputError: the first frame shows no smoke.
    """
    found = of_texture_and_change(judge, style, frames[0], stylized[0], looks[0], views)
    masses = [
        (frame.density.sum(dtype=np.float64), d.sum(dtype=np.float64))
        for frame, d in zip(frames, stylized, strict=True)
    ]
    found["mass_kept"] = float(sum(after for _, after in masses) / sum(before for before, _ in masses))
    return found | of_time(judge, frames, stylized, looks)


def of_texture_and_change(
    judge: GoogLeNet, style: Picture, frame: Frame, stylized: np.ndarray, look: Look, views: Sequence[View]
) -> dict[str, Any]:
    """Texture distance on held-out views, and contrast and spectrum of the change in them."""
    inside = look.inside(frame.density, views)
    before, after = (look.images(density, views) for density in (frame.density, stylized))
    pictures = {
        "before": [Picture(*pair) for pair in zip(before, inside, strict=True)],
        "after": [Picture(*pair) for pair in zip(after, inside, strict=True)],
        # What the contrast and the spectrum of the change alone would bring.
        "scrambled": [
            Picture(old + scrambled(image - old, shown), shown)
            for image, old, shown in zip(after, before, inside, strict=True)
        ],
        # The style seen through the silhouette of the smoke: as near as a stylization that fills it could come.
        "style": [Picture(style.grey, shown & style.inside) for shown in inside],
    }
    distances = {
        name: texture_distances(judge, taken, style)
        for name, taken in pictures.items()
        if all(picture.inside.any() for picture in taken)
    }
    change = [Picture(image - old, shown) for image, old, shown in zip(after, before, inside, strict=True)]
    cycles, of_change = energy_shares(change)
    _, of_style = energy_shares([style] * len(views))
    return {
        "texture": relative_texture(distances["after"], distances["before"]),
        "scrambled": relative_texture(distances["scrambled"], distances["before"]),
        "reachable": relative_texture(distances["style"], distances["before"]) if "style" in distances else None,
        "texture_distances": distances,
        "contrast": contrast(change) / contrast([style]),
        "spectral_distance": spectral_distance(of_change, of_style),
        "frequency": mean_frequency(cycles, of_change) / mean_frequency(cycles, of_style),
    }


def of_time(
    judge: GoogLeNet, frames: Sequence[Frame], stylized: Sequence[np.ndarray], looks: Sequence[Look]
) -> dict[str, float | None]:
    """Flicker of the front view relative to the input's, in pixels and for the judge; None without a pair of frames."""
    ratios: dict[str, list[float]] = {"flicker": [], "perceptual_flicker": []}
    for index, (frame, following) in enumerate(itertools.pairwise(frames)):
        if frame.velocity is None:
            continue
        # A pixel is a cell here, as velocities are in cells.
        of_pair = [replace(look, size=frame.density.shape[1:]) for look in looks[index : index + 2]]
        inside = of_pair[1].inside(following.density, [FRONT])[0]
        before, after = (
            _errors(judge, densities, frame.velocity, of_pair, inside)
            for densities in ((frame.density, following.density), (stylized[index], stylized[index + 1]))
        )
        for ratio, of_input, of_result in zip(ratios.values(), before, after, strict=True):
            # Smoke that stands still has nothing to be relative to.
            if of_input > 0:
                ratio.append(of_result / of_input)
    return {name: float(np.mean(found)) if found else None for name, found in ratios.items()}


def _errors(
    judge: GoogLeNet,
    densities: Sequence[np.ndarray],
    velocity: np.ndarray,
    looks: Sequence[Look],
    inside: np.ndarray,
) -> tuple[float, float]:
    """Warp error and perceptual distance of the front views of two densities, the first carried to the second."""
    first, second = (look.images(density, [FRONT])[0] for look, density in zip(looks, densities, strict=True))
    motion = flicker.seen_motion(scaled(densities[0], looks[0].density_scale), velocity, looks[0].gamma)
    moved = flicker.carried(first, motion)
    return flicker.difference(moved, second, inside), flicker.perceptual_distance(judge, moved, second, inside)
