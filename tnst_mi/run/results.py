"""The results of a frame, written to the folder of its run, and what its record says of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from tnst_mi.fields.density_unit import scaled
from tnst_mi.frame import Frame
from tnst_mi.optimisation.result import Stylized
from tnst_mi.rendering.driving import main_view
from tnst_mi.rendering.smoke_colour import shown_colours, shown_grid
from tnst_mi.run.carry import Carried, carried
from tnst_mi.run.colour import shown_temperature
from tnst_mi.run.colour_record import palette_distances
from tnst_mi.run.folder import RunFolder
from tnst_mi.run.record import frame_record
from tnst_mi.run.work import Work


def recorded(work: Work, index: int, source: Frame, stylized: Stylized) -> dict[str, Any]:
    """The record of a frame whose results are not written."""
    carry = carried(source, stylized, work.recipe.carry, None, work.measures[index].others)
    return _record(work, index, source, stylized, carry)


def write_results(
    work: Work, folder: RunFolder, index: int, source: Frame, stylized: Stylized
) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """Write what belongs to a frame but its iterations, which are added to the folder when the frame is recorded there.

    The largest arrays of `stylized` go: callers may keep every frame of a run.

    Returns:
        The record of the frame, and its main view before and after, (H, W) in [0, 1], in colour (H, W, 3).

    Raises:
        OSError: the folder cannot be written.
        InputError: a grid that moves with the smoke is not what it was.
    """
    plan = work.plan.frames[index]
    recipe, exposure, history = plan.recipe, plan.exposure, stylized.history
    carry = carried(source, stylized, work.recipe.carry, work.suffix, work.measures[index].others)
    record = _record(work, index, source, stylized, carry)
    name, hottest = None, None
    if recipe.colour != "off":
        name, hottest = shown_grid(carry.names, shown_temperature(recipe, work.measures))
    before, after = (
        exposure
        * main_view(
            scaled(density, work.plan.density_scale),
            recipe,
            work.plan.full.size,
            shown_colours(grids, name, source.name, density.shape, hottest),
        )
        for density, grids in ((source.density, source.grids), (stylized.density, carry.grids))
    )
    attributes = {
        "view": recipe.main_view,
        "gamma": recipe.extinction,
        "quadrature": recipe.quadrature,
        "exposure": exposure,
    }
    folder.write_arrays(source, stylized.density, stylized.velocity, carry)
    folder.write_images(source.name, before, after, attributes)
    folder.plot_history(source.name, history)
    if stylized.state is not None:
        record["state"] = folder.write_state(source.name, stylized.state)
    record.update(folder.recorded(source.name, carry.names, history))
    stylized.potential, stylized.colour = (None, None), None
    return record, before, after


def _record(work: Work, index: int, source: Frame, stylized: Stylized, carry: Carried) -> dict[str, Any]:
    """What the record of a frame says of it, but for its files."""
    record = frame_record(source, work.plan.frames[index], stylized) | {"carried": list(carry.names)}
    distances = palette_distances(work.plan, stylized)
    return record | ({"palette_distances": distances} if distances else {})
