"""What the masks of a run hold, measured before the work: the smoke in each, and which bits it has."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.recipe.region_keys import form_of
from tnst_mi.recipe.targets import Target
from tnst_mi.regions.regions import Regions
from tnst_mi.regions.shapes import smoke_extent


@dataclass(frozen=True)
class MeasuredMask:
    """The mask of a target in all frames, in their order.

    Attributes:
        smoke_shares: the share of the smoke that is in it, Σ m d / Σ d; 0 without smoke.
        sha256: of its values (D, H, W) float32; None where it is 1 everywhere.
    """

    smoke_shares: list[float] = field(default_factory=list)
    sha256: list[str | None] = field(default_factory=list)


def measured_masks(regions: Regions, targets: Sequence[Target], frames: Iterable[Frame]) -> list[MeasuredMask]:
    """Evaluate the mask of each target in each frame.

    Args:
        regions: the masks.
        targets: whose they are.
        frames: in their order; each is read once.

    Raises:
        InputError: a mask cannot be used, is 0 everywhere in all frames, or has no smoke in it in any.
    """
    measured = [MeasuredMask() for _ in targets]
    empty, extents = [True] * len(targets), []
    for index, frame in enumerate(frames):
        mass = frame.mass
        extents.append(smoke_extent(frame.density, frame.placement))
        for number, mask in enumerate(regions.masks(index, frame)):
            inside = mass if mask is None else float((mask * frame.density).sum(dtype=np.float64))
            measured[number].smoke_shares.append(inside / mass if mass > 0 else 0.0)
            measured[number].sha256.append(None if mask is None else _digest(mask))
            empty[number] &= mask is not None and not mask.any()
    for target, none, of_target in zip(targets, empty, measured, strict=True):
        if none:
            raise InputError(f"{target.name}: is 0 everywhere in all frames; {_why(target, regions, extents)}")
        if target.mask and not any(of_target.smoke_shares):
            why = _why(target, regions, extents)
            raise InputError(f"{target.name}: has no smoke in it in any frame, so that nothing would change; {why}")
    return measured


def _why(target: Target, regions: Regions, extents: Sequence[np.ndarray | None]) -> str:
    """What tells why a mask holds nothing: the picture in it, or where the smoke is that its shapes miss."""
    parts = [part for part in target.mask if isinstance(part, Mapping)]
    black = [part["image"] for part in parts if form_of(part) == "image" and regions.is_black(part["image"])]
    if black:
        return f"nothing in {Path(black[0]).name} is white, which is what counts in a picture without transparency"
    there = [extent for extent in extents if extent is not None]
    if not there:
        return "the input has no smoke at all"
    if any(form_of(part) in ("sphere", "box", "height") for part in parts):
        low, high = np.min([low for low, _ in there], axis=0), np.max([high for _, high in there], axis=0)
        return (
            f"the smoke is from {_point(low)} to {_point(high)} in the units of the mask; check its place and strength"
        )
    return "check its values and its strength"


def _point(place: np.ndarray) -> str:
    return f"[{', '.join(f'{value:.4g}' for value in place)}]"


def _digest(mask: np.ndarray) -> str:
    return hashlib.sha256(np.ascontiguousarray(mask).data).hexdigest()
