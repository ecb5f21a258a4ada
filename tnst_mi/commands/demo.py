"""`tnst-mi demo`: the main job on the frame that ships with the package."""

from __future__ import annotations

from tnst_mi.commands.run_arguments import DemoArguments
from tnst_mi.commands.stylize import from_model, job, prepare, reported
from tnst_mi.errors import InputError
from tnst_mi.io import open_frames
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.resources import scene_file
from tnst_mi.run.folder import frame_names, holds_run
from tnst_mi.run.request import model_to_begin_with, requested_frames

#: What `--fast` takes in place of an optimisation.
_MODEL = "flames"


def run(arguments: DemoArguments) -> int:
    """Stylize the scene suzanne and say where the pictures are."""
    out = arguments.out
    scene = scene_file("suzanne/recipe.toml").parent
    model = model_to_begin_with(_MODEL, 0, None) if arguments.fast else None
    recipe = Recipe.from_toml(scene / "recipe.toml") if model is None else from_model.recipe_of_model(model.path)
    earlier = holds_run(out)
    if earlier and set(frame_names(out)) != {file.stem for file in open_frames(scene).files}:
        raise InputError(f"{out}: holds a run that is no demo; give another folder")
    requested_frames(scene, recipe, out, overwrite=earlier)
    prepared = prepare.prepare(scene, recipe, out, overwrite=earlier, model=model, progress=True)
    code = reported(job.Run(prepared), "the same command begins anew")
    for picture in sorted((out / "images").glob("*.png")):
        print(f"picture   {picture}")
    return code
