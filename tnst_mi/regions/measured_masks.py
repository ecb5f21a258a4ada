"""What the masks of a run hold, measured before the work: the smoke in each, and which bits it has."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.recipe.targets import Target
from tnst_mi.regions.regions import Regions


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
    empty = [True] * len(targets)
    for index, frame in enumerate(frames):
        mass = frame.mass
        for number, mask in enumerate(regions.masks(index, frame)):
            inside = mass if mask is None else float((mask * frame.density).sum(dtype=np.float64))
            measured[number].smoke_shares.append(inside / mass if mass > 0 else 0.0)
            measured[number].sha256.append(None if mask is None else _digest(mask))
            empty[number] &= mask is not None and not mask.any()
    for target, none, of_target in zip(targets, empty, measured, strict=True):
        if none:
            raise InputError(
                f"{target.name}: is 0 everywhere in all frames; check its strength, and its place "
                "and size: lengths are those of the scene, or cells where the files have none"
            )
        if target.mask and not any(of_target.smoke_shares):
            raise InputError(f"{target.name}: has no smoke in it in any frame, so that nothing would change")
    return measured


def _digest(mask: np.ndarray) -> str:
    return hashlib.sha256(np.ascontiguousarray(mask).data).hexdigest()
