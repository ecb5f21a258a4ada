"""`--model FILE`: a run that begins with what a trained network finds in one pass, and refines that, or leaves it so.

The potentials are those of the finest octave, so a run with them enters that one alone. Without iterations it is done;
those that refine are the last ones of the recipe.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.density_unit import scaled
from tnst_mi.fields.grid import Octave
from tnst_mi.fields.resampling import resample_density
from tnst_mi.frame import Frame
from tnst_mi.optimisation.parameterisation import Fields, times
from tnst_mi.optimisation.plan import FramePlan, Plan
from tnst_mi.optimisation.start import Start
from tnst_mi.realtime.model import Model, read_model, shipped_models
from tnst_mi.realtime.prediction import predicted_fields
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.region_keys import GOALS
from tnst_mi.regions.octave_masks import border_of, octave_mask, union_of
from tnst_mi.resources import expanded
from tnst_mi.run.request import FromModel


def recipe_of_model(path: str | Path) -> Recipe:
    """The recipe by which a network was trained: one of a file, or of a name that ships with the package.

    Raises:
        InputError: the file is no model, or names pictures that are not there.

    Example:
        >>> import numpy as np, tempfile, pathlib, tnst_mi
        >>> smoke = tnst_mi.Frame(np.pad(np.ones((8, 8, 8), np.float32), 4))
        >>> recipe = {"style": ["spirals"], "octaves": 1, "views": 1, "weights": "patterns"}
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     training = tnst_mi.train([[smoke]], recipe, f"{folder}/m.safetensors", updates=1, progress=False)
        ...     tnst_mi.recipe_of_model(training.model).octaves
        1
    """
    return _recipe_of(read_model(expanded(Path(path))))


def model_of_run(record: Mapping[str, Any] | None) -> FromModel | None:
    """The model that a run began with, by its record; None if it began otherwise."""
    began = None if record is None else record.get("model")
    return None if began is None else FromModel(Path(began["file"]), began["refine"])


def begun_by(
    model: FromModel, plan: Plan, record: dict[str, Any], frames: Sequence[Frame], earlier: Mapping[str, Any] | None
) -> tuple[Plan, dict[str, Any]]:
    """The plan and the record of a run that begins with the potentials of a network.

    Args:
        model: the network.
        plan: of the run, beginning anew.
        record: the contents of its run.json.
        frames: of the run.
        earlier: the record of the run if it is resumed.

    Raises:
        InputError: the file is no model, or another one than the run began with, or it does not go with the recipe.
    """
    network, refine = read_model(model.path), model.refine
    _require_fitting(network, plan, refine)
    shipped = {path: name for name, path in shipped_models().items()}
    file = shipped.get(network.path, str(network.path.absolute()))
    said = {"file": file, "sha256": network.sha256, "refine": refine}
    if earlier is not None and {**said, "file": None} != {**(earlier.get("model") or {}), "file": None}:
        raise InputError(f"{model.path}: the run that is resumed began otherwise; use --overwrite")
    last = len(plan.octaves) - 1
    iterations = {frame.name: plan.iterations(last) - refine for frame in plan.frames}
    start = Start(last, iterations, {}, _Potentials(network, plan, frames))
    return replace(plan, start=start), record | {"model": said}


@dataclass(frozen=True)
class _Potentials:
    """Finds the fields of a frame by its name, on the grid of the finest octave; other processes can do so too."""

    model: Model
    plan: Plan
    frames: Sequence[Frame]

    def __call__(self, name: str) -> Mapping[str, np.ndarray]:
        """The fields of the frame."""
        plan, octave = self.plan, self.plan.octaves[-1]
        frame = next(frame for frame in plan.frames if frame.name == name)
        source = self.frames[frame.index]
        density = mi.TensorXf(scaled(source.density, plan.density_scale))
        density = resample_density(density, 1.0, octave.shape, octave.cell_size)
        fields = predicted_fields(self.model.network, frame, octave, density)
        if (inside := self._inside(frame, source, octave)) is not None:
            fields = Fields({field: times(inside, tensor) for field, tensor in fields.items()})
        return {field: tensor.numpy() for field, tensor in fields.items()}

    def _inside(self, frame: FramePlan, source: Frame, octave: Octave) -> mi.TensorXf | None:
        """The factor that keeps potentials within the regions of a frame; None if these are everywhere."""
        if self.plan.regions is None:
            return None
        masks = self.plan.regions.masks(frame.index, source)
        border = border_of(masks, octave)
        return union_of([None if mask is None else octave_mask(mask, border, octave) for mask in masks])


def _recipe_of(model: Model) -> Recipe:
    """The recipe of a model, whose files are where they were beside it, or else in its folder.

    Raises:
        InputError: it names pictures that are not there.
    """
    folder, keys = model.path.parent, dict(model.recipe)
    for name in ("style", "content"):
        keys[name] = [
            entry if (folder / entry).exists() or not (folder / Path(entry).name).is_file() else Path(entry).name
            for entry in keys.get(name, ())
        ]
    return Recipe().updated(keys, f"{model.path}: ", folder)


def _require_fitting(model: Model, plan: Plan, refine: int) -> None:
    """Check that a run can begin with the potentials of a network.

    Raises:
        InputError: it cannot.
    """
    recipe = plan.recipe
    if recipe.parameterisation != "transport" or recipe.colour == "style":
        key = "colour" if recipe.colour == "style" else "parameterisation"
        raise InputError(f'{key} = "{getattr(recipe, key)}": a model moves smoke; leave {key} out, or the model')
    if len(plan.octaves) < recipe.octaves:
        raise InputError(f'quality = "{recipe.quality}": a model gives the finest octave, in one pass; leave it out')
    most = plan.iterations(len(plan.octaves) - 1)
    if refine > most:
        raise InputError(f"refine = {refine}: expected 0 to {most}, the iterations of the finest octave; raise those")
    if refine < 0:
        raise InputError(f"refine = {refine}: expected 0 to {most}, the iterations of the finest octave")
    learned = _recipe_of(model)
    for goal in GOALS:
        if not refine and getattr(recipe, goal) != getattr(learned, goal):
            raise InputError(
                f"{goal} = {getattr(recipe, goal)!r}: {model.path} draws what it has learned, and only what refines "
                f"it can aim at something else; leave {goal} out, or refine"
            )
