"""`tnst_mi.stylize`: frames and a recipe in, stylized frames out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.frame import Frame
from tnst_mi.machine.backend import own_variant
from tnst_mi.machine.lazy import LazyModule
from tnst_mi.machine.notebook_display import NotebookDisplay
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.resources import expanded
from tnst_mi.run.carry import carried
from tnst_mi.run.cluster_address import Cluster, cluster_of, processes_of, require_reachable
from tnst_mi.run.colour_record import colour_flicker
from tnst_mi.run.inputs import Frames
from tnst_mi.run.job import Run, StylizedFrame
from tnst_mi.run.prepare import prepare
from tnst_mi.run.record import sequence_record
from tnst_mi.run.request import FromModel, model_to_begin_with
from tnst_mi.run.stored_arrays import StoredArrays, StoredGrids

#: An optional part, which builds on what is here: loaded where it is asked for.
cluster_run: Any = LazyModule("tnst_mi.cluster.run")


@dataclass(frozen=True)
class Result(NotebookDisplay):
    """The result of a stylization, one entry per frame. Arrays that were written to files are read on access.

    A notebook shows the main views before and after, and what became of loss and mass.

    Attributes:
        densities: stylized densities, (D, H, W) float32, blended as the recipe says.
        velocities: the velocities v* that transport the smoke, (D, H, W, 3) float32 in cells per frame; 0
            if the recipe changes densities directly.
        grids: the other grids of each frame by name, such as temperature, carried with the smoke, in their own types;
            and the simulation's velocity, as "velocity", (D, H, W, 3) in cells per frame, where the frame has one.
        frames: the input frames.
        history: one dict per iteration: octave, iteration, loss, terms, seconds.
        run: the contents of run.json.
        out: the folder of the results, or None.
        recipe: as it was run, with absolute paths.
    """

    densities: Sequence[np.ndarray]
    velocities: Sequence[np.ndarray]
    grids: Sequence[Mapping[str, np.ndarray]]
    frames: Sequence[Frame]
    history: list[list[dict[str, Any]]]
    run: dict[str, Any]
    out: Path | None
    recipe: Recipe


def stylize(
    frames: Frames,
    recipe: Recipe | str | Path | Mapping[str, Any],
    out: str | Path | None = None,
    progress: bool = True,
    start_from: str | Path | None = None,
    cluster: str | None = None,
    model: str | Path | None = None,
    refine: int = 0,
) -> Result:
    """Stylize one frame or a sequence.

    Ctrl-C ends it early; a single frame is then returned in its current state. Without `out`, the state of all frames
    of a sequence is held in memory; with it, memory is bounded by the window. Of several threads one stylizes at a
    time. The variant that was active before is put back.

    Args:
        frames: a file (one frame) or folder (a sequence), a frame, several, or a density grid (D, H, W).
        recipe: a recipe, the path of a recipe file, or a dict of recipe keys.
        out: an empty or new folder for the results; None to write nothing.
        progress: show a progress bar on stderr.
        start_from: the folder of an earlier run of the same frames and goals, such as a draft, to go on from
            (docs/preview.md); None to begin anew.
        cluster: what has the work done by several processes, such as "local:2", for frames in files with `out`
            (docs/cluster.md); None for this process alone. Scripts then need `if __name__ == "__main__":`.
        model: a trained network whose potentials are taken in place of an optimisation (docs/realtime.md), a file or
            "flames" or "flower"; None to optimise from the beginning. Its own recipe is
            `tnst_mi.recipe_of_model(model)`.
        refine: iterations in the finest octave that go on from these, 0 or more.

    Raises:
        InputError: the frames, the recipe, the weights, `out`, `start_from`, `model` or `cluster` cannot be used, and
            nothing is written; or a frame has changed since the run began.
        StoppedError: nothing more can be written to `out`; the run can be resumed there.

    Example:
        >>> import numpy as np, tnst_mi
        >>> density = np.zeros((8, 12, 8), np.float32)
        >>> density[2:6, 3:9, 2:6] = 0.5
        >>> recipe = {"style": ["spirals"], "octaves": 1, "iterations": 2, "views": 1, "weights": "patterns"}
        >>> result = tnst_mi.stylize(density, recipe, progress=False)
        >>> result.densities[0].shape, result.velocities[0].shape
        ((8, 12, 8), (8, 12, 8, 3))
        >>> [entry["iteration"] for entry in result.history[0]]
        [0, 1]
    """
    if isinstance(recipe, str | Path):
        recipe = Recipe.from_toml(recipe)
    elif isinstance(recipe, Mapping):
        recipe = Recipe.from_dict(recipe)
    elif not isinstance(recipe, Recipe):
        raise InputError(f"recipe: is a {type(recipe).__name__}, expected a recipe, its path, or a dict of its keys")
    began = model_to_begin_with(model, refine, start_from)
    where = None if cluster is None else cluster_of(cluster)
    if where is not None and (out is None or not isinstance(frames, str | Path)):
        raise InputError(
            f"cluster = {cluster!r}: its processes read frames from files and share the folder out; give both"
        )
    if where is not None and out is not None and isinstance(frames, str | Path):
        require_reachable(where)
        # Its processes may have begun in other folders.
        frames, out = expanded(Path(frames)).absolute(), expanded(Path(out)).absolute()
    with own_variant():
        return _stylized(frames, recipe, out, progress, None if start_from is None else Path(start_from), where, began)


def _stylized(
    frames: Frames,
    recipe: Recipe,
    out: str | Path | None,
    progress: bool,
    start_from: Path | None,
    cluster: Cluster | None,
    model: FromModel | None,
) -> Result:
    prepared = prepare(
        frames,
        recipe,
        out,
        progress=progress,
        start_from=start_from,
        model=model,
        processes=processes_of(cluster),
    )
    frames_done: Run = (
        Run(prepared, progress) if cluster is None else cluster_run.ClusterRun(prepared, cluster, progress)
    )
    densities: Sequence[np.ndarray] = []
    velocities: Sequence[np.ndarray] = []
    grids: Sequence[Mapping[str, np.ndarray]] = []
    history = []
    record = frames_done.record
    with closing(frames_done):
        for frame in frames_done:
            history.append(frame.history)
            if isinstance(frame, StylizedFrame) and prepared.out is None:
                densities.append(frame.stylized.density)
                velocities.append(frame.stylized.velocity)
                grids.append(carried(frame.source, frame.stylized, prepared.recipe.carry).in_memory())
    names = [frame_record["name"] for frame_record in record["frames"]]
    if prepared.out is not None:
        densities = StoredArrays(prepared.out, "density", names, prepared.suffix, prepared.frames)
        velocities = StoredArrays(prepared.out, "velocity", names, prepared.suffix, prepared.frames)
        grids = StoredGrids(prepared.out, names, prepared.suffix, prepared.frames)
    elif len(densities) == len(prepared.wanted) > 1:
        moving = (prepared.moving[index] for index in prepared.wanted)
        record["sequence"] = sequence_record(prepared.recipe, moving, densities, record["frames"])
        record["sequence"] |= colour_flicker(prepared, densities, grids)
    frames = prepared.frames_named(names)
    return Result(densities, velocities, grids, frames, history, record, prepared.out, prepared.recipe)
