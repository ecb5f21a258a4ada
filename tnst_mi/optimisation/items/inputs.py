"""What a frame brings into an octave: density, mask, regions, velocity and bounds on the octave's grid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from tnst_mi.errors import InputError
from tnst_mi.fields.density_unit import scaled
from tnst_mi.fields.grid import Octave
from tnst_mi.fields.resampling import resample_density, resample_mask, resample_velocity
from tnst_mi.frame import Frame
from tnst_mi.optimisation.colouring import COLOUR, on_octave
from tnst_mi.optimisation.mask import soft_mask
from tnst_mi.optimisation.plan import FramePlan, Plan
from tnst_mi.regions.octave_masks import border_of, octave_mask, union_of

#: Name of the factor that keeps fields inside the regions.
INSIDE = "inside"


@dataclass(frozen=True)
class Inputs:
    """Density and mask (D, H, W) of an unstylized frame on the grid of an octave.

    Attributes:
        density: of the frame.
        mask: of its smoke; times the union of the regions, if there are any.
        regions: the mask of each target, None for one that is everywhere; none at all if there are no regions.
        allowed: how far each of its cells may be moved; None if it is the same for all.
        colour: with which it begins, (D, H, W, 3) display values; None if colours are not optimised.
    """

    density: mi.TensorXf
    mask: mi.TensorXf
    regions: tuple[mi.TensorXf | None, ...] = ()
    allowed: mi.TensorXf | None = None
    colour: mi.TensorXf | None = None

    def target_regions(self) -> list[mi.TensorXf | None]:
        """For each target, its part of the regions, (D, H, W) in [0, 1]; None if it is everywhere."""
        if len(self.regions) < 2:
            return list(self.regions) or [None]
        union = union_of(self.regions)
        return [
            None if region is None and union is None else mi.TensorXf(_share(region, union), self.mask.shape)
            for region in self.regions
        ]

    def target_masks(self) -> list[mi.TensorXf]:
        """For each target, the mask of the smoke in its region."""
        if len(self.regions) < 2:
            return [self.mask]
        union = union_of(self.regions)
        return [mi.TensorXf(_share(region, union) * self.mask.array, self.mask.shape) for region in self.regions]


def region_name(target: int) -> str:
    """The name of the array that holds the mask of a target, counted from 0."""
    return f"region {target}"


def input_names(plan: Plan, frame: FramePlan) -> tuple[str, ...]:
    """The names of the arrays that `Inputs` are made of."""
    named = [region_name(i) for i, present in enumerate(_regions_present(plan)) if present]
    allowed, colour = ["allowed"] if frame.keeps_silhouette else [], [COLOUR] if plan.colours is not None else []
    return ("density", "mask", *named, *allowed, *colour)


def inputs_of(plan: Plan, arrays: Mapping[str, mi.TensorXf]) -> Inputs:
    """The inputs of a frame, made of arrays by name."""
    masks = tuple(arrays.get(region_name(i)) for i in range(len(_regions_present(plan))))
    return Inputs(arrays["density"], arrays["mask"], masks, arrays.get("allowed"), arrays.get(COLOUR))


def _regions_present(plan: Plan) -> list[bool]:
    """For each target, whether it has a mask; none at all if there are no regions."""
    return [] if plan.regions is None else plan.regions.present


def octave_inputs(
    plan: Plan, octave: Octave, frame: FramePlan, source: Frame
) -> dict[str, mi.TensorXf | mi.TensorXf16]:
    """The arrays of a frame for an octave, by name. Half precision suffices for masks in [0, 1] and for velocities.

    Raises:
        InputError: a mask cannot be used, or a velocity that the window needs is not there.
    """
    shape, h = octave.shape, octave.cell_size
    density = mi.TensorXf(scaled(source.density, plan.density_scale))
    mask = resample_mask(soft_mask(density, source.obstacle, plan.recipe.mask_strength), 1.0, shape, h)
    arrays: dict[str, mi.TensorXf | mi.TensorXf16] = {"density": resample_density(density, 1.0, shape, h)}
    regions = () if plan.regions is None else plan.regions.masks(frame.index, source)
    border = border_of(regions, octave)
    masks = [None if full is None else octave_mask(full, border, octave) for full in regions]
    arrays |= {region_name(i): mi.TensorXf16(region) for i, region in enumerate(masks) if region is not None}
    if border is not None:
        arrays[INSIDE] = mi.TensorXf16(border.fade())
    if (union := union_of(masks)) is not None:
        mask = mi.TensorXf(mask.array * union.array, mask.shape)
    if (allowed := plan.allowed(frame, source, octave)) is not None:
        arrays["allowed"] = allowed
        # Steps are as small as the room that they have. With full steps at the rim, which may hardly move, the rim
        # would decide by how much potentials are scaled as a whole.
        mask = mi.TensorXf(mask.array * allowed.array / dr.max(allowed.array), mask.shape)
    arrays["mask"] = mi.TensorXf16(mask)
    if plan.colours is not None:
        arrays[COLOUR] = on_octave(plan.colours.start(frame.index, source, regions), octave)
    if plan.window > 1 and frame.index + 1 < len(plan.frames):
        if source.velocity is None:
            raise InputError(f"{frame.name}: has no velocity, which a window of {plan.window} frames needs")
        arrays["velocity"] = mi.TensorXf16(resample_velocity(mi.TensorXf(source.velocity), 1.0, shape, h))
    return arrays


def _share(region: mi.TensorXf | None, union: mi.TensorXf | None) -> mi.Float:
    """The part of the union that a region is, in [0, 1]; 0 outside of both."""
    inside = mi.Float(1) if region is None else region.array
    return inside if union is None else dr.select(union.array > 0, inside / union.array, 0)
