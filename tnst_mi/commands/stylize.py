"""`tnst-mi stylize`: a file or folder of smoke in, stylized smoke and pictures out."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from tnst_mi.commands.base import Command, Folder, given, recipe_flags
from tnst_mi.recipe.recipe import Goals, Method, Recipe, Resources

if TYPE_CHECKING:
    from tnst_mi.run.job import Job, StylizedFrame

GoalFlags = recipe_flags(Goals.__annotations__)
MethodFlags = recipe_flags(Method.__annotations__)
ResourceFlags = recipe_flags(Resources.__annotations__)


@dataclass(kw_only=True)
class Stylize(Command):
    """Stylize a density file, or a folder of numbered ones, towards pictures, features or classes.

    Values come from the defaults, then from the recipe file, then from the flags.
    """

    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="INPUT")]
    """Density file (one frame) or folder (a sequence)."""
    out: Folder
    """New or empty folder for the results."""
    recipe: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Recipe file (TOML); its keys are the flags below."""
    resume: bool = False
    """Continue the run in --out where it stopped, however it did."""
    overwrite: bool = False
    """Replace the run in --out."""
    goals: GoalFlags = field(default_factory=GoalFlags)
    """What to stylize towards."""
    method: MethodFlags = field(default_factory=MethodFlags)
    """How to get there."""
    resources: ResourceFlags = field(default_factory=ResourceFlags)
    """What to read, compute with and write."""

    def run(self) -> int:
        """Stylize, and report every frame."""
        from tnst_mi.run.job import Job

        recipe = Recipe() if self.recipe is None else Recipe.from_toml(self.recipe)
        for flags in (self.goals, self.method, self.resources):
            recipe = recipe.updated_by_flags(given(flags))
        return run_job(Job(self.input, recipe, self.out, resume=self.resume, overwrite=self.overwrite))


def run_job(job: Job) -> int:
    """Run a job that writes, reporting every frame on stdout; 3 if it was interrupted."""
    from tqdm import tqdm

    for frame in job.run():
        # tqdm.write keeps the lines apart from the progress bar.
        tqdm.write(summary(frame), file=sys.stdout)
    print(f"results   {job.out}")
    if "sequence" in job.record:
        print(sequence_summary(job.record["sequence"]))
    if job.record["status"] == "interrupted":
        print(f"tnst-mi: interrupted; --resume continues the run in {job.out} where it stopped", file=sys.stderr)
        return 3
    return 0


def sequence_summary(sequence: dict[str, Any]) -> str:
    """One line on a sequence: how steady it is, with what was reached."""
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
