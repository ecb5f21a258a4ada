"""The targets of a recipe: goals, each with the mask that says where it applies and the weight of its steps."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.recipe.keyframes import value_at
from tnst_mi.recipe.paths import shipped_name
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.region_keys import GOALS
from tnst_mi.recipe.sections import KINDS

#: One part of a mask: the name of a grid or a file, or a table.
Part = str | Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Target:
    """A goal, where it applies, and how much it counts.

    Attributes:
        recipe: the recipe of the run with the goal of this target alone; of [[target]] with weights
            of 1.
        mask: the parts whose product is the mask; empty for one that is 1 everywhere.
        weights: factor of its steps, one number or (frame number, weight) pairs in frame order.
        number: from 1 among several; 0 for the only one, which has the recipe's own goals.
    """

    recipe: Recipe
    mask: tuple[Part, ...]
    weights: float | tuple[tuple[int, float], ...] = 1.0
    number: int = 0

    @property
    def name(self) -> str:
        """What messages call it."""
        return f"target {self.number}: mask" if self.number else "mask"

    def weight(self, frame: int | float | None) -> float:
        """The factor of its steps in a frame.

        Raises:
            InputError: it has keyframes, and the frame has no number.
        """
        return value_at_frame(self.weights, frame, "weight") if isinstance(self.weights, tuple) else self.weights


def targets_of(recipe: Recipe) -> list[Target]:
    """The targets of a recipe; one that names none is itself the only one.

    Raises:
        InputError: it has targets beside goals or a mask of its own.

    Example:
        >>> recipe = Recipe.from_dict({"target": [{"style": "net", "weight": 0.5}, {"tag": "spiral"}]})
        >>> [(target.recipe.style != (), target.recipe.tag, target.weight(None)) for target in targets_of(recipe)]
        [(True, (), 0.5), (False, ('spiral',), 1.0)]
    """
    if not recipe.target:
        return [Target(recipe, parts_of(recipe.mask))]
    for goal in GOALS:
        if names := getattr(recipe, goal):
            given = KINDS[goal].show(tuple(shipped_name(name) for name in names))
            raise InputError(
                f"recipe: {goal} = {given} stands beside [[target]]; write it as a target too, or leave the targets out"
            )
    if recipe.mask is not None:
        raise InputError("recipe: mask stands beside [[target]]; give each target its own, or leave the targets out")
    return [_target(recipe, number, table) for number, table in enumerate(recipe.target, start=1)]


def without_strokes(recipe: Recipe) -> bool:
    """Whether smoke takes on the colours of pictures alone."""
    return recipe.colour == "style" and "style_weight" not in recipe.keyframes and recipe.style_weight == 0.0


def parts_of(mask: Any) -> tuple[Part, ...]:
    """The parts whose product a checked mask is."""
    if mask is None:
        return ()
    return mask if isinstance(mask, tuple) else (mask,)


def table_of(part: Part) -> Mapping[str, Any]:
    """A part of a mask as a table: a text means a file or a grid; located recipes hold files by absolute paths.

    Example:
        >>> table_of("heat"), table_of("/masks/m.npz")
        ({'grid': 'heat'}, {'file': '/masks/m.npz'})
    """
    if isinstance(part, Mapping):
        return part
    return {"file": part} if is_path(part) else {"grid": part}


def part_at(part: Mapping[str, Any], frame: int | float | None) -> dict[str, Any]:
    """The table of a mask at one frame, without keyframes.

    Raises:
        InputError: it has keyframes, and the frame has no number.
    """
    return {
        key: value_at_frame(tuple(value.items()), frame, key) if isinstance(value, Mapping) else value
        for key, value in part.items()
    }


def value_at_frame(keys: tuple[tuple[int, Any], ...], frame: int | float | None, name: str) -> Any:
    """The value of keyframes at a frame.

    Raises:
        InputError: the frame has no number.
    """
    if frame is None:
        raise InputError(f"{name}: frames without numbers cannot be keyframed; number the frames, or give one value")
    return value_at(keys, frame)


def mask_files(recipe: Recipe) -> list[str]:
    """The files that the masks of a located recipe name: grids and pictures."""
    parts = [part for target in targets_of(recipe) for part in target.mask]
    named = [(part,) if isinstance(part, str) else (part.get("file"), part.get("image")) for part in parts]
    return [name for names in named for name in names if name is not None and is_path(name)]


def is_path(text: str) -> bool:
    """Whether the text of a mask in a located recipe is the path of a file, rather than the name of a grid."""
    return "/" in text or "\\" in text


def _target(recipe: Recipe, number: int, table: Mapping[str, Any]) -> Target:
    own = {key: value for key, value in table.items() if key not in ("mask", "weight")}
    keyed = {key: dict(keys) for key, keys in recipe.keyframes.items()}
    # The weights of the recipe weigh goals of one loss against each other, and a target's loss has a single one; but
    # strokes that do not count leave the palettes of the targets.
    alone = {"target": (), "style_weight": 0.0 if without_strokes(recipe) else 1.0, "semantic_weight": 1.0}
    goal = dataclasses.replace(recipe, **keyed | alone | own, keyframes={})
    weight = table.get("weight", 1.0)
    weights = tuple(weight.items()) if isinstance(weight, Mapping) else weight
    return Target(goal, parts_of(table.get("mask")), weights, number)
