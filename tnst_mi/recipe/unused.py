"""Keys of a recipe that decide nothing, because what they belong to is not used."""

from __future__ import annotations

from collections.abc import Iterator

from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.region_keys import GOALS
from tnst_mi.recipe.sections import KINDS
from tnst_mi.recipe.targets import without_strokes

#: Keys of Mitsuba's path tracer, and of a window.
_OF_THE_PATH_TRACER = ("albedo", "anisotropy", "light", "spp")
_OF_A_WINDOW = ("window_weights", "window_average", "step_order", "coherence")
_OF_TRANSPORT = ("lam", "steps", "transport", "stages", "conservative", "reach", "keep_silhouette")


def unused_keys(recipe: Recipe, frames: int) -> dict[str, str]:
    """The keys that have another value than by default, or by the preset, without effect, each with the reason.

    Args:
        recipe: the recipe.
        frames: how many frames it is used for.

    Example:
        >>> unused_keys(Recipe(tag=("spiral",), style_weight=2.0), frames=1)
        {'style_weight': 'there is no style'}
    """
    changed = _changed(recipe, Recipe(preset=recipe.preset))
    lam = dict(recipe.keyframes.get("lam", ((0, recipe.lam),)))
    others = {"preset": recipe.preset, "lam": lam}
    others |= {key: getattr(recipe, key) for key in ("steps", "stages", "conservative")}
    if recipe.transport == Recipe.from_dict(others).transport:
        changed -= {"transport"}  # It follows from the others.
    return {key: reason for keys, reason in _without_effect(recipe, frames) for key in keys if key in changed}


def _changed(recipe: Recipe, default: Recipe) -> set[str]:
    return {key for key in KINDS if key in recipe.keyframes or getattr(recipe, key) != getattr(default, key)}


def _without_effect(recipe: Recipe, frames: int) -> Iterator[tuple[tuple[str, ...], str]]:
    goals = {goal for goal in GOALS if getattr(recipe, goal) or any(goal in table for table in recipe.target)}
    other_goals = goals - {"style"}
    if recipe.target:
        keys = ("semantic_weight",) if without_strokes(recipe) else ("style_weight", "semantic_weight")
        yield keys, "each target has a weight of its own"
    if "style" not in goals:
        yield ("style_weight", "style_layers", "style_loss", "style_statistics", "all_octaves"), "there is no style"
    elif not other_goals and recipe.colour != "style" and _only_scales(recipe, "style_weight"):
        yield ("style_weight",), "there is no other goal to weigh the style against"
    if not other_goals:
        yield ("semantic_weight",), "there is no semantic, tag, content or match"
    elif "style" not in goals and _only_scales(recipe, "semantic_weight"):
        yield ("semantic_weight",), "there is no style to weigh it against"
    if "content" not in goals:
        yield ("content_layers",), "there is no content"
    if "semantic" not in goals:
        yield ("damping",), "there is no semantic"
    if recipe.colour != "style":
        yield ("colour_weight", "colour_eta", "colour_smoothness"), 'it belongs to colour = "style"'
    if recipe.gamma != "auto":
        yield ("look",), 'it belongs to gamma = "auto"'
    if recipe.parameterisation == "density":
        yield _OF_TRANSPORT, 'it belongs to parameterisation = "transport"'
    if recipe.integrator == "emission_absorption":
        yield _OF_THE_PATH_TRACER, 'it belongs to integrator = "prbvolpath"'
    else:
        yield ("quadrature",), 'it belongs to integrator = "emission_absorption"'
    if recipe.window == 1 or frames == 1:
        yield _OF_A_WINDOW, "there is no window"
    if recipe.frames is None:
        yield ("context",), "frames are not selected"
    if frames == 1:
        yield ("fps",), "there is one frame"


def _only_scales(recipe: Recipe, weight: str) -> bool:
    """Whether the weight of all goals together decides nothing: the gradient is normalised, so a factor drops out."""
    return weight not in recipe.keyframes and getattr(recipe, weight) > 0.0
