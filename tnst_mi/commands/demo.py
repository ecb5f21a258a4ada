"""`tnst-mi demo`: the main job on the frame that ships with the package."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tnst_mi.commands.base import Command, Folder
from tnst_mi.errors import InputError
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.resources import scene_file


@dataclass(kw_only=True)
class Demo(Command):
    """Stylize the bundled frame with the bundled recipe; needs nothing else."""

    out: Folder = Path("tnst_mi-demo")
    """Folder for the results; those of an earlier demo in it are replaced."""

    def run(self) -> int:
        """Stylize the scene suzanne and say where the pictures are."""
        from tnst_mi.commands.stylize import run_job
        from tnst_mi.io import open_frames
        from tnst_mi.run.folder import frame_names, holds_run
        from tnst_mi.run.job import Job

        scene = scene_file("suzanne/recipe.toml").parent
        recipe = Recipe.from_toml(scene / "recipe.toml")
        earlier = holds_run(self.out)
        if earlier and set(frame_names(self.out)) != {file.stem for file in open_frames(scene).files}:
            raise InputError(f"{self.out}: holds a run that is no demo; give another folder")
        code = run_job(Job(scene, recipe, self.out, overwrite=earlier))
        for picture in sorted((self.out / "images").glob("*.png")):
            print(f"picture   {picture}")
        return code
