"""`tnst-mi stylize`: a file or folder of smoke in, stylized smoke and pictures out."""

from __future__ import annotations

import sys
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from tnst_mi.commands.base import given, say
from tnst_mi.commands.run_arguments import StylizeArguments
from tnst_mi.errors import InputError, StoppedError
from tnst_mi.machine.lazy import LazyModule
from tnst_mi.recipe.quality import following
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.run.cluster_address import Cluster, cluster_of, processes_of, require_reachable
from tnst_mi.run.folder import input_of_run
from tnst_mi.run.request import model_to_begin_with, requested_frames
from tnst_mi.run.resuming import recipe_of_run, require_begun, require_run

if TYPE_CHECKING:
    from tnst_mi.cluster import run as cluster_run
    from tnst_mi.run import from_model, job, prepare
    from tnst_mi.run import record as run_record
else:
    # They import torch, and most mistakes are found without it.
    job, prepare = LazyModule("tnst_mi.run.job"), LazyModule("tnst_mi.run.prepare")
    from_model = LazyModule("tnst_mi.run.from_model")
    run_record, cluster_run = LazyModule("tnst_mi.run.record"), LazyModule("tnst_mi.cluster.run")

#: Share of a frame's smoke whose loss or gain is remarked upon, and by how much this may differ between frames.
_MASS_REMARKED, _DRIFT_REMARKED = 0.05, 0.03

#: Share of the smoke where a step has folded space from which on it looks torn.
_FOLDED_REMARKED = 0.4

#: Relative change of the density below which nobody sees one, flickering or not.
_TOO_LITTLE = 0.01


def run(arguments: StylizeArguments) -> int:
    """Stylize, and report every frame."""
    source, recipe = _input_and_recipe(arguments)
    for flags in (arguments.goals, arguments.method, arguments.colouring, arguments.resources, arguments.reading):
        recipe = recipe.updated_by_flags(given(flags))
    out, resume, overwrite, begin = arguments.out, arguments.resume, arguments.overwrite, arguments.start_from
    if arguments.unshared and arguments.cluster is None:
        raise InputError("--unshared: says how processes of a cluster are reached; give --cluster too")
    cluster = None if arguments.cluster is None else cluster_of(arguments.cluster, not arguments.unshared)
    if cluster is not None:
        require_reachable(cluster)
        # Its processes may have begun in other folders.
        source, out = source.absolute(), out.absolute()
    model = model_to_begin_with(arguments.model, arguments.refine, begin)
    try:
        requested_frames(source, recipe, out, resume=resume, overwrite=overwrite, start_from=begin)
        prepared = prepare.prepare(
            source,
            recipe,
            out,
            resume=resume,
            overwrite=overwrite,
            start_from=begin,
            model=model,
            processes=processes_of(cluster),
            progress=True,
        )
    except KeyboardInterrupt:
        raise StoppedError(
            "interrupted before the run began: nothing has changed, the same command begins anew"
        ) from None
    return reported(run_of(prepared, cluster))


def run_of(prepared: prepare.Prepared, cluster: Cluster | None) -> job.Run:
    """The run that was prepared, in this process or on a cluster."""
    return job.Run(prepared) if cluster is None else cluster_run.ClusterRun(prepared, cluster)


def _input_and_recipe(arguments: StylizeArguments) -> tuple[Path, Recipe]:
    """What to stylize, and how before the flags; a run to be resumed, or to go on from, has both in its folder.

    Raises:
        InputError: the recipe cannot be used, or there is no INPUT.
    """
    resumed = arguments.resume and not arguments.overwrite and require_begun(arguments.out)
    source, earlier = arguments.input, arguments.out if resumed else arguments.start_from
    if arguments.start_from is not None:
        require_run(arguments.start_from)
    if source is None and earlier is not None:
        source = input_of_run(earlier)
    if source is None and arguments.resume:
        raise InputError(f"{arguments.out}: its run was ended before it began; give its INPUT too to begin it")
    if arguments.resume and not resumed and not arguments.overwrite:
        say([f"note: {arguments.out}: its run was ended before it began, so it begins now"])
    if source is None:
        raise InputError("stylize: expected INPUT: a density file, a folder of numbered ones, or a pattern")
    if arguments.recipe is not None or earlier is None:
        recipe = Recipe() if arguments.model is None else from_model.recipe_of_model(arguments.model)
        return source, recipe if arguments.recipe is None else recipe.updated_by_file(arguments.recipe)
    recipe = recipe_of_run(earlier)
    return source, recipe if resumed else recipe.updated({"quality": following(recipe)}, "--from: ", Path.cwd())


def reported(frames: job.Run, remedy: str = "--resume continues the run in {out} where it stopped") -> int:
    """Iterate over a run, which writes its results, and report every frame on stdout; 3 if it was interrupted."""
    out, record = frames.prepared.out, frames.record
    with closing(frames):
        for frame in frames:
            # tqdm.write keeps the lines apart from the progress bar.
            tqdm.write(summary(frame), file=sys.stdout)
    if record["frames"]:
        print(f"results   {out}")
    keeping = "" if frames.prepared.recipe.transport == "flow" else 'transport = "flow" with lam = 0,'
    if (torn := max((of_frame.get("folded") or 0.0 for of_frame in record["frames"]), default=0.0)) > _FOLDED_REMARKED:
        print(
            f"torn      {torn:.0%} of the smoke of a frame is where it has been folded, with hard edges or finer than "
            f"cells; {keeping} a larger motif_size or a reach would keep it smoke (docs/motifs.md)"
        )
    if "sequence" in record:
        print(sequence_summary(record["sequence"]))
    if remark := mass_remark(frames.prepared.recipe, record["frames"]):
        print(f"mass      {remark}")
    if "sequence" in record and (drift := record["sequence"].get("mass_drift") or 0.0) > _DRIFT_REMARKED:
        print(f"mass      drifts by {drift:.1%} over the frames, as their brightness will (docs/motifs.md)")
    if record["status"] == "interrupted":
        print(f"tnst-mi: interrupted; {remedy.format(out=out)}", file=sys.stderr)
        return 3
    return 0


def sequence_summary(sequence: dict[str, Any]) -> str:
    """One line on a sequence: its flicker, loss and change."""
    change = sequence["relative_change"]
    if change is not None and change < _TOO_LITTLE:
        parts = ["flicker: too little changed to measure it"]
    else:
        parts = [f"flicker {_number(sequence['flicker'])} at window {sequence['window']}"]
    if sequence.get("colour_flicker") is not None:
        parts.append(f"of colours {sequence['colour_flicker']:.3g}")
    parts.append(f"mean loss in the fixed views {_number(sequence['loss_before'])} → {_number(sequence['loss_after'])}")
    parts.append(f"relative change {_number(change)}")
    return f"sequence  {', '.join(parts)}"


def mass_remark(recipe: Recipe, records: list[dict[str, Any]]) -> str | None:
    """What to say where frames have less or more smoke than before, and what would keep it."""
    with_smoke = [record for record in records if record["mass_before"] > 0]
    changed = [record for record in with_smoke if abs(run_record.mass_change(record) or 0.0) > _MASS_REMARKED]
    if not changed or recipe.parameterisation != "transport":
        return None
    worst = max(changed, key=lambda record: abs(run_record.mass_change(record) or 0.0))
    by = run_record.mass_change(worst) or 0.0
    others = f", and {len(changed) - 1} others too" if len(changed) > 1 else ""
    happened = f"{'lost' if by < 0 else 'gained'} {abs(by):.1%} of its smoke{others}"
    keys = [] if recipe.transport == "flow" else ['transport = "flow"']
    keys += [] if recipe.steps == 1 else ["steps = 1"]
    keys += ["lam = 0"] if any(recipe.at(record["number"]).lam > 0 for record in changed) else []
    # Along a flow without divergence, smoke can still leave the grid, or be folded more finely than its cells.
    remedy = " and ".join(keys) if keys else "a lower eta or strength, or more room around the smoke,"
    return f"{worst['name']} {happened}; {remedy} would keep more of it (docs/transport.md)"


def _number(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.3g}"


def summary(frame: job.FinishedFrame) -> str:
    """One line on a frame: how the loss and the mass changed and how far the smoke moved."""
    record = frame.record
    parts = []
    if record["losses"]:
        last = record["losses"][-1]
        parts.append(f"scaled loss {last[0]:.4g} → {last[-1]:.4g} in the last octave")
    by = run_record.mass_change(record)
    change = "" if by is None else f" ({by:+.1%})"
    parts.append(f"mass {record['mass_before']:.5g} → {record['mass_after']:.5g}{change}")
    parts.append(f"largest displacement {record['largest_displacement']:.3g} cells")
    for name, distance in record.get("palette_distances", {}).items():
        parts.append(f"{name} {distance['before']:.3g} → {distance['after']:.3g}")
    if record["note"]:
        parts.append(record["note"])
    return f"{record['name']}: {', '.join(parts)}"
