"""What a run is asked to do: the checks that need neither torch nor what is in the frames.

They take a moment, so mistakes are answered before anything large is imported or read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.machine.disk import require_writable
from tnst_mi.machine.lock import require_unlocked
from tnst_mi.recipe.combinations import (
    require_averageable,
    require_colour_driven,
    require_one_transport,
    require_weight,
)
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.resources import expanded
from tnst_mi.run.folder import frame_names, holds_run
from tnst_mi.run.inputs import Frames, sequence_of


@dataclass(frozen=True)
class FromModel:
    """A trained network, and how many iterations refine what it finds.

    Attributes:
        path: of the file of the network, or the name of one that ships with the package.
        refine: iterations in the finest octave, 0 or more.
    """

    path: Path
    refine: int = 0


def model_to_begin_with(path: str | Path | None, refine: int, start_from: str | Path | None) -> FromModel | None:
    """What a run begins with that was asked for a model or not.

    Raises:
        InputError: it was asked for more than one thing to begin with, or to refine nothing.
    """
    if path is None and refine:
        raise InputError(f"refine = {refine}: goes on from what a model gives; give a model too")
    if path is not None and start_from is not None:
        raise InputError(f"model = {path}, from = {start_from}: expected only one of them to begin with")
    return None if path is None else FromModel(expanded(Path(path)), refine)


def requested_frames(
    frames: Frames,
    recipe: Recipe,
    out: Path | None,
    *,
    resume: bool = False,
    overwrite: bool = False,
    start_from: Path | None = None,
) -> Sequence[Frame]:
    """The frames of a run; those in files are not read yet.

    Args:
        frames: a file (one frame) or folder (a sequence), a frame, several, or a density grid (D, H, W).
        recipe: the recipe.
        out: the folder of the results, or None.
        resume: continue the run in `out` where it stopped.
        overwrite: replace the run in `out`.
        start_from: the folder of an earlier run to go on from, or None.

    Raises:
        InputError: the recipe has no goal, or keys that do not go together; results cannot be written to `out`, or
            another run writes there; or there are no such frames.
    """
    if not (recipe.style or recipe.semantic or recipe.tag or recipe.content or recipe.match or recipe.target):
        raise InputError(
            "nothing to stylize towards: give --style, --semantic, --tag, --content or --match, or a recipe"
        )
    require_averageable(recipe)
    require_one_transport(recipe)
    require_colour_driven(recipe)
    require_weight(recipe)
    if resume and overwrite:
        raise InputError("--resume and --overwrite: expected only one of them")
    if resume and start_from is not None:
        raise InputError("--resume and --from: expected only one of them; a run that is resumed knows where it began")
    if out is not None and start_from is not None and out.resolve() == start_from.resolve():
        raise InputError(f"{out}: is --from and --out, expected another folder for the results")
    if out is not None:
        source = Path(frames) if isinstance(frames, str | Path) else None
        require_unlocked(out)
        require_writable(out, source, None if resume or overwrite else _remedy(out))
        if overwrite:
            frame_names(out)  # refuses anything but a run
    return sequence_of(frames, recipe)


def _remedy(out: Path) -> str:
    if holds_run(out):
        return "continue its run with --resume, or replace it with --overwrite"
    return "give an empty or new folder"
