"""The buttons that stylize: Stylize, Bake All Markers, Resume."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import bpy

from ..problems import CannotStylizeError
from ..processes.job import Job
from ..recipes.commands import batch_command, batch_folder, resume_command, stylize_command, write_recipe
from ..recipes.plan import Part, Plan, UnreadablePlanError, new_identifier, read_plan, require_in_place, write_plan
from ..scene.results import load_result, show_original_of_lost
from ..scene.shots import shot_of
from ..scene.smoke import Smoke, note_of_library, smoke_of
from ..scene.takes import Take, frame_bounds, takes_of_markers, takes_with_smoke
from ..scene.visibility import hide_in_frames_of_results, hide_other_parts
from .kept import Kept
from .last_run import UNFINISHED, keep, require_own, run_of
from .preferences import environment_of, preferences_of
from .running import Running, RunsJob
from .subject import subject_of


class OfSmoke(RunsJob):
    """Works on the active object, which has smoke, or on the original of the active result."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """With a volume or a domain of smoke, and while nothing runs."""
        return super().poll(context) and subject_of(context.object) is not None


class TNST_MI_OT_stylize(OfSmoke, bpy.types.Operator):
    """Stylize the smoke of this object, while Blender stays usable, and show the result in place of an earlier one"""

    bl_idname = "tnst_mi.stylize"
    bl_label = "Stylize"

    def begin(self, context: bpy.types.Context) -> Running:
        """One run."""
        return _started(self, context, [Take(bounds=frame_bounds(subject_of(context.object).tnst_mi))], batch=False)


class TNST_MI_OT_bake_markers(OfSmoke, bpy.types.Operator):
    """Stylize each marker's shot: from its frame to the next marker, through its camera, in a folder of its own"""

    bl_idname = "tnst_mi.bake_markers"
    bl_label = "Bake All Markers"

    def begin(self, context: bpy.types.Context) -> Running:
        """One batch, with a run for each marker, one after the other."""
        return _started(self, context, takes_of_markers(context.scene), batch=True)


class TNST_MI_OT_resume(OfSmoke, bpy.types.Operator):
    """Go on with what was stopped, with the settings that it was started with"""

    bl_idname = "tnst_mi.resume"
    bl_label = "Resume"

    def begin(self, context: bpy.types.Context) -> Running:
        """The last run or batch of the object."""
        item = subject_of(context.object)
        program = environment_of(context)
        folder, plan = _last_plan(item)
        require_own(folder, plan, item)
        require_in_place(plan, folder)
        out = Path(plan.out)
        command = resume_command(program, out)
        if plan.is_batch:
            command = batch_command(program, Path(plan.source), [Path(recipe) for recipe in plan.recipes], out)
        return _running(item, smoke_of(item, item.tnst_mi.source), folder, plan, command)


def results_folder(item: bpy.types.Object) -> Path:
    """Where the results of an object are: as chosen, or beside the scene's file, or else beside the smoke.

    Raises:
        CannotStylizeError: the smoke has no files that it could be beside, or the scene none.
    """
    chosen = item.tnst_mi.out
    if chosen.startswith("//") and not bpy.data.filepath:
        raise CannotStylizeError(
            f"Results, {chosen}: is beside the scene's file, and the scene has not been saved: save it, or choose a "
            "folder by its whole path"
        )
    if chosen:
        return Path(bpy.path.abspath(chosen))
    name = f"{_plain(item.name)}_stylized"
    if bpy.data.filepath:
        return Path(bpy.data.filepath).parent / name
    return smoke_of(item, item.tnst_mi.source).source.parent / name


def _last_plan(item: bpy.types.Object) -> tuple[Path, Plan]:
    """The folder and the plan of the last run of an object.

    Where the object does not know it, as in a scene that was not saved since, it is in the folder for its results.
    """
    run = run_of(item)
    if run is not None:
        with suppress(UnreadablePlanError):
            return Path(run.folder), read_plan(Path(run.folder))
    folder = results_folder(item)
    return folder, read_plan(folder)


def _started(operator: OfSmoke, context: bpy.types.Context, takes: Sequence[Take], batch: bool) -> Running:
    """Write the recipes of takes, report what is to be known of them, and start their stylization."""
    item = subject_of(context.object)
    settings = item.tnst_mi
    program = environment_of(context)
    smoke = smoke_of(item, settings.source)
    folder = results_folder(item)
    out = folder / (f"markers_{settings.quality}" if batch else settings.quality)
    # What cannot be read, as of an earlier version, is replaced.
    with suppress(UnreadablePlanError):
        require_own(folder, read_plan(folder), item)
    inputs, before = _inputs_of(out), folder / f".{out.name}_inputs.before"
    # Those of the run before come back if this one is refused: it can be resumed then.
    if inputs.exists():
        shutil.rmtree(before, ignore_errors=True)
        inputs.rename(before)
    try:
        plan, command = _prepared(context, item, smoke, takes, program, out, batch)
    except BaseException as error:
        shutil.rmtree(inputs, ignore_errors=True)
        if before.exists():
            before.rename(inputs)
        if isinstance(error, OSError):
            raise CannotStylizeError(
                f"Results, {folder}: cannot be written ({error.strerror or error}); choose another folder"
            ) from error
        raise
    shutil.rmtree(before, ignore_errors=True)
    for note in plan.notes:
        operator.report({"WARNING"}, note)
    return _running(item, smoke, folder, plan, command)


def _prepared(
    context: bpy.types.Context,
    item: bpy.types.Object,
    smoke: Smoke,
    takes: Sequence[Take],
    program: Path,
    out: Path,
    batch: bool,
) -> tuple[Plan, list[str]]:
    """Write the recipes of takes and their plan, beside the folder `out` of results; and the command of `program`."""
    settings, inputs = item.tnst_mi, _inputs_of(out)
    notes = note_of_library(item)
    if batch:
        takes, skipped = takes_with_smoke(smoke, takes)
        notes += skipped
    names = [f"{number:02}_{_plain(take.name)}" if batch else "recipe" for number, take in enumerate(takes, 1)]
    recipes = [inputs / f"{name}.toml" for name in names]
    for take, name, recipe in zip(takes, names, recipes, strict=True):
        shot, of_shot = shot_of(context, settings, smoke, take, inputs / name, preferences_of(context).weights)
        notes += of_shot
        write_recipe(shot, recipe)
    if batch:
        parts = tuple(
            Part(take.name, str(batch_folder(out, recipe, smoke.source)))
            for take, recipe in zip(takes, recipes, strict=True)
        )
        command = batch_command(program, smoke.source, recipes, out, overwrite=True)
    else:
        parts = (Part("", str(out)),)
        command = stylize_command(program, smoke.source, recipes[0], out, overwrite=out.exists())
    plan = Plan(
        item=item.name,
        source=str(smoke.source),
        out=str(out),
        recipes=tuple(map(str, recipes)) if batch else (),
        parts=parts,
        identifier=new_identifier(),
        scene=bpy.data.filepath,
        notes=notes,
    )
    write_plan(plan, out.parent)
    return plan, command


def _inputs_of(out: Path) -> Path:
    """Where the recipes, cameras and masks are of the results in a folder."""
    return out.with_name(f"{out.name}_inputs")


def _running(item: bpy.types.Object, smoke: Smoke, folder: Path, plan: Plan, command: list[str]) -> Running:
    """Start a command, whose plan is in a folder, and whose results are shown when it has ended."""
    out = Path(plan.out)
    job = Job(command, out.parent / f"{out.name}.log")
    keep(item, plan, folder, UNFINISHED)
    try:
        job.start()
    except OSError:
        keep(item, plan, folder, "Not started: press Stylize")
        raise
    kept = Kept(item)

    def done() -> str:
        original = kept.find()
        if original is None:
            raise CannotStylizeError(f"{kept.name} was deleted meanwhile; its results are in {out}")
        shown = [load_result(original, smoke, part, original.tnst_mi.place) for part in plan.parts]
        hide_other_parts(original, [part.name for part in plan.parts])
        notes = plan.notes + hide_in_frames_of_results(original, smoke, original.tnst_mi.place)
        keep(original, plan, folder, "\n".join(notes))
        return "; ".join((f"Stylized: {', '.join(map(_in_words, shown))}", *notes))

    def stopped(problem: str | None) -> None:
        original = kept.find()
        if original is None:
            return
        show_original_of_lost(original)
        if problem is not None:
            keep(original, plan, folder, problem, job.log)
        elif now.progress.fraction is None:
            keep(original, plan, folder, "Stopped before its first step: press Stylize")
        else:
            keep(original, plan, folder, f"Stopped at {now.progress.doing}: Resume goes on")

    now = Running(job, f"Stylizing {item.name}", done, kept, stopped)
    return now


def _in_words(result: bpy.types.Object) -> str:
    """A result and its frames."""
    volume = result.data
    if not volume.is_sequence:
        return result.name
    return f"{result.name} (frames {volume.frame_start} to {volume.frame_start + volume.frame_duration - 1})"


def _plain(name: str) -> str:
    """A name as that of a file."""
    return re.sub(r"[^\w.-]+", "_", name).strip("._") or "shot"


_CLASSES = (TNST_MI_OT_stylize, TNST_MI_OT_bake_markers, TNST_MI_OT_resume)

register, unregister = bpy.utils.register_classes_factory(_CLASSES)
