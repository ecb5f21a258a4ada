"""Keys of a recipe that do not go together."""

from __future__ import annotations

from tnst_mi.errors import InputError
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.recipe.region_keys import GOALS
from tnst_mi.recipe.targets import without_strokes


def require_averageable(recipe: Recipe) -> None:
    """Check that a window can be averaged as a recipe says.

    Raises:
        InputError: an average over smoke is wanted of gradients, which no mask has weighted, or gradients of several
            targets are to be averaged.
    """
    if recipe.window > 1 and recipe.step_order == "align_first" and recipe.window_average == "smoke":
        raise InputError(
            "step_order = 'align_first' averages gradients before the mask, so that window_average = 'smoke' has "
            "nothing to count smoke by; expected window_average = 'plain'"
        )
    if recipe.window > 1 and recipe.step_order == "align_first" and len(recipe.target) > 1:
        raise InputError(
            f"step_order = 'align_first' averages the gradients of one target, and there are {len(recipe.target)}; "
            "expected step_order = 'normalise_first'"
        )


def require_colour_driven(recipe: Recipe) -> None:
    """Check that the renderer of a recipe shows colours, if these are wanted, and that there are pictures to take.

    Raises:
        InputError: it does not, or there are none.
    """
    if recipe.colour != "off" and recipe.integrator != "emission_absorption":
        raise InputError(
            f"colour = {recipe.colour!r} and integrator = {recipe.integrator!r}, which shows grey smoke; expected "
            "integrator = 'emission_absorption', or colour = 'off'"
        )
    if recipe.colour != "style":
        return
    if not recipe.style and not any(target.get("style") for target in recipe.target):
        raise InputError(
            "colour = 'style' takes the colours of a style picture, and there is none; expected --style PICTURE, or "
            "colour = 'off' or 'keep'"
        )


def require_weight(recipe: Recipe) -> None:
    """Check that one of a recipe's goals counts: a run without would change nothing.

    Raises:
        InputError: all of their weights are 0.
    """
    if recipe.target:
        if without_strokes(recipe) and "colour_weight" not in recipe.keyframes and recipe.colour_weight == 0.0:
            raise InputError(
                "style_weight = 0 and colour_weight = 0: nothing of the targets with a style counts; expected one of "
                "them above 0, or colour = 'off'"
            )
        return
    others = [goal for goal in GOALS if goal != "style" and getattr(recipe, goal)]
    weights = ["style_weight"] * bool(recipe.style) + ["semantic_weight"] * bool(others)
    if recipe.colour == "style":
        weights.append("colour_weight")
    if not weights or any(key in recipe.keyframes or getattr(recipe, key) > 0 for key in weights):
        return
    given = " and ".join(f"{key} = 0" for key in weights)
    whose = "the goal" if len(weights) == 1 else "the goals"
    expected = "it" if len(weights) == 1 else "one of them"
    raise InputError(f"{given}: nothing of {whose} counts, so nothing would change; expected {expected} above 0")


def require_unmirrored(flip: str | None) -> None:
    """Check that smoke lies in its scene as its files have it, so that the camera of a shot sees the same.

    Args:
        flip: the axes that are mirrored on reading.

    Raises:
        InputError: some are.
    """
    if flip:
        raise InputError(
            f"flip = {flip!r} mirrors the smoke, which the camera of a shot does not see mirrored; expected one of them"
        )


def require_one_transport(recipe: Recipe) -> None:
    """Check that the keys of one kind of transport do not come with the other.

    Raises:
        InputError: they do.
    """
    if recipe.transport == "flow":
        other, foreign = "step", {"steps": recipe.steps != 1}
    else:
        other, foreign = "flow", {"stages": recipe.stages != "auto", "conservative": recipe.conservative}
    for name, given in foreign.items():
        if given:
            raise InputError(
                f"{name} = {getattr(recipe, name)!r} belongs to transport = {other!r}, and transport is "
                f"{recipe.transport!r}; expected one of them to be otherwise"
            )
