"""`tnst-mi diff`: two results side by side, in numbers and pictures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from tnst_mi.commands.arguments import DiffArguments
from tnst_mi.commands.base import say
from tnst_mi.errors import InputError
from tnst_mi.io.atomic import written_whole
from tnst_mi.io.pictures.video import FRAMES_PER_SECOND
from tnst_mi.machine.backend import activate
from tnst_mi.machine.disk import require_names, require_writable
from tnst_mi.machine.progress_bar import progress_bar
from tnst_mi.machine.terminal import printable, some_of
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.sections import Goals
from tnst_mi.run.difference import frame_difference, provenance_differences, recipe_differences, summary
from tnst_mi.run.difference_pictures import MainViews, write_pictures
from tnst_mi.run.inputs import reference_density
from tnst_mi.run.reopened import Reopened, reopened, shared_frames

#: Keys on which the scale of the loss depends: the goals, and what the images are.
_OF_THE_LOSS = (
    *(key for key in Goals.__annotations__ if key != "mask"),
    *("quality", "motif_size", "octaves", "scale_factor", "fit", "gamma", "look", "quadrature", "integrator"),
    *("camera", "azimuth", "elevation"),
)

#: Longest value of a recipe's key in the summary.
_LONGEST = 60


def run(arguments: DiffArguments) -> int:
    """Compare, print the summary, and write diff.json and pictures if there is a folder for them."""
    if len(arguments.files) != 2:
        raise InputError(f"diff: expected two runs or densities, got {len(arguments.files)}")
    out = arguments.out
    if out is not None:
        remedy = None if arguments.overwrite else "give another folder, or write into this one with --overwrite"
        require_writable(out, remedy=remedy)
    a, b = (reopened(path) for path in arguments.files)
    say([*a.notes, *b.notes])
    together = shared_frames([a, b])
    names = [a.names[index] for index, _ in together]
    views = None
    if out is not None:
        require_names(out, names)
        activate()
        views = MainViews(a.recipe or b.recipe or Recipe(), _factor(a, b))
    frames = []
    for first, second in progress_bar(together, unit="frame", desc="comparing"):
        pair = a.frames[first], b.frames[second]
        colours = a.colour(pair[0]), b.colour(pair[1])
        frames.append(frame_difference(a, b, (first, second), pair, colours))
        if views is not None:
            seen = a if a.recipe is not None else b
            views.add(*pair, seen.shots.get(seen.names[first if seen is a else second]), colours)
    results = _results(a, b, together, frames)
    for line in _in_words(a, b, results):
        print(printable(line))
    if out is not None and views is not None:
        fps = views.recipe.fps or FRAMES_PER_SECOND
        results["pictures"] = write_pictures(out, (a.title, b.title), names, views, fps)
        with written_whole(out / "diff.json") as temporary:
            temporary.write_text(json.dumps(results, indent=1) + "\n", "utf-8")
        print(printable(f"written   {out}: diff.json, {some_of(results['pictures']['files'])}"))
    return 0


def _factor(a: Reopened, b: Reopened) -> float:
    """The factor of both densities: that of the first run, else the one that makes the unit of the first 1."""
    for part in (a, b):
        if part.record is not None:
            return float(part.record["density_scale"])
    return reference_density(a.frames).scale("auto")


def _results(
    a: Reopened, b: Reopened, together: Sequence[tuple[int, ...]], frames: list[dict[str, Any]]
) -> dict[str, Any]:
    """The contents of diff.json, less the pictures."""
    recipes = None if a.recipe is None or b.recipe is None else recipe_differences(a.recipe, b.recipe)
    runs = a.record is not None and b.record is not None
    return {
        "a": str(a.path),
        "b": str(b.path),
        "recipe": recipes,
        "provenance": provenance_differences(a.record, b.record) if runs else None,
        "frames": frames,
        "mean": summary(frames),
        "only_a": _others(a, [index for index, _ in together]),
        "only_b": _others(b, [index for _, index in together]),
    }


def _others(part: Reopened, shared: Sequence[int]) -> list[str]:
    return [name for index, name in enumerate(part.names) if index not in set(shared)]


def _in_words(a: Reopened, b: Reopened, results: Mapping[str, Any]) -> list[str]:
    """The summary, line by line."""
    frames, mean = results["frames"], results["mean"]
    lines = [f"{letter}         {_described(part)}" for letter, part in (("A", a), ("B", b))]
    if results["recipe"] is not None:
        differ = results["recipe"]
        lines.append(f"recipe    {_differences(len(differ))}")
        lines += [f"          {key}: {_shown(first)} → {_shown(second)}" for key, (first, second) in differ.items()]
    if results["provenance"] is not None:
        lines += [f"run       {text}" for text in _provenance(results["provenance"])]
    lines.append(f"frames    {len(frames)} in both" + _only("A", results["only_a"]) + _only("B", results["only_b"]))
    if len(frames) == 1 and frames[0]["names"][0] != frames[0]["names"][1]:
        lines.append(f"          {frames[0]['names'][0]} is compared with {frames[0]['names'][1]}")
    if mean["relative_difference"] is None:
        grids = " and ".join("×".join(map(str, shape)) for shape in frames[0]["shapes"])
        lines.append(f"density   grids differ ({grids}, z y x): not compared cell by cell")
    else:
        lines.append(f"density   ‖B − A‖/‖A‖ = {_spread([frame['relative_difference'] for frame in frames])}")
    if mean["change_correlation"] is not None:
        lines.append(f"change    correlation {_spread([frame['change_correlation'] for frame in frames])}")
    if mean["colour_difference"] is not None:
        found = _spread([frame["colour_difference"] for frame in frames])
        lines.append(f"colour    B − A over the smoke, root mean square of display values: {found}")
    for key, text in (
        ("changes", "change    ‖d* − d‖/‖d‖"),
        ("masses", "mass      Σ d*"),
        ("largest_displacement", "moved     at most, in cells:"),
    ):
        lines += [f"{text} {_pair(mean[key])}"] if None not in mean[key] else []
    before, after = mean["loss_before"], mean["loss_after"]
    if None not in (*before, *after):
        other = [key for key in _OF_THE_LOSS if key in (results["recipe"] or {})]
        beside = f" (of other scales: {', '.join(other)} differ)" if other else ""
        lines.append(f"loss      A {before[0]:.4g} → {after[0]:.4g}, B {before[1]:.4g} → {after[1]:.4g}{beside}")
    return lines


def _differences(count: int) -> str:
    return {0: "the same", 1: "1 key differs"}.get(count, f"{count} keys differ")


def _described(part: Reopened) -> str:
    count = "1 frame" if len(part.frames) == 1 else f"{len(part.frames)} frames"
    if part.record is None:
        return f"{part.path}: {count}"
    return f"{part.path}: run, {part.record.get('status', 'of unknown status')}, {count} finished"


def _provenance(found: Mapping[str, Any]) -> list[str]:
    """What differs besides the recipes; the seconds that runs took always do."""
    lines = [
        f"{key}: {_shown(pair[0])} → {_shown(pair[1])}"
        for key, pair in found.items()
        if key not in ("inputs", "files", "seconds")
    ]
    if "inputs" in found:
        lines.append("the frames of the inputs differ")
    if "files" in found:
        lines.append("other files differ, such as style pictures")
    return lines or ["same input, weights, versions and device"]


def _only(letter: str, names: Sequence[str]) -> str:
    return f"; only in {letter}: {some_of(names)}" if names else ""


def _spread(values: Sequence[float | None]) -> str:
    """The mean of some values, and their range if there are several."""
    known = [value for value in values if value is not None]
    mean = f"{sum(known) / len(known):.3g}"
    return mean if len(known) == 1 else f"{mean} ({min(known):.3g} to {max(known):.3g})"


def _pair(values: Sequence[float]) -> str:
    return f"A {values[0]:.4g}, B {values[1]:.4g}"


def _shown(value: object) -> str:
    text = "not set" if value is None else str(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"
