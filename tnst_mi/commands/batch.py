"""`tnst-mi batch`: every recipe on every input, one run after the other, and a page of the results."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tnst_mi.batch.jobs import (
    FAILED,
    INTERRUPTED,
    RUNNING,
    Job,
    RunOutcome,
    jobs_of,
    outcome_of,
    require_batch_folder,
    write_record,
)
from tnst_mi.batch.page import write_page
from tnst_mi.commands.base import given, say
from tnst_mi.commands.run_arguments import BatchArguments
from tnst_mi.commands.stylize import reported, run_of
from tnst_mi.errors import InputError, StoppedError
from tnst_mi.io.atomic import make_folder
from tnst_mi.machine.lazy import LazyModule
from tnst_mi.machine.lock import locked
from tnst_mi.machine.terminal import duration, one_line
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.resources import expanded
from tnst_mi.run.cluster_address import cluster_of, processes_of, require_reachable
from tnst_mi.run.folder import holds_run
from tnst_mi.run.request import requested_frames

if TYPE_CHECKING:
    from tnst_mi.run import prepare
else:
    # It imports torch, and most mistakes are found without it.
    prepare = LazyModule("tnst_mi.run.prepare")


def run(arguments: BatchArguments) -> int:
    """Do the runs that are left; 1 if some could not be done, 3 if Ctrl-C ended the batch."""
    out = expanded(arguments.out)
    recipes = {file: _recipe(file, arguments) for file in arguments.files if file.suffix == ".toml"}
    jobs = jobs_of(recipes, [file for file in arguments.files if file.suffix != ".toml"], out)
    require_batch_folder(out)
    if arguments.cluster is not None:
        require_reachable(cluster_of(arguments.cluster))
        # Its processes may have begun in other folders.
        jobs = [replace(each, source=each.source.absolute(), out=each.out.absolute()) for each in jobs]
        out = out.absolute()
    # All recipes and inputs are looked at before the first run, which may take hours.
    for each in jobs:
        requested_frames(
            each.source, each.recipe, each.out, resume=_begun(each, arguments), overwrite=arguments.overwrite
        )
    make_folder(out)
    with locked(out):
        return _all_of(jobs, out, arguments)


def _recipe(file: Path, arguments: BatchArguments) -> Recipe:
    recipe = Recipe.from_toml(file)
    for flags in (arguments.method, arguments.colouring, arguments.resources, arguments.reading):
        recipe = recipe.updated_by_flags(given(flags))
    return recipe


def _all_of(jobs: list[Job], out: Path, arguments: BatchArguments) -> int:
    outcomes = [outcome_of(each, out) for each in jobs]
    since = time.monotonic()

    def written(number: int, outcome: RunOutcome) -> None:
        outcomes[number] = outcome
        write_record(out, jobs, outcomes)
        write_page(out / "index.html", jobs, outcomes)

    for number, each in enumerate(jobs):
        left = (time.monotonic() - since) / number * (len(jobs) - number) if number else None
        about = "" if left is None else f", about {duration(left)} left"
        say([f"batch: run {number + 1} of {len(jobs)}{about}: {each.recipe_name} on {each.input_name}"])
        written(number, RunOutcome(RUNNING))
        try:
            interrupted = _one(each, arguments) == 3
        except InputError as error:
            say([one_line(f"tnst-mi: {error}")])
            written(number, outcome_of(each, out, one_line(str(error))))
            continue
        except (KeyboardInterrupt, StoppedError):
            written(number, outcome_of(each, out))
            raise
        written(number, outcome_of(each, out))
        if interrupted:
            break
    print(f"page      {out / 'index.html'}")
    failed = [each for each, outcome in zip(jobs, outcomes, strict=True) if outcome.status == FAILED]
    if failed:
        names = ", ".join(f"{each.recipe_name} on {each.input_name}" for each in failed)
        print(f"tnst-mi: {len(failed)} of {len(jobs)} runs could not be done: {names}", file=sys.stderr)
    return 3 if any(outcome.status == INTERRUPTED for outcome in outcomes) else int(bool(failed))


def _one(each: Job, arguments: BatchArguments) -> int:
    """A run, from where it stopped; nothing if it has been done. 3 if it was interrupted."""
    cluster = None if arguments.cluster is None else cluster_of(arguments.cluster)
    prepared = prepare.prepare(
        each.source,
        each.recipe,
        each.out,
        resume=_begun(each, arguments),
        overwrite=arguments.overwrite,
        processes=processes_of(cluster),
        progress=True,
    )
    return reported(run_of(prepared, cluster), "the same command goes on")


def _begun(each: Job, arguments: BatchArguments) -> bool:
    return not arguments.overwrite and holds_run(each.out)
