"""`tnst-mi stylize`: a file or folder of smoke in, stylized smoke and pictures out."""

from __future__ import annotations

import sys
from typing import Any

from tqdm import tqdm

from tnst_mi.commands.arguments import StylizeArguments
from tnst_mi.commands.base import given
from tnst_mi.errors import StoppedError
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.job import Run, StylizedFrame
from tnst_mi.run.prepare import prepare


def run(arguments: StylizeArguments) -> int:
    """Stylize, and report every frame."""
    recipe = Recipe() if arguments.recipe is None else Recipe.from_toml(arguments.recipe)
    for flags in (arguments.goals, arguments.method, arguments.resources, arguments.reading):
        recipe = recipe.updated_by_flags(given(flags))
    resume, overwrite = arguments.resume, arguments.overwrite
    try:
        prepared = prepare(arguments.input, recipe, arguments.out, resume=resume, overwrite=overwrite, progress=True)
    except KeyboardInterrupt:
        raise StoppedError(
            "interrupted before the run began: nothing has changed, the same command begins anew"
        ) from None
    return reported(Run(prepared))


def reported(frames: Run, remedy: str = "--resume continues the run in {out} where it stopped") -> int:
    """Iterate over a run, which writes its results, and report every frame on stdout; 3 if it was interrupted."""
    out, record = frames.prepared.out, frames.record
    for frame in frames:
        # tqdm.write keeps the lines apart from the progress bar.
        tqdm.write(summary(frame), file=sys.stdout)
    if record["frames"]:
        print(f"results   {out}")
    if "sequence" in record:
        print(sequence_summary(record["sequence"]))
    if record["status"] == "interrupted":
        print(f"tnst-mi: interrupted; {remedy.format(out=out)}", file=sys.stderr)
        return 3
    return 0


def sequence_summary(sequence: dict[str, Any]) -> str:
    """One line on a sequence: its flicker, loss and change."""
    parts = [f"flicker {_number(sequence['flicker'])} at window {sequence['window']}"]
    parts.append(f"mean loss {_number(sequence['loss_before'])} → {_number(sequence['loss_after'])}")
    parts.append(f"relative change {_number(sequence['relative_change'])}")
    return f"sequence  {', '.join(parts)}"


def _number(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.3g}"


def summary(frame: StylizedFrame) -> str:
    """One line on a frame: how the loss and the mass changed and how far the smoke moved."""
    record = frame.record
    parts = []
    if record["losses"]:
        last = record["losses"][-1]
        parts.append(f"loss {last[0]:.4g} → {last[-1]:.4g} in the last octave")
    parts.append(f"mass {record['mass_before']:.5g} → {record['mass_after']:.5g}")
    parts.append(f"largest displacement {record['largest_displacement']:.3g} cells")
    if record["note"]:
        parts.append(record["note"])
    return f"{record['name']}: {', '.join(parts)}"
