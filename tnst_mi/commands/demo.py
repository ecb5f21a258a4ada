"""`tnst-mi demo`: the main job on the frame that ships with the package."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tnst_mi.commands.base import Command, Folder
from tnst_mi.errors import InputError
from tnst_mi.recipe import Recipe


@dataclass(kw_only=True)
class Demo(Command):
    """Stylize the bundled frame with the bundled recipe; needs nothing else."""

    out: Folder = Path("tnst_mi-demo")
    """Folder for the results; those of an earlier demo in it are replaced."""

    def run(self) -> int:
        """Stylize the scene suzanne and say where the pictures are."""
        from tnst_mi.commands.stylize import run_job
        from tnst_mi.io import open_frames
        from tnst_mi.job import Job
        from tnst_mi.outputs import frame_names, holds_run

        scene = scene_folder("suzanne")
        recipe = Recipe.from_toml(scene / "recipe.toml")
        earlier = holds_run(self.out)
        if earlier and set(frame_names(self.out)) != {file.stem for file in open_frames(scene).files}:
            raise InputError(f"{self.out}: holds a run that is no demo; give another folder")
        code = run_job(Job(scene, recipe, self.out, overwrite=earlier))
        for picture in sorted((self.out / "images").glob("*.png")):
            print(f"picture   {picture}")
        return code


def scene_folder(name: str) -> Path:
    """The folder of a bundled scene, in the installed package or in the checkout."""
    package = Path(__file__).resolve().parents[1]
    for scenes in (package / "scenes", package.parent / "scenes"):
        if (scenes / name / "recipe.toml").is_file():
            return scenes / name
    raise InputError(f"{package / 'scenes' / name}: the bundled scene is missing; install the package again")
