"""How two results differ, in numbers: recipes, inputs, weights and versions, and the frames that both have."""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tnst_mi.frame import Frame
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.flicker import relative_change
from tnst_mi.run.reopened import Reopened

#: What a record says of a run as a whole, as paths of keys in run.json.
_PROVENANCE = (
    ("status",),
    ("input",),
    ("seed",),
    ("weights", "flavour"),
    ("weights", "sha256"),
    ("density_scale",),
    ("main_view",),
    *(("versions", package) for package in ("tnst_mi", "python", "mitsuba", "drjit", "torch", "numpy")),
    ("device", "variant"),
    ("seconds",),
)

#: Numbers of a frame of which one is of both results.
_MEANS = ("relative_difference", "change_correlation", "colour_difference")

#: What the record of a frame says.
_RECORDED = ("loss_before", "loss_after", "largest_displacement", "folded")


def recipe_differences(*recipes: Recipe) -> dict[str, tuple[Any, ...]]:
    """The keys whose values differ, each with that of every recipe as TOML has it; None where a key is not set.

    Example:
        >>> recipe_differences(Recipe(gamma=0.1), Recipe(gamma=1.0))
        {'gamma': (0.1, 1.0)}
    """
    return _different(*(tomllib.loads(recipe.to_toml()) for recipe in recipes))


def provenance_differences(a: Mapping[str, Any] | None, b: Mapping[str, Any] | None) -> dict[str, tuple[Any, ...]]:
    """What else differs between the records of two runs, by dotted names such as versions.mitsuba.

    Of frames and of other inputs, such as pictures, the digests are compared: `inputs` and `files` hold what differs.
    """
    flat = [{".".join(keys): _at(record, keys) for keys in _PROVENANCE} for record in (a or {}, b or {})]
    found = _different(*flat)
    for key in ("inputs", "files"):
        held = [{} if record is None else dict(record.get(key, {})) for record in (a, b)]
        # Equal files count as equal wherever they are.
        if sorted(held[0].values()) != sorted(held[1].values()):
            found[key] = (sorted(set(held[0]) - set(held[1])), sorted(set(held[1]) - set(held[0])))
    return found


def frame_difference(
    a: Reopened,
    b: Reopened,
    at: tuple[int, int],
    frames: tuple[Frame, Frame],
    colours: tuple[np.ndarray | None, np.ndarray | None] = (None, None),
) -> dict[str, Any]:
    """The numbers of a frame that both have.

    Args:
        a: the one.
        b: the other.
        at: index of the frame in each.
        frames: the frame of each.
        colours: in which each is shown, (D, H, W, 3) display values; None for a grey one.

    Returns:
        names; relative_difference ‖d_b − d_a‖/‖d_a‖ and change_correlation, Pearson's of d_a − d and d_b − d where both
        have the same input d (None where they do not, where there is no change, or on different grids);
        colour_difference, see `colour_difference` (None without colours, and likewise on different grids); changes
        ‖d* − d‖/‖d‖ of each; masses; and of runs loss_before, loss_after, largest_displacement and folded.
    """
    names = a.names[at[0]], b.names[at[1]]
    alike = frames[0].density.shape == frames[1].density.shape
    inputs = [
        None if part.inputs is None else part.inputs[index].density for part, index in zip((a, b), at, strict=True)
    ]
    changes = [
        None if before is None or before.shape != frame.density.shape else frame.density - before
        for before, frame in zip(inputs, frames, strict=True)
    ]
    first, second = inputs
    same = first is not None and second is not None and np.array_equal(first, second)
    records = [part.recorded(name) for part, name in zip((a, b), names, strict=True)]
    return {
        "names": names,
        "shapes": tuple(frame.density.shape for frame in frames),
        "relative_difference": relative_change(frames[0].density, frames[1].density) if alike else None,
        "same_input": same,
        "change_correlation": _correlation(changes[0], changes[1]) if same and alike else None,
        "colour_difference": colour_difference(frames, colours) if alike else None,
        "changes": tuple(
            None if before is None or change is None else relative_change(before, before + change)
            for before, change in zip(inputs, changes, strict=True)
        ),
        "masses": tuple(frame.mass for frame in frames),
        **{key: tuple(record.get(key) for record in records) for key in _RECORDED},
    }


def colour_difference(
    frames: tuple[Frame, Frame], colours: tuple[np.ndarray | None, np.ndarray | None]
) -> float | None:
    """How much colours of smoke differ: the root mean square of the difference of display values, over the smoke.

    Cells count by the mean of both densities. A grey frame is white; None if both are, or there is no smoke.
    """
    if colours[0] is None and colours[1] is None:
        return None
    a, b = (1.0 if of_one is None else of_one for of_one in colours)
    weights = frames[0].density.astype(np.float64) + frames[1].density
    total = weights.sum()
    square = np.square(b - a, dtype=np.float64).mean(-1)
    return float(np.sqrt((weights * square).sum() / total)) if total > 0 else None


def summary(frames: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Means over the frames of `frame_difference`, of those that have a value; pairs where frames have pairs."""
    means = {key: _mean([frame[key] for frame in frames]) for key in _MEANS}
    pairs = {
        key: tuple(_mean([frame[key][side] for frame in frames]) for side in (0, 1))
        for key in ("changes", "masses", "loss_before", "loss_after", "largest_displacement")
    }
    return means | pairs


def _correlation(a: np.ndarray | None, b: np.ndarray | None) -> float | None:
    """Pearson's correlation of two fields, summed in float64; None if one is constant."""
    if a is None or b is None or np.ptp(a) == 0 or np.ptp(b) == 0:
        return None
    x, y = (field.astype(np.float64) - field.mean(dtype=np.float64) for field in (a, b))
    return float((x * y).sum() / np.sqrt((x * x).sum() * (y * y).sum()))


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _at(record: Mapping[str, Any], keys: Sequence[str]) -> Any:
    value: Any = record
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def _different(*tables: Mapping[str, Any]) -> dict[str, tuple[Any, ...]]:
    values = {key: tuple(table.get(key) for table in tables) for key in itertools.chain(*tables)}
    return {key: found for key, found in values.items() if any(value != found[0] for value in found)}
