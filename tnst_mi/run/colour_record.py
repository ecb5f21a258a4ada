"""What run.json tells of optimised colours: how near they are to the pictures, and how they flicker."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from tnst_mi.io.pictures.srgb import srgb
from tnst_mi.losses.palette import Palette
from tnst_mi.optimisation.plan import Plan
from tnst_mi.optimisation.result import Stylized
from tnst_mi.rendering.smoke_colour import colours_of
from tnst_mi.run.flicker import FlickerMeter
from tnst_mi.run.work import Work


def palette_distances(plan: Plan, stylized: Stylized) -> dict[str, dict[str, float]]:
    """By picture, how far colours are from its own, `before` and `after`: of display values, in the three fixed views.

    It is the sliced Wasserstein distance in RGB, inside the smoke: the terms of the palette without their scale. Empty
    if colours are not optimised, and where the loss of a view is multiplied by its pixels (`sigma = "loss"`).
    """
    if plan.colours is None or plan.recipe.sigma == "loss":
        return {}
    found, size = {}, plan.octaves[-1].size
    for number, objective in enumerate(plan.objectives, start=1):
        for name, (_, term) in zip(objective.names, objective.weighted_terms, strict=True):
            of_target = name if len(plan.objectives) == 1 else f"target {number}: {name}"
            if not isinstance(term, Palette) or of_target not in stylized.terms_after:
                continue
            scale = term.mean_square(*size) / 3
            found[of_target] = {
                key: math.sqrt(scale * terms[of_target])
                for key, terms in (("before", stylized.terms_before), ("after", stylized.terms_after))
            }
    return found


def colour_flicker(
    work: Work, densities: Iterable[np.ndarray], grids: Iterable[Mapping[str, np.ndarray]]
) -> dict[str, Any]:
    """The flicker of what optimised colours change, (c − start) d*, so that only smoke counts; empty without them.

    Args:
        work: of the run.
        densities: of the results, in their order.
        grids: those beside them, likewise.

    Returns:
        colour_flicker, the mean over the pairs, and colour_flicker_pairs, as `flicker` and `flicker_pairs` of the
        density.
    """
    plan = work.plan
    if plan.colours is None:
        return {}
    meter = FlickerMeter()
    for index, density, beside in zip(work.wanted, densities, grids, strict=True):
        source = work.moving[index]
        masks = () if plan.regions is None else plan.regions.masks(index, source)
        start = plan.colours.start(index, source, masks)
        colour = srgb(colours_of(beside, plan.colours.written, source.name))
        light = density[..., None]
        meter.add(source.name, start * light, colour * light, source.velocity)
    return {"colour_flicker": meter.mean, "colour_flicker_pairs": meter.pairs}
