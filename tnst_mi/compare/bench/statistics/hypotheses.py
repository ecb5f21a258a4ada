"""What is measured of both sides, and the hypotheses that they are equal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tnst_mi.compare.bench.statistics.batches import Batches
from tnst_mi.compare.bench.statistics.decision import Family, family, merged

#: How derivatives are taken.
DIFFERENTIATED, DIFFERENCED, KNOWN = "differentiation", "central differences", "a known answer"

_CHANNELS = {1: ("",), 3: (", red", ", green", ", blue")}


@dataclass(frozen=True, eq=False)
class ImagePair:
    """The images of both sides.

    Attributes:
        where: what they are of, such as "γ 0.5"; "" for a scene file.
        left, right: (batches, V, H, W, C).
        slack: (V, H, W, C), by how much more than the tolerance they may differ: the rounding of float32, where known.
        arbiters: by their names, images (V, H, W, C) by float64 references that neither side has a part in.
    """

    where: str
    left: Batches
    right: Batches
    slack: np.ndarray
    arbiters: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Derivative:
    """Estimates of one derivative of the weighted mean of the images, see `renderer.ramp`.

    Attributes:
        where: as in `ImagePair`.
        parameter: one of `PARAMETERS`.
        left, right: by how they were taken: batches (n,).
        missing: why a side has none, or none of a kind.
        steps: of central differences, of the left and the right; None where a side takes none. For the sensor, in the
            units of the scene.
        size: of the mean itself, to which the tolerance is relative where the derivative is smaller.
    """

    where: str
    parameter: str
    left: dict[str, Batches]
    right: dict[str, Batches]
    missing: tuple[str, ...]
    steps: tuple[float | None, float | None]
    size: float


def value_families(
    where: str,
    left: Batches,
    right: Batches,
    tolerance: float,
    views: Sequence[str] | None = None,
    slack: np.ndarray | None = None,
) -> list[Family]:
    """The tests of images: the mean of each view, tiles of it, and pixels.

    Args:
        where: what the images are of, for labels.
        left, right: (batches, V, H, W, C).
        tolerance: difference that does not count, relative to the RMS of a view.
        views: names of the views.
        slack: (V, H, W, C) that does not count in addition.
    """
    _, count, rows, columns, channels = left.values.shape
    prefix = f"{where}, " if where else ""
    names = [f"{prefix}view {name}" for name in (views or map(str, range(count)))]
    size = np.sqrt(np.maximum(left.mean**2, right.mean**2).mean((1, 2, 3), keepdims=True))
    allowed = Batches((tolerance * size + (np.zeros(left.mean.shape) if slack is None else slack))[None])
    tiles = left.tiles()
    sizes = Batches(np.broadcast_to(size, left.mean.shape)[None])
    kinds = {
        "means": (left.means(), right.means(), allowed.means(), sizes.means(), [""]),
        "tiles": (
            tiles,
            right.tiles(),
            allowed.tiles(),
            sizes.tiles(),
            [f", tile {y},{x}" for y, x in np.ndindex(*tiles.values.shape[2:4])],
        ),
        "pixels": (
            left,
            right,
            allowed,
            sizes,
            [f", row {y}, column {x}" for y, x in np.ndindex(rows, columns)],
        ),
    }
    return [
        family(
            kind,
            [f"{view}{place}{channel}" for view in names for place in places for channel in _CHANNELS[channels]],
            one,
            other,
            allowance.mean,
            scale.mean,
        )
        for kind, (one, other, allowance, scale, places) in kinds.items()
    ]


def derivative_tests(derivative: Derivative, tolerance: float) -> Family:
    """Each side's own ways of differentiation against each other, and the sides, where possible by the same way."""
    left, right = derivative.left, derivative.right
    pairs = [
        (f"{side} by {DIFFERENTIATED} and by {DIFFERENCED}", found[DIFFERENTIATED], found[DIFFERENCED])
        for side, found in (("left", left), ("right", right))
        if {DIFFERENTIATED, DIFFERENCED} <= found.keys()
    ]
    if left and right:
        ways = {(way, way if way in right else next(iter(right))): None for way in left}
        ways |= {(way if way in left else next(iter(left)), way): None for way in right}
        for one, other in ways:
            described = one if one == other else f"{one} and {other}"
            pairs.append((f"left and right by {described}", left[one], right[other]))
    prefix = f"{derivative.where}, " if derivative.where else ""
    tests = []
    for label, one, another in pairs:
        own = max(abs(float(one.mean)), abs(float(another.mean)))
        one, another = (replace(side, values=side.values[:, None]) for side in (one, another))
        label = f"{prefix}derivative with respect to {derivative.parameter}, {label}"
        allowance = np.array(tolerance * max(own, derivative.size))
        tests.append(family("derivatives", [label], one, another, allowance, own))
    return merged(tests)[0] if tests else _no_tests()


def _no_tests() -> Family:
    return family("derivatives", [], Batches(np.zeros((1, 0))), Batches(np.zeros((1, 0))), np.zeros(0))
